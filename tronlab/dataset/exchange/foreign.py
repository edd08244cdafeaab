"""Sets of images and poses that others made, read as far as scoring needs them."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.dataset.exchange.association import associate
from tronlab.dataset.exchange.folder import (
    COVARIANCE_COLUMNS,
    NOMINAL_COLUMNS,
    POSE_COLUMNS,
    REFERENCE_COLUMNS,
    REFERENCES_CSV,
    SHOT_COLUMNS,
    UPPER_TRIANGLE,
)
from tronlab.dataset.exchange.images import read_grey, read_mask
from tronlab.dataset.exchange.text_files import (
    Row,
    number,
    pose_of_numbers,
    poses_of_numbers,
    read_lines,
    read_table,
)
from tronlab.dataset.records import ReferenceView, ShotRecord, Truth
from tronlab.devices.readings import Frame
from tronlab.errors import DatasetError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray

_MONO12_MAX = 4095
_UNKNOWN_FRAME = -1
_IMAGE_LIST = ("timestamp", "filename")
_TRAJECTORY = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
TUM_MAX_DIFFERENCE_S = 0.02
"""What the benchmark's own tool takes for the same time."""


@dataclass(frozen=True, slots=True)
class ForeignShot:
    """An image and what is said of it; NaN or None is what is not."""

    shot_id: int
    where: str
    """File and line that it comes from, for messages."""
    image_path: Path
    trs_from_cam: RigidTransform
    mask_path: Path | None = None
    planned_trs_from_cam: RigidTransform | None = None
    """Where the camera was to be."""
    covariance: FloatArray | None = None
    """Of (rotation vector, translation) in trs, (6, 6), rad and m."""
    range_los_m: float = np.nan
    time_s: float = np.nan
    exposure_s: float = np.nan
    gain_db: float = np.nan
    pixel_format: str | None = None

    @property
    def trs_from_cam_nominal(self) -> RigidTransform:
        """Get where the camera was to be; where it was, if no plan is known."""
        if self.planned_trs_from_cam is None:
            return self.trs_from_cam
        return self.planned_trs_from_cam

    def image(self, camera: CameraModel) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """Read the image.

        Raises:
            DatasetError: It cannot be read, or is not of the camera's size.
        """
        image = read_grey(self.image_path, where=self.where)
        _check_size(image, camera, f"{self.where}: {self.image_path}")
        return image

    def mask(self, camera: CameraModel) -> NDArray[np.bool_] | None:
        """Read the mask; None if there is none.

        Raises:
            DatasetError: As ``image``.
        """
        if self.mask_path is None:
            return None
        mask = read_mask(self.mask_path, where=self.where)
        _check_size(mask, camera, f"{self.where}: {self.mask_path}")
        return mask


@dataclass(frozen=True, slots=True)
class ForeignView:
    """A reference view in files."""

    view_id: int
    where: str
    trs_from_cam: RigidTransform
    image_path: Path
    mask_path: Path
    depth_path: Path

    def read(self, camera: CameraModel) -> ReferenceView:
        """Read image, mask and depth.

        Raises:
            DatasetError: A file cannot be read, or is not of the camera's size or of another type.
        """
        image = read_grey(self.image_path, where=self.where)
        mask = read_mask(self.mask_path, where=self.where)
        depth_m = _read_depth(self.depth_path, self.where)
        for array, path in (
            (image, self.image_path),
            (mask, self.mask_path),
            (depth_m, self.depth_path),
        ):
            _check_size(array, camera, f"{self.where}: {path}")
        if image.dtype != np.uint8:
            raise DatasetError(f"{self.where}: {self.image_path}: is {image.dtype}, expected 8 bit")
        return ReferenceView(self.view_id, self.trs_from_cam, image, depth_m, mask)


@dataclass(frozen=True, slots=True)
class ForeignSet:
    """A set of images with poses, and reference views if it has some."""

    shots: tuple[ForeignShot, ...]
    views: tuple[ForeignView, ...] = ()
    notes: tuple[str, ...] = field(default=())
    """What a person should know of how it was read."""


