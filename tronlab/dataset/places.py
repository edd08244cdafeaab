"""Where the files that belong to a dataset lie, and giving a finished file its name for good."""

import errno
import os
import shutil
from contextlib import suppress
from pathlib import Path

from tronlab.errors import DatasetError

STRUCTURE_BYTES = 1 << 20
"""More than HDF5 needs for the structure around a few stacks of images."""


def part_of(path: Path) -> Path:
    """Give the name a file has while it is made."""
    return path.with_name(f".{path.name}.part")


def images_folder(dataset_path: Path) -> Path:
    """Give the folder of a dataset's segments."""
    return dataset_path.with_suffix(".images")


def journal_path(dataset_path: Path) -> Path:
    """Give where the journal of a dataset is."""
    return dataset_path.with_suffix(".journal.jsonl")


def lock_path(dataset_path: Path) -> Path:
    """Give where the lock of a dataset is."""
    return dataset_path.with_suffix(".lock")


def put_in_place(part: Path, path: Path) -> None:
    """Give a file its name, so that even a power cut leaves it under the old one or the new one."""
    os.replace(part, path)
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Force the names in a folder to the disk."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def is_at(path: Path, descriptor: int) -> bool:
    """Tell whether an open file still has a name: another process may have removed it meanwhile."""
    try:
        return os.path.samestat(path.stat(), os.fstat(descriptor))
    except FileNotFoundError:
        return False


def remove(path: Path) -> None:
    """Remove a file that may not be there; what goes wrong must not hide what went wrong before."""
    with suppress(OSError):
        path.unlink(missing_ok=True)


def check_is_new(path: Path) -> None:
    """Check that a file can be made.

    Raises:
        DatasetError: There is one, or no directory for it.
    """
    if path.exists():
        raise DatasetError(f"{path}: exists already and is never overwritten; choose another --out")
    if not path.parent.is_dir():
        raise DatasetError(f"{path}: the directory {path.parent} does not exist")


def probe_room(file: Path, n_bytes: int) -> None:
    """Find out whether a file may grow so far before HDF5 tries: it would leave a ruin.

    Raises:
        OSError: The disk is too small, or the operating system refuses.
    """
    free = shutil.disk_usage(file.parent).free
    if free < n_bytes + STRUCTURE_BYTES:
        text = f"{n_bytes / 1e6:.0f} MB needed, only {free / 1e6:.0f} MB free; free some space"
        raise OSError(errno.ENOSPC, text)
    with file.open("ab") as probed:
        size = file.stat().st_size
        os.ftruncate(probed.fileno(), size + n_bytes + STRUCTURE_BYTES)
        os.ftruncate(probed.fileno(), size)
