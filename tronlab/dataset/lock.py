"""One process at a time records into a dataset; the lock file says which."""

import fcntl
import json
import os
import socket
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from tronlab.dataset.places import is_at, lock_path
from tronlab.dataset.skeleton import utc_now
from tronlab.errors import DatasetError

_N_TRIES: Final = 5
_BETWEEN_TRIES_S: Final = 0.02
"""Whoever looks whether a lock is held holds it for a moment."""


@dataclass(frozen=True, slots=True)
class LockHolder:
    """Who records into a dataset."""

    pid: int
    host: str
    since_utc: str
    """ISO 8601."""

    def __str__(self) -> str:
        """Give pid, host and time for a message."""
        return f"process {self.pid} on {self.host}, since {self.since_utc}"


@contextmanager
def run_lock(dataset_path: Path) -> Generator[None]:
    """Keep others from recording into a dataset.

    A lock whose process died is taken over: the operating system released it.

    Raises:
        DatasetError: Another process records, or the lock file cannot be made.
    """
    path = lock_path(dataset_path)
    try:
        descriptor = _acquired(path)
    except OSError as error:
        raise DatasetError(f"{path}: the lock cannot be made: {error.strerror}") from error
    if descriptor is None:
        raise DatasetError(
            f"{dataset_path}: is being recorded by {_signature(path) or 'another process'}; wait"
            " until that has ended, or stop it"
        )
    try:
        yield
    finally:
        with suppress(OSError):  # a lock nobody holds is no hindrance
            path.unlink()
        os.close(descriptor)


def lock_holder(dataset_path: Path) -> LockHolder | None:
    """Tell who records into a dataset; None if nobody does.

    Raises:
        DatasetError: The lock file cannot be read.
    """
    path = lock_path(dataset_path)
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read: {error.strerror}") from error
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return _signature(path) or LockHolder(pid=0, host="unknown", since_utc="unknown")
    finally:
        os.close(descriptor)
    return None


def _acquired(path: Path) -> int | None:
    """Give the descriptor of a lock file that is ours; None if it is somebody else's."""
    for _ in range(_N_TRIES):
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if is_at(path, descriptor):  # its last holder may have removed it meanwhile
                _sign(descriptor)
                return descriptor
        except BlockingIOError:
            pass
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)
        time.sleep(_BETWEEN_TRIES_S)
    return None


def _sign(descriptor: int) -> None:
    holder = {"pid": os.getpid(), "host": socket.gethostname(), "since_utc": utc_now()}
    os.ftruncate(descriptor, 0)
    os.pwrite(descriptor, json.dumps(holder).encode(), 0)


def _signature(path: Path) -> LockHolder | None:
    try:
        values = json.loads(path.read_text(encoding="utf-8", errors="replace"))
        return LockHolder(int(values["pid"]), str(values["host"]), str(values["since_utc"]))
    except (OSError, ValueError, TypeError, KeyError):
        return None
