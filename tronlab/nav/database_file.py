"""The landmark database as a file: one HDF5 file that says what is in it, mapped when opened."""

import errno
import mmap
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from zlib import crc32

import h5py
import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError
from scipy.spatial.transform import RigidTransform

from tronlab import __version__
from tronlab.dataset.hdf5 import Hdf5Reader
from tronlab.errors import DatasetError, FrameError, IntegrityError, SchemaVersionError
from tronlab.geometry.poses import FloatArray, pose_from_xyz_quat
from tronlab.nav.database import LANDMARK_ARRAYS, Database, DatabaseDigest
from tronlab.nav.settings import DetectorSettings
from tronlab.yaml_models import Model

LAYOUT_ATTRIBUTE = "tronlab_landmarks"
LAYOUT = (1, 0)
"""A reader of this major version reads every minor one."""
DIGEST_ATTRIBUTE = "digest"
CRC32_ATTRIBUTE = "crc32"
ABOUT = "about"
LANDMARKS = "landmarks"
VIEW_POSES = "views/trs_from_cam"
VIEW_SOURCES = "views/source"
N_OFFERED = f"{LANDMARKS}/n_offered"
N_VERIFIED = f"{LANDMARKS}/n_verified"
COUNT_DTYPE = "<u4"

_ROWS_AT_ONCE = 1 << 16
_BUILD_HINT = "make one: tronlab database build DATASET.h5 --out DATABASE.h5"


class Source(Model):
    """Where some of the reference views came from."""

    kind: Literal["dataset", "campaign"]
    name: str
    """Of the file."""
    identity: str
    """What tells it from others: uuid of a dataset, hash of a campaign's files."""
    camera: dict[str, Any]
    """Intrinsics the views were rendered with, as ``CameraModel.to_dict`` gives them."""
    rig: str = ""
    """Name of the rig whose terrain they show."""
    views: str = ""
    """How the poses of the views were chosen."""


class Pruning(Model):
    """What was taken out of a database, and by whose word."""

    time_utc: str
    """ISO 8601."""
    from_digest: str
    """Of the database before."""
    n_before: int
    n_after: int
    datasets: tuple[str, ...]
    """Uuids of the datasets whose scores were asked; empty: none was."""
    rules: dict[str, Any]
    """What stayed, by name of the rule."""


class About(Model):
    """How a database came about."""

    made_utc: str
    """ISO 8601."""
    software: dict[str, str]
    detector: DetectorSettings
    sources: tuple[Source, ...]
    prunings: tuple[Pruning, ...] = ()

    @property
    def pruned_by(self) -> tuple[str, ...]:
        """Get the uuids of all datasets whose scores were asked."""
        return tuple(dict.fromkeys(uuid for step in self.prunings for uuid in step.datasets))


@dataclass(frozen=True, slots=True)
class Counts:
    """How landmarks did in scores: both of shape (n,)."""

    n_offered: NDArray[np.uint32]
    """In how many shots each lay within the usable area, large enough to be found."""
    n_verified: NDArray[np.uint32]
    """In how many of them a right pose rested on it."""


@dataclass(frozen=True, slots=True)
class DatabaseFile:
    """Everything in the file of a database."""

    database: Database
    about: About
    views_trs_from_cam: tuple[RigidTransform, ...]
    view_sources: NDArray[np.int64]
    """Index of the source of each view, shape (views,)."""
    counts: Counts | None
    """None in a database that no score was counted in."""


def open_database(path: Path) -> Database:
    """Open a database; its arrays are mapped, so that only what is used is ever read.

    Large arrays are not verified: ``verify_database`` does that.

    Raises:
        DatasetError: No such file, a directory, not HDF5, or not a database of landmarks.
        SchemaVersionError: Written in a layout of another major version.
        IntegrityError: Truncated or damaged.
    """
    with closing(_open(path)) as file:
        return _database(file, _about(file), _checked(file, VIEW_POSES))


def read_database_file(path: Path) -> DatabaseFile:
    """Open a database with everything that is known of it.

    Raises:
        DatasetError: As ``open_database``.
    """
    with closing(_open(path)) as file:
        about, poses = _about(file), _checked(file, VIEW_POSES)
        counts = None
        if N_VERIFIED in file:
            counts = Counts(_checked(file, N_OFFERED), _checked(file, N_VERIFIED))
        try:
            views = tuple(map(pose_from_xyz_quat, poses))
        except FrameError as error:
            raise IntegrityError(f"{path}: {VIEW_POSES} is damaged: {error}") from error
        return DatabaseFile(
            _database(file, about, poses), about, views, _checked(file, VIEW_SOURCES), counts
        )


def verify_database(path: Path) -> None:
    """Read all landmarks and compare them with the digest the file was made with.

    Raises:
        DatasetError: As ``open_database``; in particular ``IntegrityError`` if they differ.
    """
    database = open_database(path)
    digest = DatabaseDigest(database.detector)
    for first in range(0, len(database), _ROWS_AT_ONCE):
        rows = slice(first, first + _ROWS_AT_ONCE)
        digest.add(*(getattr(database, name)[rows] for name in LANDMARK_ARRAYS))
    if digest.of(database.p_views_trs_m) != database.digest:
        raise IntegrityError(
            f"{path}: the landmarks are damaged: they do not fit the file's digest; build it again"
            " or fetch it again from its source"
        )


