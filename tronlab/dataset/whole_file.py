"""Files that are there whole or not at all."""

import os
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from tronlab.dataset import places
from tronlab.errors import DatasetError

_WRITE_ERRORS = (OSError, RuntimeError)
"""What h5py raises when the operating system does not take what HDF5 writes."""


@contextmanager
def whole_file(target: Path) -> Generator[Path]:
    """Give the name under which to make a file; it gets its own when the block ends well.

    Otherwise nothing is left of it, also after Ctrl-C.

    Raises:
        DatasetError: The file exists, or cannot be made.
    """
    places.check_is_new(target)
    part = places.part_of(target)
    places.remove(part)
    try:
        yield part
        with part.open("rb") as made:
            os.fsync(made.fileno())
        places.check_is_new(target)
        places.put_in_place(part, target)
    except _WRITE_ERRORS as error:
        raise DatasetError(f"{target}: cannot be made: {error}") from error
    finally:
        places.remove(part)
