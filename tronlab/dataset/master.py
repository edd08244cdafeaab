"""The dataset's own file while it is recorded.

It is built under another name and gets its own when the first shot is in it. Until then its
structure may change; afterwards only bytes in place do.
"""

import fcntl
import os
import shutil
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from pathlib import Path

import h5py
from numpy.typing import ArrayLike

from tronlab.dataset import places, schema
from tronlab.dataset.inplace import InPlaceFile
from tronlab.dataset.segments import uuid_of
from tronlab.dataset.skeleton import dataset_at
from tronlab.errors import DatasetError

_WRITE_ERRORS = (OSError, RuntimeError, ValueError)
"""What is raised when the operating system does not take what is written; HDF5 has its own."""


class Master:
    """The file that holds everything of a dataset besides the images of its segments."""

    def __init__(self, path: Path) -> None:
        """Remember its name; ``create`` or ``copy`` makes it."""
        self.path = path
        self.is_open = True
        self.is_published = False
        self._part = places.part_of(path)
        self._values: InPlaceFile | None = None
        self._guard: int | None = None
        """Descriptor that keeps other writers away; readers are welcome."""

    def create(self, build: Callable[[h5py.File], None], n_bytes: int) -> None:
        """Make a new file of about so many bytes.

        Raises:
            DatasetError: Another process makes it at this moment.
            OSError, RuntimeError, ValueError, TypeError: It cannot be made.
        """
        self._clear_away()
        self._keep_others_away()
        with self._removed_on_failure():
            places.probe_room(self._part, n_bytes)
            with h5py.File(self._part, "w", locking=False) as file:
                build(file)

    def copy(self) -> None:
        """Begin with a copy of the file as it is.

        Raises:
            DatasetError: Another process makes one at this moment.
            OSError: It cannot be made.
        """
        self._clear_away()
        self._keep_others_away()
        with self._removed_on_failure():
            places.probe_room(self._part, self.path.stat().st_size)
            shutil.copyfile(self.path, self._part)

    @contextmanager
    def structure(self, n_bytes: int = 0) -> Generator[h5py.File]:
        """Open the file for changes of its structure, by about so many bytes.

        If they fail the file is removed: it has no shots, or is a copy.

        Raises:
            OSError, RuntimeError, ValueError: The disk does not take it.
        """
        if self.is_published:
            raise DatasetError(f"{self.path}: has shots already; its structure is fixed")
        places.probe_room(self._part, n_bytes)
        self._close_values()
        with self._removed_on_failure(), h5py.File(self._part, "r+", locking=False) as file:
            yield file

    def write(self, path: str, value: ArrayLike) -> None:
        """Overwrite a value.

        Raises:
            OSError: The disk does not take it.
        """
        self._open_values().write(path, value)

    def write_row(self, path: str, row: int, value: ArrayLike) -> None:
        """Overwrite one row of a column.

        Raises:
            OSError: The disk does not take it.
        """
        self._open_values().write_row(path, row, value)

    def sync(self) -> None:
        """Have everything put on the disk.

        Raises:
            OSError: The disk does not take it.
        """
        self._open_values().sync()

    def publish(self) -> None:
        """Give the file its name.

        Raises:
            OSError: The disk does not take it.
        """
        self.sync()
        places.put_in_place(self._part, self.path)
        self.is_published = True

    @contextmanager
    def explaining(self, what: str, more: str = "") -> Generator[None]:
        """Turn what is raised when the disk does not take something into one clear error.

        Raises:
            DatasetError: It did not.
        """
        try:
            yield
        except _WRITE_ERRORS as error:
            raise DatasetError(f"{self.path}: {what}: {error}{more}") from error

    def close(self) -> None:
        """Close the file; without its name it is removed. May be called twice."""
        self._close_values()
        if self.is_open and not self.is_published:
            self._discard()
        if self._guard is not None:
            os.close(self._guard)
            self._guard = None
        self.is_open = False

    def _keep_others_away(self) -> None:
        """Begin the file; one that another process has begun meanwhile is theirs and stays."""
        try:
            guard = os.open(self._part, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
        except FileExistsError as error:
            raise self._busy() from error
        try:
            # HDF5 takes the same lock for reading, and an exclusive one for writing.
            fcntl.flock(guard, fcntl.LOCK_SH)
            if not places.is_at(self._part, guard):
                raise self._busy()
        except BaseException:
            os.close(guard)
            raise
        self._guard = guard

    def _busy(self) -> DatasetError:
        return DatasetError(
            f"{self.path}: is being written by another process; wait until that has ended"
        )

    def _open_values(self) -> InPlaceFile:
        if self._values is None:
            self._values = InPlaceFile(self.path if self.is_published else self._part)
        return self._values

    def _close_values(self) -> None:
        if self._values is not None:
            self._values.close()
            self._values = None

    @contextmanager
    def _removed_on_failure(self) -> Generator[None]:
        try:
            yield
        except BaseException:
            self.close()
            raise

    def _clear_away(self) -> None:
        """Remove what a killed process left before its first shot was in the file."""
        if not self._part.exists():
            return
        with self._part.open("rb") as left:
            try:
                fcntl.flock(left, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise self._busy() from error
            self._discard()

    def _discard(self) -> None:
        """Remove the file, and what was made beside it for a dataset that never got its name."""
        if not self.path.exists():
            self._discard_segments()
        places.remove(self._part)

    def _discard_segments(self) -> None:
        """Remove the segments of the file if it counts no shots: then they hold none."""
        uuid = _uuid_without_shots(self._part)
        folder = places.images_folder(self.path)
        for segment in folder.glob("*.h5"):
            if uuid is not None and uuid_of(segment) == uuid:
                places.remove(segment)
        with suppress(OSError):
            folder.rmdir()  # unless something else is in it


def _uuid_without_shots(part: Path) -> str | None:
    """Give which dataset a file is; None if it has shots, or does not say."""
    try:
        with h5py.File(part, "r", locking=False) as file:
            n_committed = int(dataset_at(file, schema.N_COMMITTED)[()])
    except (OSError, RuntimeError, KeyError):
        return None
    return uuid_of(part) if n_committed == 0 else None
