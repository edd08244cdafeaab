"""The packet parsers and the frame assembly in C, under the address sanitizer."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

HERE = Path(__file__).parent
SOURCES = Path(__file__).parents[5] / "drivers/gige/producer"
CHECKS = re.findall(r"(?<!define )NAMED\((\w+)\)", (HERE / "checks.c").read_text())
FLAGS = "-std=c11 -D_GNU_SOURCE -g -O0 -Wall -Wextra -Werror -pthread"
SANITIZERS = "-fsanitize=address,undefined -fno-sanitize-recover=undefined"


def build(source: str, parts: str, folder: Path) -> Path:
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("no C compiler")
    program = folder / Path(source).stem
    files = [HERE / source, *(SOURCES / f"{part}.c" for part in parts.split())]
    probe = folder / "probe.c"
    probe.write_text("int main(void) { return 0; }\n")
    command = [compiler, *SANITIZERS.split(), str(probe), "-o", str(program)]
    if subprocess.run(command, capture_output=True, check=False).returncode != 0:
        pytest.skip(f"{compiler} has no address sanitizer (Debian: libasan)")
    command = [compiler, *FLAGS.split(), *SANITIZERS.split(), f"-I{SOURCES}", *map(str, files)]
    made = subprocess.run(
        [*command, "-o", str(program)], capture_output=True, text=True, check=False
    )
    assert made.returncode == 0, made.stderr
    return program


@pytest.fixture(scope="module")
def checks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build("checks.c", "gvsp assembly resend", tmp_path_factory.mktemp("checks"))


@pytest.fixture(scope="module")
def fuzz(tmp_path_factory: pytest.TempPathFactory) -> Path:
    parts = "gvsp assembly resend gvcp discovery threads answer"
    return build("fuzz.c", parts, tmp_path_factory.mktemp("fuzz"))


def test_the_checks_are_found() -> None:
    assert len(CHECKS) == 27


@pytest.mark.parametrize("check", CHECKS)
def test_assembly(checks: Path, check: str) -> None:
    run = subprocess.run([checks, check], capture_output=True, text=True, check=False)
    assert (run.returncode, run.stdout) == (0, f"ok {check}\n"), run.stdout + run.stderr


@pytest.mark.parametrize("seed", range(1, 5))
def test_no_packet_breaks_the_parsers(fuzz: Path, seed: int) -> None:
    run = subprocess.run([fuzz, str(seed), "200000"], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    counts = {key: int(value) for key, value in (line.split() for line in run.stdout.splitlines())}
    # It went through all that a stream can meet, and not only past its door.
    assert counts["complete"] > 100
    assert counts["incomplete"] > 500
    assert counts["malformed"] > 1000
    assert counts["refused"] > 50
    assert counts["requests"] > 1000
    assert counts["cameras"] > 100
