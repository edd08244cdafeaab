"""The build hook: with a compiler, without one, and what it says."""

import ctypes
import importlib.util
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import drivers.gige.producer
from drivers.gige.producer import producer_path, why_missing

HERE = Path(__file__).parent
ROOT = Path(__file__).parents[5]
SOURCES = ROOT / "drivers/gige/producer"


@pytest.fixture(scope="module")
def hatch_build() -> ModuleType:
    specification = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A copy of what the hook reads, with a library left over from before."""
    sources = tmp_path / "drivers/gige/producer"
    shutil.copytree(SOURCES, sources, ignore=shutil.ignore_patterns("*.cti", "__pycache__"))
    (sources / "tronlab_gev.cti").write_text("stale")
    return tmp_path


@pytest.fixture
def compiler(hatch_build: ModuleType) -> None:
    try:
        hatch_build.find_compiler()
    except hatch_build.NotBuiltError as error:
        pytest.skip(str(error))


def run_hook(hatch_build: ModuleType, root: Path, target: str = "wheel") -> dict[str, Any]:
    """Run the hook as hatchling does; the warnings are in the result."""
    warnings: list[str] = []

    class App:
        display_warning = staticmethod(warnings.append)

    class Hook(hatch_build.ProducerBuildHook):  # type: ignore[name-defined, misc]
        target_name = target
        app = App
        root = ""

        def __init__(self) -> None:
            """Take nothing of hatchling's."""

    hook = Hook()
    type(hook).root = str(root)
    build_data: dict[str, Any] = {"artifacts": [], "pure_python": True}
    hook.initialize("standard", build_data)
    return build_data | {"warnings": warnings}


@pytest.mark.usefixtures("compiler")
def test_the_library_goes_into_a_wheel_of_this_platform(
    hatch_build: ModuleType, tree: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The sources compile without a warning, which users' compilers are not asked for.
    strict = [*hatch_build.find_compiler(), "-Werror", "-Wpedantic"]
    monkeypatch.setenv("CC", " ".join(strict))
    result = run_hook(hatch_build, tree)
    assert result["warnings"] == []
    assert result["artifacts"] == ["drivers/gige/producer/tronlab_gev.cti"]
    assert result["pure_python"] is False
    assert result["tag"].startswith("py3-none-linux_")
    library = ctypes.CDLL(str(tree / result["artifacts"][0]))
    assert library.GCCloseLib() == -1002  # not initialised
    left = {path.name for path in (tree / "drivers/gige/producer").iterdir()}
    assert left - {"tronlab_gev.cti"} == {
        path.name for path in SOURCES.iterdir() if path.suffix in {".c", ".h", ".py"}
    }


@pytest.mark.parametrize("compiler", ["/nonexistent/cc", "false"])
def test_without_a_working_compiler_the_build_goes_on_and_says_so(
    hatch_build: ModuleType, tree: Path, monkeypatch: pytest.MonkeyPatch, compiler: str
) -> None:
    monkeypatch.setenv("CC", compiler)
    result = run_hook(hatch_build, tree)
    assert result["artifacts"] == []
    assert result["pure_python"] is True
    assert "tag" not in result
    (warning,) = result["warnings"]
    assert warning.startswith("The GigE Vision producer is left out: ")
    assert compiler in warning
    assert not (tree / "drivers/gige/producer/tronlab_gev.cti").exists()  # nor a stale one


def test_an_empty_path_has_no_compiler(
    hatch_build: ModuleType, tree: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tree))
    (warning,) = run_hook(hatch_build, tree)["warnings"]
    assert "there is no C compiler (cc, gcc, clang). Install one" in warning


def test_another_system_than_linux_goes_without(
    hatch_build: ModuleType, tree: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    (warning,) = run_hook(hatch_build, tree)["warnings"]
    assert "it needs Linux, this is darwin" in warning


def test_a_source_archive_has_no_library(hatch_build: ModuleType, tree: Path) -> None:
    result = run_hook(hatch_build, tree, target="sdist")
    assert (result["artifacts"], result["warnings"]) == ([], [])


@pytest.mark.usefixtures("compiler")
def test_it_is_built_here_from_the_sources_as_they_are() -> None:
    path = producer_path()
    assert path is not None, why_missing()
    assert why_missing() == ""
    newest = max(SOURCES.glob("*.[ch]"), key=lambda source: source.stat().st_mtime)
    assert path.stat().st_mtime >= newest.stat().st_mtime, "run 'python hatch_build.py'"


def test_it_says_what_to_do_where_it_was_not_built(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(drivers.gige.producer, "_LIBRARY", tmp_path / "tronlab_gev.cti")
    assert producer_path() is None
    assert "python hatch_build.py" in why_missing()
    assert str(tmp_path) in why_missing()


@pytest.mark.usefixtures("compiler")
def test_the_c_interface_s_tests_pass_under_the_address_sanitizer(
    hatch_build: ModuleType, tmp_path: Path
) -> None:
    found = run_sanitized(hatch_build, tmp_path, "address,undefined", ["control", "stream"])
    assert "ERROR: AddressSanitizer" not in found
    assert "sanitized.cti" not in found  # nor among the leaks, of which Python has its own


@pytest.mark.usefixtures("compiler")
def test_the_stream_s_tests_pass_under_the_thread_sanitizer(
    hatch_build: ModuleType, tmp_path: Path
) -> None:
    assert run_sanitized(hatch_build, tmp_path, "thread", ["stream"]) == ""


def run_sanitized(hatch_build: ModuleType, folder: Path, sanitizers: str, tests: list[str]) -> str:
    """Run tests of this folder on a library with sanitizers, and give what these reported."""
    library = folder / "sanitized.cti"
    names = {"address": "libasan.so", "undefined": "libubsan.so", "thread": "libtsan.so"}
    runtimes = [find_runtime(hatch_build, names[name]) for name in sanitizers.split(",")]
    flags = ("-g", "-O0", f"-fsanitize={sanitizers}", "-fno-sanitize-recover=all")
    hatch_build.compile_library(SOURCES, library, flags)
    log = f"log_path={folder / 'report'}"
    options = ["-q", "-p", "no:cacheprovider", "-p", "no:xdist", f"--confcutdir={HERE}"]
    files = [str(HERE / f"test_producer_{name}.py") for name in tests]
    run = subprocess.run(
        [sys.executable, "-m", "pytest", *options, "-k", "not silen and not pending", *files],
        cwd=ROOT,
        env=os.environ
        | {
            "TRONLAB_TEST_PRODUCER": str(library),
            "LD_PRELOAD": ":".join(runtimes),
            "PYTHONMALLOC": "malloc",
            "ASAN_OPTIONS": f"detect_leaks=1:{log}",
            "TSAN_OPTIONS": log,
        },
        capture_output=True,
        text=True,
        check=False,
    )
    if "unexpected memory mapping" in run.stderr:
        pytest.skip("this kernel's address randomisation is too wide for the compiler's sanitizer")
    assert re.fullmatch(r"\d+ passed, \d+ deselected in .*", run.stdout.splitlines()[-1]), (
        run.stdout + run.stderr
    )
    return "".join(report.read_text() for report in folder.glob("report.*"))


def find_runtime(hatch_build: ModuleType, name: str) -> str:
    compiler = hatch_build.find_compiler()[0]
    command = [compiler, f"-print-file-name={name}"]
    path = subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
    if not Path(path).is_absolute():
        pytest.skip(f"{compiler} has no {name} (Debian: libgcc-12-dev)")
    return path
