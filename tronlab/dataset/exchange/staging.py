"""A folder that is there whole or not at all."""

import shutil
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from tronlab.errors import DatasetError


@contextmanager
def staged_folder(out_dir: Path) -> Generator[Path]:
    """Give a folder to fill. It takes its name when the block ends well; else nothing is left.

    Errors of datasets raised in the block name the folder as it was to be called.

    Raises:
        DatasetError: ``out_dir`` is there already, cannot be made, or the disk does not take what
            is written.
    """
    if out_dir.exists():
        raise DatasetError(
            f"{out_dir}: exists already and is never overwritten; choose another --out"
        )
    part = out_dir.with_name(f".{out_dir.name}.part")
    _make(part, out_dir)
    try:
        yield part
        part.rename(out_dir)
    except OSError as error:
        raise DatasetError(
            f"{out_dir}: cannot be written: {error.strerror or error}; nothing is left of it"
        ) from error
    except DatasetError as error:
        if str(part) not in str(error):
            raise
        raise DatasetError(str(error).replace(str(part), str(out_dir))) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)  # it must not hide what went wrong before


def _make(part: Path, out_dir: Path) -> None:
    try:
        part.mkdir()
    except FileExistsError as error:
        raise DatasetError(
            f"{out_dir}: another process is writing it, or one that was killed left {part.name};"
            f" if none is running, remove that: {part}"
        ) from error
    except FileNotFoundError as error:
        raise DatasetError(f"{out_dir}: the folder {out_dir.parent} does not exist") from error
    except OSError as error:
        raise DatasetError(f"{out_dir}: cannot be made: {error.strerror}") from error