def read_folder(csv_path: Path) -> ForeignSet:
    """Read a table of shots as ``FolderExporter`` writes it, and the reference views beside it.

    Columns needed are shot_id, image, x_m, y_m, z_m, qx, qy, qz, qw; files are relative to the
    table.

    Raises:
        DatasetError: A table cannot be read or says something that cannot be.
    """
    required = ("shot_id", "image", *POSE_COLUMNS)
    rows = read_table(csv_path, required=required, known=SHOT_COLUMNS)
    shots = tuple(_shot(row, csv_path.parent) for row in rows)
    _check_ids("shot_id", [shot.shot_id for shot in shots], csv_path)
    references = csv_path.parent / REFERENCES_CSV
    views = _views(references) if references.exists() else ()
    return ForeignSet(shots, views)


def read_tum(
    images_path: Path,
    trajectory_path: Path,
    *,
    max_difference_s: float = TUM_MAX_DIFFERENCE_S,
    offset_s: float = 0.0,
) -> ForeignSet:
    """Read a list of images and a trajectory in TUM's format; an image takes the nearest pose.

    Nothing is interpolated: the pose is that of another moment, up to ``max_difference_s`` away.
    Shots are numbered from 1 in the order of the list.

    Args:
        images_path: Rows of ``timestamp filename``; files are relative to the list.
        trajectory_path: Rows of ``timestamp tx ty tz qx qy qz qw``.
        max_difference_s: Images without a pose so near in time are left out.
        offset_s: Added to the times of the trajectory.

    Raises:
        DatasetError: A file cannot be read, has no rows or one that cannot be, or no image has a
            pose.
    """
    images = [
        (where, number(stamp, where), images_path.parent / name)
        for where, (stamp, name) in read_lines(images_path, columns=_IMAGE_LIST)
    ]
    times_s, poses = read_trajectory(trajectory_path)
    pairs = associate(
        [time_s for _, time_s, _ in images],
        times_s,
        max_difference_s=max_difference_s,
        offset_b_s=offset_s,
    )
    if not pairs.i_a.size:
        raise DatasetError(
            f"{images_path}: none of {len(images)} images has a pose in {trajectory_path} within"
            f" {max_difference_s:g} s; check the time stamps, or name an offset"
        )
    shots = tuple(
        ForeignShot(
            shot_id=i + 1,
            where=images[i][0],
            image_path=images[i][2],
            trs_from_cam=poses[j],
            time_s=images[i][1],
        )
        for i, j in zip(pairs.i_a.tolist(), pairs.i_b.tolist(), strict=True)
    )
    note = (
        f"{len(shots)} of {len(images)} images have a pose within {max_difference_s:g} s; the pose"
        f" is of another moment by {np.abs(pairs.difference_s).max() * 1e3:.3f} ms at most, nothing"
        " was interpolated"
    )
    return ForeignSet(shots, notes=(note,))


def read_trajectory(path: Path) -> tuple[FloatArray, RigidTransform]:
    """Read a trajectory in TUM's format, rows of ``timestamp tx ty tz qx qy qz qw``.

    Returns:
        Times, seconds, and poses, both of shape (n,).

    Raises:
        DatasetError: The file cannot be read, has no rows, or a row is no pose.
    """
    rows = list(read_lines(path, columns=_TRAJECTORY))
    if not rows:
        raise DatasetError(f"{path}: has no poses")
    values = np.array([[number(word, where) for word in words] for where, words in rows])
    return values[:, 0], poses_of_numbers(values[:, 1:], [where for where, _ in rows])


def shot_record(
    shot: ForeignShot, camera: CameraModel, *, mask: NDArray[np.bool_], range_los_m: float
) -> ShotRecord:
    """Make the record of a foreign shot; what no laboratory of ours measured stays unknown.

    Args:
        shot: The shot.
        camera: Whose image it is.
        mask: True where the model is seen, shape (rows, columns).
        range_los_m: Distance to the terrain along the optical axis.

    Raises:
        DatasetError: The image cannot be read, or is not of the camera's size.
    """
    image = shot.image(camera)
    unknown = np.full((6, 6), np.nan)
    return ShotRecord(
        shot_id=shot.shot_id,
        attempt=1,
        trs_from_cam_nominal=shot.trs_from_cam_nominal,
        robot=None,
        tracker=None,
        room=None,
        frame=Frame(
            image=image,
            pixel_format=shot.pixel_format or _pixel_format(image),
            exposure_s=shot.exposure_s,
            gain_db=shot.gain_db,
            frame_id=_UNKNOWN_FRAME,
            time_s=shot.time_s,
        ),
        mask=mask,
        truth=Truth(
            trs_from_cam=shot.trs_from_cam,
            covariance=unknown if shot.covariance is None else shot.covariance,
            range_los_m=range_los_m,
            usable_fraction=float(mask.mean()),
        ),
    )


