"""Digests of source files: what was computed by other code is computed anew."""

import hashlib
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Literal, TypeAlias

Stage: TypeAlias = Literal["features", "database", "matching", "core"]

_PACKAGE = Path(__file__).parent.parent
_STAGES: dict[Stage, tuple[str, ...]] = {
    "features": ("nav/features.py",),
    "database": ("nav/features.py", "nav/database.py", "geometry/camera.py"),
    "matching": ("nav/matching/*.py",),
    "core": ("nav/**/*.py", "geometry/*.py"),
}


@cache
def digest_of_stage(stage: Stage) -> str:
    """Give a digest of the code that the results of a stage of the built-in cores depend on."""
    return digest_of_files(
        path for pattern in _STAGES[stage] for path in sorted(_PACKAGE.glob(pattern))
    )


def digest_of_files(paths: Iterable[Path]) -> str:
    """Give a digest of names and contents of files, in the order given.

    Raises:
        OSError: One cannot be read.
    """
    digest = hashlib.blake2b(digest_size=16)
    for path in paths:
        content = path.read_bytes()
        digest.update(f"{path.name} {len(content)}\n".encode())
        digest.update(content)
    return digest.hexdigest()