def software() -> dict[str, str]:
    """Give the versions of what finds landmarks."""
    import cv2

    return {"tronlab": __version__, "opencv": cv2.__version__, "numpy": np.__version__}


def _open(path: Path) -> Hdf5Reader:
    if path.is_dir():
        raise DatasetError(f"{path}: is a directory, expected a file of landmarks; {_BUILD_HINT}")
    if not path.exists():
        raise DatasetError(f"{path}: no such file; {_BUILD_HINT}")
    try:
        if not h5py.is_hdf5(path):
            path.open("rb").close()  # a file that may not be read is not HDF5 to h5py either
            raise DatasetError(f"{path}: is not an HDF5 file, expected landmarks; {_BUILD_HINT}")
        file = h5py.File(path, "r")
    except PermissionError as error:
        raise DatasetError(f"{path}: may not be read; check its permissions") from error
    except (OSError, RuntimeError) as error:
        if getattr(error, "errno", None) in {errno.EACCES, errno.EPERM}:
            raise DatasetError(f"{path}: may not be read; check its permissions") from error
        raise IntegrityError(
            f"{path}: is damaged or was copied incompletely; fetch it again (HDF5: {error})"
        ) from error
    reader = Hdf5Reader(path, file)
    try:
        _check_layout(reader)
    except BaseException:
        reader.close()
        raise
    return reader


def _check_layout(file: Hdf5Reader) -> None:
    layout = file.attributes("/").get(LAYOUT_ATTRIBUTE)
    if layout is None:
        raise DatasetError(
            f"{file.path}: is an HDF5 file but no database of landmarks (no attribute"
            f" '{LAYOUT_ATTRIBUTE}'); {_BUILD_HINT}"
        )
    major, _, minor = str(layout).partition(".")
    if not (major.isdecimal() and minor.isdecimal()):
        raise IntegrityError(
            f"{file.path}: attribute '{LAYOUT_ATTRIBUTE}' is {layout!r}, expected major.minor"
        )
    if int(major) != LAYOUT[0]:
        raise SchemaVersionError(
            f"{file.path}: landmarks in layout {layout}; tronlab {__version__} reads layout"
            f" {LAYOUT[0]}.x; build the database again"
        )


def _about(file: Hdf5Reader) -> About:
    text = file.text(ABOUT)
    _check_crc32(file, ABOUT, text.encode())
    try:
        return About.model_validate_json(text, strict=True)
    except ValidationError as error:
        raise IntegrityError(f"{file.path}: {ABOUT} is damaged: {error}") from error


def _database(file: Hdf5Reader, about: About, poses: FloatArray) -> Database:
    digest = file.attributes("/").get(DIGEST_ATTRIBUTE)
    if not isinstance(digest, str):
        raise IntegrityError(f"{file.path}: is damaged: it has no digest")
    arrays = _mapped(file)
    return Database(
        arrays["p_trs_m"],
        arrays["size_m"],
        arrays["descriptors"],
        arrays["view"],
        np.ascontiguousarray(poses[:, :3]),
        about.detector,
        about.pruned_by,
        digest,
    )


def _mapped(file: Hdf5Reader) -> dict[str, NDArray[Any]]:
    """Map the arrays of the landmarks.

    Compiled kernels tell read-only arrays from others, so they are not marked as such; what would
    be written to them would stay in this process.
    """
    stored = {name: file.at(f"{LANDMARKS}/{name}") for name in LANDMARK_ARRAYS}
    _check_arrays(file.path, stored)
    try:
        with file.path.open("rb") as opened:
            mapping = mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_COPY)
        return {
            name: np.frombuffer(
                mapping, dataset.dtype, dataset.size, dataset.id.get_offset()
            ).reshape(dataset.shape)
            for name, dataset in stored.items()
        }
    except (OSError, ValueError) as error:
        raise IntegrityError(f"{file.path}: the landmarks cannot be mapped: {error}") from error


def _check_arrays(path: Path, stored: Mapping[str, Any]) -> None:
    n = len(stored["view"])
    shapes = {"p_trs_m": (n, 3), "size_m": (n,), "view": (n,)}
    for name, dataset in stored.items():
        is_of_shape = dataset.shape == shapes.get(name, (n, *dataset.shape[1:2]))
        is_whole = dataset.size and dataset.id.get_offset() is not None
        if not (is_whole and is_of_shape and dataset.dtype == LANDMARK_ARRAYS[name]):
            raise IntegrityError(
                f"{path}: {LANDMARKS}/{name} is damaged: {dataset.dtype} of shape {dataset.shape},"
                f" {n} landmarks expected, in one piece"
            )


def _checked(file: Hdf5Reader, path: str) -> NDArray[Any]:
    """Read a dataset and verify its checksum."""
    values = file.read(path)
    _check_crc32(file, path, np.ascontiguousarray(values).data)
    return values


def _check_crc32(file: Hdf5Reader, path: str, data: Any) -> None:
    if file.attributes(path).get(CRC32_ATTRIBUTE) != crc32(data):
        raise IntegrityError(
            f"{file.path}: {path} is damaged: its checksum does not match; build the database again"
        )
