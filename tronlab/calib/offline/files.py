"""Reading recorded files, with errors that name the file and the row."""

import hashlib
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.errors import CalibrationError, FrameError
from tronlab.geometry.poses import FloatArray, pose_from_matrix

IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm"})
_QUATERNION_TOLERANCE = 1e-3
"""Text files are rounded, some to four digits."""
_ROTATION_TOLERANCE = 1e-4


def read_bytes(path: Path) -> bytes:
    """Read a file.

    Raises:
        CalibrationError: It cannot be read.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise CalibrationError(f"{path}: {error.strerror}") from error


def read_text(path: Path) -> str:
    """Read a text file.

    Raises:
        CalibrationError: It cannot be read, or is no text.
    """
    return decode(read_bytes(path), str(path))


def decode(content: bytes, source: str) -> str:
    """Give the text of a file.

    Raises:
        CalibrationError: It is no text.
    """
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise CalibrationError(f"{source}: is not a text file") from error


def sha256(path: Path) -> str:
    """Give the hash of a file."""
    return hashlib.sha256(read_bytes(path)).hexdigest()


def hashes(paths: Iterable[Path]) -> dict[str, str]:
    """Give the hash of each file by its name."""
    return {path.name: sha256(path) for path in paths}


def written_utc(paths: Iterable[Path]) -> str:
    """Give when the latest of the files was written: the best date that files carry."""
    latest = max(path.stat().st_mtime for path in paths)
    return datetime.fromtimestamp(latest, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def images_in(paths: Sequence[Path]) -> list[Path]:
    """Give the images among files and folders, in the order of their names in each folder.

    Raises:
        CalibrationError: A path does not exist, or is a file but no image, or there is none.
    """
    images: list[Path] = []
    for path in paths:
        if path.is_dir():
            images += sorted(p for p in path.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES)
        elif not path.is_file():
            raise CalibrationError(f"{path}: no such file or folder")
        elif path.suffix.lower() in IMAGE_SUFFIXES:
            images.append(path)
        else:
            raise CalibrationError(
                f"{path}: is no image; understood are {', '.join(sorted(IMAGE_SUFFIXES))}"
            )
    if not images:
        raise CalibrationError(f"{', '.join(map(str, paths))}: no images found")
    return images


def pose_of_numbers(numbers: FloatArray, where: str) -> RigidTransform:
    """Make a pose from x y z qx qy qz qw as files have it, the quaternion rounded.

    Raises:
        CalibrationError: Not seven finite numbers, or the quaternion's norm is far from 1.
    """
    if numbers.shape != (7,) or not np.isfinite(numbers).all():
        raise CalibrationError(f"{where}: {numbers.tolist()}: expected x y z qx qy qz qw, finite")
    norm = float(np.linalg.norm(numbers[3:]))
    if abs(norm - 1.0) > _QUATERNION_TOLERANCE:
        raise CalibrationError(
            f"{where}: the quaternion (qx qy qz qw) has the norm {norm:.6f}, expected 1;"
            " is the order of the columns right?"
        )
    return RigidTransform.from_components(numbers[:3], Rotation.from_quat(numbers[3:]))


def pose_of_matrix(matrix: object, where: str) -> RigidTransform:
    """Make a pose from a 4 x 4 matrix.

    Raises:
        CalibrationError: It is none: not numbers, wrong shape, left-handed, scaled or skewed.
    """
    try:
        return pose_from_matrix(np.asarray(matrix, np.float64), tolerance=_ROTATION_TOLERANCE)
    except FrameError as error:
        raise CalibrationError(f"{where}: {error}") from error
    except (TypeError, ValueError) as error:
        raise CalibrationError(f"{where}: is no 4 x 4 matrix of numbers") from error
