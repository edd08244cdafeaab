"""The intrinsics of a camera that is not ours, from whatever file they are in."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tronlab.calib.offline.cameras import read_camera
from tronlab.calib.record import CalibrationRecord
from tronlab.dataset.exchange.folder import CAMERA_JSON
from tronlab.dataset.exchange.text_files import read_text
from tronlab.errors import CalibrationError, DatasetError
from tronlab.geometry.camera import CameraModel

_NO_RECORD = "{}"
"""Stands for the calibration record where there is none."""


@dataclass(frozen=True)
class CameraFile:
    """Intrinsics, and the rest of the calibration record if they come from one."""

    model: CameraModel
    path: Path
    record: CalibrationRecord | None = None
    record_text: str = _NO_RECORD


def camera_beside(csv_path: Path) -> Path:
    """Give the camera file beside a table of shots.

    Raises:
        DatasetError: There is none.
    """
    path = csv_path.parent / CAMERA_JSON
    if not path.is_file():
        raise DatasetError(
            f"{csv_path}: there is no {CAMERA_JSON} beside it; name the camera's intrinsics with"
            " --camera"
        )
    return path


def read_camera_file(path: Path) -> CameraFile:
    """Read intrinsics: tronlab's own two kinds of JSON, or another program's camera file.

    Raises:
        CalibrationError: The file is no camera, or the camera cannot be.
        DatasetError: The file cannot be read.
    """
    if path.suffix.lower() != ".json":
        return CameraFile(read_camera(path), path)
    text = read_text(path)
    values = _json_object(text, path)
    if "width_px" in values:
        try:
            return CameraFile(_checked(CameraModel.from_dict(values)), path)
        except CalibrationError as error:
            raise CalibrationError(f"{path}: {error}") from error
    if "schema" not in values:
        raise CalibrationError(
            f"{path}: is no camera: expected width_px, height_px, fx_px, fy_px, cx_px, cy_px and"
            " distortion, or a calibration record"
        )
    record = CalibrationRecord.from_json(text, source=str(path))
    return CameraFile(record.camera, path, record, text)


def _json_object(text: str, path: Path) -> dict[str, object]:
    try:
        values = json.loads(text)
    except json.JSONDecodeError as error:
        raise CalibrationError(f"{path}:{error.lineno}: not JSON: {error.msg}") from error
    if not isinstance(values, dict):
        raise CalibrationError(f"{path}: is no camera: expected a JSON object")
    return values


def _checked(camera: CameraModel) -> CameraModel:
    numbers = (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *camera.distortion)
    if not np.isfinite(numbers).all():
        raise CalibrationError("a number is not finite")
    if min(camera.fx_px, camera.fy_px, *camera.shape) <= 0:
        raise CalibrationError("focal lengths and image size must be above 0")
    return camera