def _shot(row: Row, folder: Path) -> ForeignShot:
    pose = row.numbers(POSE_COLUMNS)
    if pose is None:
        raise DatasetError(f"{row.where}: has no pose: {', '.join(POSE_COLUMNS)} are empty")
    nominal = row.numbers(NOMINAL_COLUMNS)
    shot_id = row.integer("shot_id")
    if shot_id < 0:
        raise DatasetError(f"{row.where}: shot_id is {shot_id}, must be 0 or more")
    return ForeignShot(
        shot_id=shot_id,
        where=row.where,
        image_path=folder / row.text("image"),
        mask_path=folder / row.text("mask") if "mask" in row.cells else None,
        trs_from_cam=pose_of_numbers(pose, row.where),
        planned_trs_from_cam=None if nominal is None else pose_of_numbers(nominal, row.where),
        covariance=_covariance(row),
        range_los_m=_range(row),
        time_s=row.number("time_s"),
        exposure_s=row.number("exposure_s"),
        gain_db=row.number("gain_db"),
        pixel_format=row.cells.get("pixel_format"),
    )


def _range(row: Row) -> float:
    range_los_m = row.number("range_los_m")
    if range_los_m <= 0:
        raise DatasetError(f"{row.where}: range_los_m is {range_los_m:g}, must be above 0")
    return range_los_m


def _covariance(row: Row) -> FloatArray | None:
    values = row.numbers(COVARIANCE_COLUMNS)
    if values is None:
        return None
    covariance = np.zeros((6, 6))
    for (i, j), value in zip(UPPER_TRIANGLE, values, strict=True):
        covariance[i, j] = covariance[j, i] = value
    return covariance


def _views(path: Path) -> tuple[ForeignView, ...]:
    rows = read_table(path, required=REFERENCE_COLUMNS, known=REFERENCE_COLUMNS)
    views = tuple(_view(row, path.parent) for row in rows)
    _check_ids("view_id", [view.view_id for view in views], path)
    return views


def _view(row: Row, folder: Path) -> ForeignView:
    pose = row.numbers(POSE_COLUMNS)
    if pose is None:
        raise DatasetError(f"{row.where}: has no pose: {', '.join(POSE_COLUMNS)} are empty")
    return ForeignView(
        view_id=row.integer("view_id"),
        where=row.where,
        trs_from_cam=pose_of_numbers(pose, row.where),
        image_path=folder / row.text("image"),
        mask_path=folder / row.text("mask"),
        depth_path=folder / row.text("depth"),
    )


def _check_ids(name: str, ids: list[int], path: Path) -> None:
    twice = [str(i) for i, n in Counter(ids).items() if n > 1]
    if twice:
        raise DatasetError(f"{path}: {name} must be unique; more than once: {', '.join(twice)}")


def _check_size(image: NDArray[Any], camera: CameraModel, where: str) -> None:
    if image.shape != camera.shape:
        rows, columns = image.shape
        raise DatasetError(
            f"{where}: has {columns} x {rows} pixels, the camera {camera.width_px} x"
            f" {camera.height_px}"
        )


def _read_depth(path: Path, where: str) -> NDArray[np.float32]:
    try:
        depth_m = np.load(path, allow_pickle=False)
    except OSError as error:
        raise DatasetError(f"{where}: {path}: {error.strerror or error}") from error
    except ValueError as error:
        raise DatasetError(f"{where}: {path}: is no array of NumPy: {error}") from error
    if depth_m.dtype != np.float32 or depth_m.ndim != 2:
        raise DatasetError(
            f"{where}: {path}: is {depth_m.dtype} of shape {depth_m.shape}, expected float32 (rows,"
            " columns)"
        )
    return depth_m


def _pixel_format(image: NDArray[np.uint8] | NDArray[np.uint16]) -> str:
    if image.dtype == np.uint8:
        return "Mono8"
    return "Mono12" if image.max() <= _MONO12_MAX else "Mono16"
