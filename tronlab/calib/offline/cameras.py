"""Camera models from files: tronlab's record, OpenCV's YAML or XML, ViSP's XML."""

from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np

from tronlab.calib.offline.files import read_text
from tronlab.calib.record import CalibrationRecord
from tronlab.errors import CalibrationError
from tronlab.geometry.camera import N_DISTORTION, CameraModel

UNDERSTOOD = "a tronlab record (.json), OpenCV's camera file (.yml, .yaml, .xml), ViSP's (.xml)"


def read_camera(path: Path) -> CameraModel:
    """Read the intrinsics of a camera.

    Raises:
        CalibrationError: The file cannot be read, is none of the kinds understood, or lacks a
            value.
    """
    text = read_text(path)
    if path.suffix.lower() == ".json":
        return CalibrationRecord.load(path).camera
    if "<model>" in text and "<px>" in text:
        camera = _read_visp(text, path)
    elif "camera_matrix" in text:
        camera = _read_opencv(text, path)
    else:
        raise CalibrationError(f"{path}: is no camera file; understood are {UNDERSTOOD}")
    if not (camera.fx_px > 0 and camera.fy_px > 0):  # also for NaN
        raise CalibrationError(
            f"{path}: focal lengths {camera.fx_px:g} and {camera.fy_px:g} px, both must be above 0"
        )
    return camera


def _read_visp(text: str, path: Path) -> CameraModel:
    """Read ViSP's perspective model; its ``kud`` is the first radial coefficient."""
    try:
        root = ElementTree.fromstring(text)  # noqa: S314  # a file the user names, no entities used
        values = {
            name: float(str(root.findtext(f".//{name}")))
            for name in ("image_width", "image_height", "px", "py", "u0", "v0")
        }
        distortion = float(root.findtext(".//kud") or 0.0)
    except (ElementTree.ParseError, ValueError) as error:
        raise CalibrationError(
            f"{path}: is no complete ViSP camera (image_width, image_height, px, py, u0, v0):"
            f" {error}"
        ) from error
    return CameraModel(
        width_px=int(values["image_width"]),
        height_px=int(values["image_height"]),
        fx_px=values["px"],
        fy_px=values["py"],
        cx_px=values["u0"],
        cy_px=values["v0"],
        distortion=(distortion,),
    )


def _read_opencv(text: str, path: Path) -> CameraModel:
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        matrix = storage.getNode("camera_matrix").mat()
        coefficients = storage.getNode("distortion_coefficients").mat()
        size = [int(storage.getNode(name).real()) for name in ("image_width", "image_height")]
    except (cv2.error, SystemError) as error:  # the latter for XML that breaks off
        raise CalibrationError(f"{path}: OpenCV cannot read a camera from it: {error}") from error
    # OpenCV's stubs do not say that a node that is missing gives None.
    if matrix is None or matrix.shape != (3, 3) or min(size) < 1:  # pyright: ignore[reportUnnecessaryComparison]
        raise CalibrationError(f"{path}: needs camera_matrix (3 x 3), image_width and image_height")
    found = [] if coefficients is None else np.ravel(coefficients).tolist()  # pyright: ignore[reportUnnecessaryComparison]
    if any(found[N_DISTORTION:]):
        raise CalibrationError(
            f"{path}: distortion_coefficients: thin prism and tilt (from the ninth on) are not"
            " known; calibrate without them"
        )
    return CameraModel(
        width_px=size[0],
        height_px=size[1],
        fx_px=float(matrix[0, 0]),
        fy_px=float(matrix[1, 1]),
        cx_px=float(matrix[0, 2]),
        cy_px=float(matrix[1, 2]),
        distortion=tuple(found[:N_DISTORTION]),
    )
