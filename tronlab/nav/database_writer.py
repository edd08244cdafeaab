"""Writing the file of a database view by view, however many there are."""

from collections.abc import Generator, Mapping
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any
from zlib import crc32

import h5py
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.dataset.whole_file import whole_file
from tronlab.geometry.poses import FloatArray, xyz_quat_from_pose
from tronlab.nav import database_file as layout
from tronlab.nav.database import LANDMARK_ARRAYS, DatabaseDigest, Landmarks, check_enough
from tronlab.nav.database_file import About, Counts, DatabaseFile, Pruning, Source
from tronlab.nav.settings import DetectorSettings

_PAGE_BYTES = 4096
_BYTES_AT_ONCE = 1 << 22
_SPOOLED = (*LANDMARK_ARRAYS, "n_offered", "n_verified")
_UNITS = {"p_trs_m": "m", "size_m": "m"}
_MEANINGS = {
    "p_trs_m": "place on the terrain, frame trs",
    "size_m": "diameter of the neighbourhood on the terrain",
    "descriptors": "binary descriptors packed into bytes",
    "view": "index of the reference view it was found in",
}


class DatabaseWriter:
    """Takes landmarks in; ``new_database`` makes the file of them.

    Until then they are in nameless files, of which nothing is left whatever ends the process.
    """

    def __init__(self, detector: DetectorSettings, spools: Mapping[str, IO[bytes]]) -> None:
        self._spools = spools
        self._digest = DatabaseDigest(detector)
        self._poses: list[FloatArray] = []
        self._view_sources: list[int] = []
        self.detector = detector
        self.sources: list[Source] = []
        self.prunings: list[Pruning] = []
        self.n_landmarks = 0
        self._n_bytes = 0
        """Of a descriptor; 0 until there is one."""

    @property
    def n_views(self) -> int:
        """Get the number of views taken in."""
        return len(self._poses)

    def add(
        self,
        trs_from_cam: RigidTransform,
        landmarks: Landmarks,
        *,
        source: int,
        counts: Counts | None = None,
    ) -> None:
        """Take in the landmarks of the next view.

        Args:
            trs_from_cam: Of the view.
            landmarks: Those found in it, maybe none.
            source: Index in ``sources`` of where the view is from.
            counts: How these landmarks did in scores; for all views or for none.

        Raises:
            OSError: There is no room for them.
        """
        self._poses.append(xyz_quat_from_pose(trs_from_cam))
        self._view_sources.append(source)
        if not len(landmarks):
            return
        view = np.full(len(landmarks), self.n_views - 1)
        rows = landmarks.p_trs_m, landmarks.size_m, landmarks.descriptors, view
        self._digest.add(*rows)
        for (name, dtype), array in zip(LANDMARK_ARRAYS.items(), rows, strict=True):
            self._spools[name].write(np.ascontiguousarray(array, dtype).data)
        if counts is not None:
            self._spools["n_offered"].write(counts.n_offered.astype(layout.COUNT_DTYPE).data)
            self._spools["n_verified"].write(counts.n_verified.astype(layout.COUNT_DTYPE).data)
        self._n_bytes = landmarks.descriptors.shape[1]
        self.n_landmarks += len(landmarks)

    def write(self, path: Path) -> str:
        """Write everything to a file, and give the digest of the database.

        Raises:
            ScoreError: The landmarks are too few to serve any shot.
            OSError: It cannot be written.
        """
        check_enough(self.detector, n_views=self.n_views, n_landmarks=self.n_landmarks)
        poses = np.array(self._poses)
        digest = self._digest.of(poses[:, :3])
        with h5py.File(
            path, "w", alignment_threshold=_PAGE_BYTES, alignment_interval=_PAGE_BYTES
        ) as file:
            file.attrs[layout.LAYOUT_ATTRIBUTE] = ".".join(map(str, layout.LAYOUT))
            file.attrs[layout.DIGEST_ATTRIBUTE] = digest
            self._write_landmarks(file)
            stored = _write_checked(file, layout.VIEW_POSES, poses)
            stored.attrs.update(parent="trs", child="cam", order="x y z qx qy qz qw", units="m")
            _write_checked(file, layout.VIEW_SOURCES, np.array(self._view_sources, np.int64))
            about = self._about().model_dump_json(indent=1)
            file[layout.ABOUT] = about
            file[layout.ABOUT].attrs[layout.CRC32_ATTRIBUTE] = crc32(about.encode())
        return digest

    def _about(self) -> About:
        return About(
            made_utc=datetime.now(UTC).isoformat(timespec="seconds"),
            software=layout.software(),
            detector=self.detector,
            sources=tuple(self.sources),
            prunings=tuple(self.prunings),
        )

    def _write_landmarks(self, file: Any) -> None:
        n = self.n_landmarks
        shapes = {"p_trs_m": (n, 3), "descriptors": (n, self._n_bytes)}
        for name, dtype in LANDMARK_ARRAYS.items():
            stored = file.create_dataset(
                f"{layout.LANDMARKS}/{name}", shapes.get(name, (n,)), dtype
            )
            _copy(self._spools[name], stored)
            stored.attrs["meaning"] = _MEANINGS[name]
            if name in _UNITS:
                stored.attrs["units"] = _UNITS[name]
        if self._spools["n_verified"].tell():
            for path in (layout.N_OFFERED, layout.N_VERIFIED):
                spool = self._spools[path.rpartition("/")[2]]
                spool.seek(0)
                _write_checked(file, path, np.frombuffer(spool.read(), layout.COUNT_DTYPE))


