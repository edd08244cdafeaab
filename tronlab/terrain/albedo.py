"""The paint of a terrain model: a grey picture stretched over it."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tronlab.terrain.heightmap import WHITE, TerrainError

_ASPECT_TOLERANCE = 0.02
_ALLOWED = "grey PNG or TIFF of 8 or 16 bit"


def read_albedo(path: Path, shape: tuple[int, int]) -> NDArray[np.uint16]:
    """Read a picture whose rows run down the model (+X_TRS) and stretch it over the model.

    Args:
        path: A grey picture of 8 or 16 bit; white is albedo 1.
        shape: Rows and columns of the height map.

    Returns:
        Relative albedo of each sample, ``shape``; ``WHITE`` is 1.

    Raises:
        TerrainError: The file is missing, is no such picture, or has another aspect than the model.
    """
    import cv2

    if not path.is_file():
        raise TerrainError(
            f"albedo map {path} does not exist; a relative path starts from the rig file's folder"
        )
    picture: Any = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise TerrainError(f"albedo map {path}: cannot be read as a picture (allowed: {_ALLOWED})")
    if picture.ndim != 2 or picture.dtype not in {np.dtype(np.uint8), np.dtype(np.uint16)}:
        raise TerrainError(
            f"albedo map {path}: is {picture.dtype} of shape {picture.shape} (allowed: {_ALLOWED})"
        )
    _check_aspect(path, picture.shape, shape)
    albedo = picture.astype(np.uint16)
    if picture.dtype == np.uint8:
        albedo *= WHITE // 255
    is_coarser = shape[0] < picture.shape[0]
    how = cv2.INTER_AREA if is_coarser else cv2.INTER_LINEAR
    stretched: Any = cv2.resize(albedo, shape[::-1], interpolation=how)
    return np.ascontiguousarray(stretched)


def _check_aspect(path: Path, picture: tuple[int, int], model: tuple[int, int]) -> None:
    width_per_height = (model[1] - 1) / (model[0] - 1)
    if abs(picture[1] / picture[0] / width_per_height - 1) > _ASPECT_TOLERANCE:
        raise TerrainError(
            f"albedo map {path}: has {picture[0]} x {picture[1]} pixels, the model is"
            f" {width_per_height:.3f} times as wide as high; crop the picture to that"
        )
