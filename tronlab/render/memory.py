"""Memory that is asked for before it is spent."""

from pathlib import Path

from tronlab.render.renderer import RenderError

_MEMINFO = Path("/proc/meminfo")


def available_bytes() -> int | None:
    """Give how much memory can be had without swapping; None where the system does not tell."""
    try:
        lines = _MEMINFO.read_text(encoding="ascii").splitlines()
    except OSError:
        return None
    fields = dict(line.split(":", 1) for line in lines)
    return int(fields["MemAvailable"].split()[0]) * 1024 if "MemAvailable" in fields else None


def check_memory(needed_bytes: float, *, what: str, remedy: str) -> None:
    """Refuse what would not fit, before anything is spent on it.

    Args:
        needed_bytes: What it takes at its peak.
        what: What needs it, as the beginning of the error.
        remedy: What can be done about it.

    Raises:
        RenderError: More is needed than available.
    """
    available = available_bytes()
    if available is not None and needed_bytes > available:
        raise RenderError(
            f"{what}: needs about {needed_bytes / 1e9:.1f} GB of memory,"
            f" {available / 1e9:.1f} GB are available\n{remedy}"
        )
