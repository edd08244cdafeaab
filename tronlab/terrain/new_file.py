"""Large files that appear under their name only when they are complete."""

import fcntl
import glob
import os
from pathlib import Path
from types import TracebackType
from typing import Self

from tronlab.terrain.heightmap import TerrainError


class NewFile:
    """A file being written under a temporary name beside ``path``.

    Use as a context: what was not put in place when it ends is removed. The disk space of all of
    it is taken at the beginning, so that it does not run out at the end.

    Raises:
        TerrainError: On entering, if the folder cannot be written to or has too little room.
    """

    def __init__(self, path: Path, n_bytes: int) -> None:
        self.path = path
        self._n_bytes = n_bytes
        self._part = path.with_name(f"{path.name}.{os.getpid()}-{id(self)}.part")

    def __enter__(self) -> Self:
        _remove_abandoned(self.path)
        check_disk_space(self.path.parent, self._n_bytes)
        try:
            self.descriptor = os.open(self._part, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
        except OSError as error:
            raise self._cannot_be_written(error) from error
        try:
            fcntl.flock(self.descriptor, fcntl.LOCK_EX)
            _reserve(self.descriptor, self._n_bytes)
        except OSError as error:
            self._remove()
            raise self._cannot_be_written(error) from error
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._remove()

    def put_in_place(self) -> None:
        """Give the file its name, once it is on the disk.

        Raises:
            TerrainError: There is no room after all, or a folder of this name.
        """
        try:
            os.fsync(self.descriptor)
            self._part.replace(self.path)
        except OSError as error:
            raise self._cannot_be_written(error) from error

    def _cannot_be_written(self, error: OSError) -> TerrainError:
        return TerrainError(f"{self.path}: cannot be written: {error.strerror}")

    def _remove(self) -> None:
        os.close(self.descriptor)
        self._part.unlink(missing_ok=True)


def check_disk_space(folder: Path, n_bytes: int) -> None:
    """Make sure that a folder has room.

    Raises:
        TerrainError: It has not, or there is no such folder.
    """
    try:
        status = os.statvfs(folder)
    except OSError as error:
        raise TerrainError(f"{folder}: cannot be written to: {error.strerror}") from error
    free = status.f_bavail * status.f_frsize
    if free < n_bytes:
        raise TerrainError(
            f"{folder}: {n_bytes / 1e9:.1f} GB are needed and {free / 1e9:.1f} GB are free; make"
            " room, or make the terrain's spacing_m larger or its size_m smaller"
        )


def _reserve(file: int, n_bytes: int) -> None:
    """Take the space on the disk, where the system can."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(file, 0, n_bytes)
    else:
        os.ftruncate(file, n_bytes)


def _remove_abandoned(path: Path) -> None:
    """Remove what processes that were killed have left of this file: nobody holds its lock."""
    for part in path.parent.glob(f"{glob.escape(path.name)}.*.part"):
        try:
            file = os.open(part, os.O_RDWR)
        except OSError:
            continue
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            part.unlink(missing_ok=True)
        except OSError:
            pass
        finally:
            os.close(file)
