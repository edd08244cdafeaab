"""Sets of images and poses that others made, as far as scoring needs them."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.dataset.exchange.images import read_grey, read_mask
from tronlab.dataset.records import ReferenceView, ShotRecord, Truth
from tronlab.devices.readings import Frame
from tronlab.errors import DatasetError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray

_MONO12_MAX = 4095
_UNKNOWN_FRAME = -1


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
