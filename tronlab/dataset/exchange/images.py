"""Image files: written without loss, and read as grey values whatever they are."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tronlab.errors import DatasetError

_COMPRESSION = 1
"""Of zlib; 3 takes half as long again and makes files 2 % smaller."""
_AS_GREY = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION


def write_png(path: Path, image: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    """Write grey values, shape (rows, columns), as they are: 8 or 16 bit by their type.

    Raises:
        OSError: The disk does not take the file.
    """
    parameters = [cv2.IMWRITE_PNG_COMPRESSION, _COMPRESSION]
    _, content = cv2.imencode(".png", image, parameters)
    path.write_bytes(content.tobytes())


def write_mask(path: Path, mask: NDArray[np.bool_]) -> None:
    """Write a mask as 8-bit PNG: 255 where it is true, else 0.

    Raises:
        OSError: The disk does not take the file.
    """
    write_png(path, mask.astype(np.uint8) * np.uint8(255))


def read_grey(path: Path, *, where: str) -> NDArray[Any]:
    """Read an image file as grey values, shape (rows, columns); colours become their luma.

    Args:
        path: The file.
        where: Who names it, for messages.

    Raises:
        DatasetError: It cannot be read, or is no image of 8 or 16 bit.
    """
    try:
        content = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    except OSError as error:
        raise DatasetError(f"{where}: {path}: {error.strerror}") from error
    image = cv2.imdecode(content, _AS_GREY) if content.size else None
    if image is None or image.dtype.name not in {"uint8", "uint16"}:
        kind = "no image that can be read" if image is None else f"an image of {image.dtype}"
        raise DatasetError(f"{where}: {path}: is {kind}; expected PNG, TIFF or JPEG, 8 or 16 bit")
    return image


def read_mask(path: Path, *, where: str) -> NDArray[np.bool_]:
    """Read a mask: true where the image is not 0.

    Raises:
        DatasetError: As ``read_grey``.
    """
    return read_grey(path, where=where) > 0
