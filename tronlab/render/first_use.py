"""Says so before kernels are compiled: that takes seconds, but only once on a machine."""

from collections.abc import Callable
from typing import Any


def announce_first_use(announce: Callable[[str], None] | None, *kernels: Any) -> None:
    """Announce that some of the kernels are to be compiled, if so.

    Args:
        announce: Is told; None: nobody is.
        kernels: What will be run next.
    """
    if announce is not None and not all(map(_is_compiled, kernels)):
        announce("compiling the renderer for this machine: its first use ever takes some seconds")


def _is_compiled(kernel: Any) -> bool:
    """Tell whether a kernel is compiled in this process or was kept on disk."""
    if kernel.signatures:
        return True
    # Where numba found no writable folder, the kernel has no file.
    file = getattr(kernel._cache, "_cache_file", None)  # noqa: SLF001
    return file is not None and bool(file._load_index())  # noqa: SLF001
