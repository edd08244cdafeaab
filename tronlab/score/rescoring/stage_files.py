"""Results of single stages of cores, a file each: written by whichever process has one."""

import contextlib
import os
import tempfile
from pathlib import Path

from tronlab.nav.stages import Arrays
from tronlab.score.rescoring.packing import PackingError, pack, unpack

LAYOUT = 1
"""Part of the folder's name; raised with every change of the layout."""
MOST_BYTES = 8 << 30
"""So much is kept; then those go that were not used for longest."""

_SHARE_KEPT = 0.8
_SHARE_BEFORE_LOOK = 1 / 32
"""Of ``MOST_BYTES``: so much a process writes before it looks how much there is in all."""
_ABANDONED_S = 3600.0
"""Age of a file that its writer will not finish any more."""


class StageFiles:
    """A ``StageStore`` in a folder; what cannot be kept or read is quietly computed anew."""

    def __init__(self, folder: Path, *, most_bytes: int = MOST_BYTES) -> None:
        self.folder = folder / f"stages-{LAYOUT}"
        self._most_bytes = most_bytes
        self._n_bytes_written = 0

    def load(self, stage: str, key: str) -> Arrays | None:
        """Give what was saved, or None."""
        path = self._path(stage, key)
        try:
            _, arrays = unpack(_read(path))
        except OSError:
            return None
        except PackingError:
            path.unlink(missing_ok=True)
            return None
        with contextlib.suppress(OSError):
            os.utime(path)
        return arrays

    def save(self, stage: str, key: str, arrays: Arrays) -> None:
        """Keep arrays under their key, whole or not at all."""
        packed = pack({}, arrays)
        with contextlib.suppress(OSError):
            _write(self._path(stage, key), packed)
            self._n_bytes_written += len(packed)
            if self._n_bytes_written > _SHARE_BEFORE_LOOK * self._most_bytes:
                self._n_bytes_written = 0
                self.drop_oldest()

    def drop_oldest(self) -> None:
        """Remove what was not used for longest, if there is too much; and what was abandoned."""
        files = sorted(_files(self.folder))
        for used_s, _, path in files:
            if path.suffix == ".part" and used_s < files[-1][0] - _ABANDONED_S:
                path.unlink(missing_ok=True)
        spare = sum(n_bytes for _, n_bytes, _ in files) - self._most_bytes
        if spare <= 0:
            return
        spare += (1.0 - _SHARE_KEPT) * self._most_bytes
        for _, n_bytes, path in files:
            if spare <= 0:
                return
            path.unlink(missing_ok=True)
            spare -= n_bytes

    def _path(self, stage: str, key: str) -> Path:
        return self.folder / stage / key[:2] / f"{key}.bin"


def _read(path: Path) -> bytearray:
    """Read a file at once: a database may be large, and a copy of it too much."""
    with path.open("rb") as file:
        content = bytearray(os.fstat(file.fileno()).st_size)
        n_read = file.readinto(content)
    return content[:n_read] if n_read < len(content) else content


def _write(path: Path, packed: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor, name = tempfile.mkstemp(suffix=".part", dir=path.parent)
    part = Path(name)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(packed)
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def _files(folder: Path) -> list[tuple[float, int, Path]]:
    """Give when each file was used last (Unix time), its size and its path."""
    found: list[tuple[float, int, Path]] = []
    for path in folder.glob("*/*/*"):
        with contextlib.suppress(OSError):  # another process may have removed it
            status = path.stat()
            found.append((status.st_mtime, status.st_size, path))
    return found
