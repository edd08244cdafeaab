"""Poses in text files: tables of time stamps, pairs of matrices, ViSP's pose vectors."""

import csv
import io
import json
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.calib.hand_eye.streams import PoseStream
from tronlab.calib.offline.files import decode, pose_of_matrix, pose_of_numbers, read_text
from tronlab.errors import CalibrationError

POSE_COLUMNS = ("x", "y", "z", "qx", "qy", "qz", "qw")


def read_streams(path: Path) -> list[PoseStream]:
    """Read streams of poses, rows of t x y z qx qy qz qw: one file, or all in a zip archive.

    Raises:
        CalibrationError: A file cannot be read, or a row is no pose; the message has its number.
    """
    if path.suffix.lower() != ".zip":
        return [_stream(read_text(path), str(path))]
    try:
        with zipfile.ZipFile(path) as archive:
            names = [name for name in archive.namelist() if name.lower().endswith(".csv")]
            texts = {name: decode(archive.read(name), f"{path}:{name}") for name in names}
    except (OSError, zipfile.BadZipFile) as error:
        raise CalibrationError(f"{path}: is no zip archive that can be read: {error}") from error
    return [_stream(text, name) for name, text in texts.items()]


def read_named_poses(path: Path) -> dict[str, RigidTransform]:
    """Read a table of poses by name, rows of image,x,y,z,qx,qy,qz,qw.

    Raises:
        CalibrationError: The file cannot be read, a row is no pose, or a name comes twice.
    """
    poses: dict[str, RigidTransform] = {}
    for where, row in _rows(read_text(path), str(path)):
        if len(row) != 1 + len(POSE_COLUMNS):
            raise CalibrationError(f"{where}: {len(row)} columns, expected image,x,y,z,qx,qy,qz,qw")
        if row[0] in poses:
            raise CalibrationError(f"{where}: image {row[0]} comes twice")
        poses[row[0]] = pose_of_numbers(_numbers(row[1:], where), where)
    return poses


def read_matrix_pairs(path: Path) -> list[tuple[RigidTransform, RigidTransform]]:
    """Read pairs of 4 x 4 matrices from JSON, as MoveIt keeps them: hand in base, board in camera.

    Raises:
        CalibrationError: The file cannot be read, is of another form, or a matrix is no pose.
    """
    try:
        values = json.loads(read_text(path))
    except json.JSONDecodeError as error:
        raise CalibrationError(f"{path}:{error.lineno}: not JSON: {error.msg}") from error
    if not isinstance(values, list) or not all(
        isinstance(pair, list) and len(pair) == 2 for pair in values
    ):
        raise CalibrationError(
            f"{path}: expected a list of pairs of 4 x 4 matrices: hand in base, board in camera"
        )
    return [
        (
            pose_of_matrix(pair[0], f"{path}: pair {i}, hand"),
            pose_of_matrix(pair[1], f"{path}: pair {i}, board"),
        )
        for i, pair in enumerate(values)
    ]


def read_pose_vector(path: Path) -> RigidTransform:
    """Read ViSP's pose vector: three translations in metres, then the rotation vector in radians.

    Raises:
        CalibrationError: The file cannot be read, or has no six numbers.
    """
    try:
        values = YAML(typ="safe", pure=True).load(read_text(path))
        numbers = np.asarray(values["data"], np.float64).ravel()
    except (YAMLError, TypeError, KeyError, ValueError) as error:
        raise CalibrationError(f"{path}: is no pose vector of ViSP (data: six numbers)") from error
    if numbers.shape != (6,) or not np.isfinite(numbers).all():
        raise CalibrationError(f"{path}: data: {numbers.tolist()}: expected six finite numbers")
    return RigidTransform.from_components(numbers[:3], Rotation.from_rotvec(numbers[3:]))


def _stream(text: str, source: str) -> PoseStream:
    times: list[float] = []
    poses: list[RigidTransform] = []
    for where, row in _rows(text, source):
        numbers = _numbers(row, where)
        if len(numbers) != 1 + len(POSE_COLUMNS) or not np.isfinite(numbers[0]):
            raise CalibrationError(f"{where}: {len(row)} columns, expected t,x,y,z,qx,qy,qz,qw")
        times.append(float(numbers[0]))
        poses.append(pose_of_numbers(numbers[1:], where))
    if not poses:
        raise CalibrationError(f"{source}: has no poses")
    return PoseStream(Path(source).name, np.array(times), RigidTransform.concatenate(poses))


def _rows(text: str, source: str) -> Iterator[tuple[str, list[str]]]:
    """Give the rows with where they stand; comments and a header of names are passed over."""
    for i, row in enumerate(csv.reader(io.StringIO(text)), start=1):
        cells = [cell.strip() for cell in row]
        is_header = i == 1 and not _is_number(cells[-1] if cells else "")
        if cells and cells != [""] and not cells[0].startswith("#") and not is_header:
            yield f"{source}:{i}", cells


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _numbers(cells: list[str], where: str) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    for cell in cells:
        if not _is_number(cell):
            raise CalibrationError(f"{where}: '{cell}' is not a number")
    return np.array([float(cell) for cell in cells], np.float64)
