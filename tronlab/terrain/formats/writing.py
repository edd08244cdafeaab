"""Files that appear whole or not at all."""

import os
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from tronlab.terrain.heightmap import TerrainError


@contextmanager
def written_whole(path: Path) -> Generator[Path]:
    """Give a draft's name in the same folder; it gets the file's own name when it is complete.

    Raises:
        TerrainError: The file cannot be written; nothing is left of the draft.
    """
    draft = path.with_name(f".{path.stem}-{os.getpid()}{path.suffix}")
    try:
        yield draft
        draft.replace(path)
    except OSError as error:
        raise TerrainError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        draft.unlink(missing_ok=True)
