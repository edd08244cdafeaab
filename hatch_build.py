"""Build the GenTL producer, so that a GigE Vision camera needs no vendor's software.

Hatchling runs the hook at every installation. Where there is no C compiler, or the system is not
Linux, the installation goes on without the producer and says so. To build it by hand:
``python hatch_build.py``.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

try:
    from hatchling.builders.hooks.plugin.interface import BuildHookInterface
except ModuleNotFoundError:  # by hand, outside of a build
    BuildHookInterface = object

PRODUCER = Path("drivers/gige/producer")
LIBRARY = PRODUCER / "tronlab_gev.cti"
FLAGS = ("-std=c11", "-D_GNU_SOURCE", "-O2", "-Wall", "-Wextra", "-fPIC", "-fvisibility=hidden")
LINK_FLAGS = ("-shared", "-pthread", "-Wl,-z,defs")


class NotBuiltError(Exception):
    """The producer cannot be built here; the message says why and what to do."""


class ProducerBuildHook(BuildHookInterface):
    """Compile the producer into a wheel or, for an editable installation, into the tree."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the compiled library to the build, or warn that it is left out."""
        if self.target_name != "wheel":
            return
        try:
            library = build(Path(self.root))
        except NotBuiltError as error:
            self.app.display_warning(f"The GigE Vision producer is left out: {error}")
            return
        relative = library.relative_to(self.root).as_posix()
        build_data["artifacts"].append(relative)
        build_data["pure_python"] = False
        # The library is plain C behind the GenTL interface: it fits any Python of this platform.
        build_data["tag"] = f"py3-none-{platform_tag()}"


def build(root: Path) -> Path:
    """Compile the producer's sources under ``root`` and return the library's path.

    Raises:
        NotBuiltError: There is no compiler, it failed, or the system is not Linux.
    """
    library = root / LIBRARY
    try:
        library.unlink(missing_ok=True)
        with tempfile.TemporaryDirectory(dir=library.parent) as folder:
            made = Path(folder) / library.name
            compile_library(root / PRODUCER, made)
            made.replace(library)  # at once, so that no consumer loads half a library
    except OSError as error:
        raise NotBuiltError(str(error)) from error
    return library


def compile_library(sources: Path, library: Path, extra_flags: tuple[str, ...] = ()) -> None:
    """Compile all C files in ``sources`` into ``library``.

    Raises:
        NotBuiltError: There is no compiler, it failed, or the system is not Linux.
    """
    if not sys.platform.startswith("linux"):
        raise NotBuiltError(f"it needs Linux, this is {sys.platform}.")
    files = sorted(str(path) for path in sources.glob("*.c"))
    command = [*find_compiler(), *FLAGS, *extra_flags, *files, *LINK_FLAGS, "-o", str(library)]
    run = subprocess.run(command, check=False, capture_output=True, text=True)  # noqa: S603
    if run.returncode != 0:
        raise NotBuiltError(f"'{command[0]}' failed:\n{run.stderr}")


def find_compiler() -> list[str]:
    """Find the C compiler: ``$CC`` with its options if it is set, else the usual names.

    Raises:
        NotBuiltError: None of them is there.
    """
    wanted = os.environ.get("CC", "").split()
    for command in [wanted] if wanted else [["cc"], ["gcc"], ["clang"]]:
        if shutil.which(command[0]):
            return command
    tried = wanted[0] if wanted else "cc, gcc, clang"
    raise NotBuiltError(f"there is no C compiler ({tried}). Install one and install tronlab again.")


def platform_tag() -> str:
    """Name this platform as wheels do."""
    import sysconfig

    return sysconfig.get_platform().replace("-", "_").replace(".", "_")


if __name__ == "__main__":
    try:
        print(build(Path(__file__).resolve().parent))
    except NotBuiltError as error:
        sys.exit(f"The GigE Vision producer is not built: {error}")