@contextmanager
def new_database(path: Path, detector: DetectorSettings) -> Generator[DatabaseWriter]:
    """Give a writer; the file is made when the block ends well, else nothing is left of it.

    Raises:
        DatasetError: The file exists, or cannot be made.
        ScoreError: The landmarks are too few to serve any shot.
    """
    with whole_file(path) as part, ExitStack() as stack:
        spools = {name: stack.enter_context(TemporaryFile(dir=path.parent)) for name in _SPOOLED}
        writer = DatabaseWriter(detector, spools)
        yield writer
        writer.write(part)


def save_selection(
    source: DatabaseFile,
    chosen: NDArray[np.intp],
    p_trs_m: FloatArray,
    path: Path,
    *,
    pruning: Pruning,
    counts: Counts | None,
) -> None:
    """Write some of the landmarks of a database to a new file.

    Args:
        source: The database.
        chosen: Indices of the landmarks that stay, ascending, shape (m,).
        p_trs_m: Their places, shape (m, 3).
        path: The new file.
        pruning: Why these.
        counts: Of all landmarks of ``source``; those of the chosen go to the file.

    Raises:
        DatasetError: The file exists, or cannot be made.
        ScoreError: Too few landmarks are left.
    """
    database = source.database
    ends = np.searchsorted(
        database.view[chosen], np.arange(len(source.views_trs_from_cam)), "right"
    )
    with new_database(path, database.detector) as writer:
        writer.sources.extend(source.about.sources)
        writer.prunings.extend([*source.about.prunings, pruning])
        pieces = np.split(chosen, ends[:-1]), np.split(p_trs_m, ends[:-1])
        for view, (rows, places_m) in enumerate(zip(*pieces, strict=True)):
            writer.add(
                source.views_trs_from_cam[view],
                Landmarks(places_m, database.size_m[rows], database.descriptors[rows]),
                source=int(source.view_sources[view]),
                counts=counts and Counts(counts.n_offered[rows], counts.n_verified[rows]),
            )


def _write_checked(file: Any, path: str, values: NDArray[Any]) -> Any:
    stored = file.create_dataset(path, data=values)
    stored.attrs[layout.CRC32_ATTRIBUTE] = crc32(np.ascontiguousarray(values).data)
    return stored


def _copy(spool: IO[bytes], stored: Any) -> None:
    """Copy the rows of a file of raw values into a dataset, a piece at a time."""
    n_bytes = stored.nbytes // len(stored)
    step = max(1, _BYTES_AT_ONCE // n_bytes)
    spool.seek(0)
    for first in range(0, len(stored), step):
        values = np.frombuffer(spool.read(step * n_bytes), stored.dtype)
        stored[first : first + step] = values.reshape(-1, *stored.shape[1:])
