"""Files of a study: there whole, or as they were before."""

import os
from pathlib import Path

from tronlab.errors import ConfigError


def replace_text(path: Path, text: str) -> None:
    """Write a text file; whoever reads it, or a crash, finds the old or the new one.

    Raises:
        ConfigError: It cannot be written.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_text(text, encoding="utf-8")
        with part.open("rb") as made:
            os.fsync(made.fileno())
        part.replace(path)
    except OSError as error:
        raise ConfigError(f"cannot be written: {error.strerror}", path=path) from error
