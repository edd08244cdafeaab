"""Installed cores, by the names of their entry points."""

import difflib
from importlib.metadata import EntryPoint, entry_points

from tronlab.errors import ScoreError

ENTRY_POINT_GROUP = "tronlab.navigation_cores"


def known_cores() -> dict[str, EntryPoint]:
    """Give every installed core by name."""
    return {point.name: point for point in entry_points(group=ENTRY_POINT_GROUP)}


def installed_core(name: str) -> EntryPoint:
    """Give one installed core.

    Raises:
        ScoreError: There is none of this name; the text says which there are, and what else may be
            named.
    """
    cores = known_cores()
    if name in cores:
        return cores[name]
    close = difflib.get_close_matches(name, cores, n=1)
    meant = f", did you mean {close[0]}?" if close else ";"
    raise ScoreError(
        f"no navigation core '{name}'{meant} known cores: {', '.join(sorted(cores)) or 'none'};"
        " others: cmd:PROGRAM ARGUMENTS, package.module:Class, tcp://HOST:PORT"
    )
