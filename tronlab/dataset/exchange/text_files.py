"""Tables in text files, with errors that name file, row and column."""

import csv
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.errors import DatasetError
from tronlab.geometry.poses import FloatArray

_QUATERNION_TOLERANCE = 1e-3
"""Text files are rounded, some to four digits."""


@dataclass(frozen=True, slots=True)
class Row:
    """A row of a table with named columns."""

    where: str
    """File and line, for messages."""
    cells: dict[str, str]
    """Text by column; cells that are empty are left out."""

    def text(self, name: str) -> str:
        """Give a cell that must not be empty.

        Raises:
            DatasetError: It is.
        """
        if name not in self.cells:
            raise DatasetError(f"{self.where}: {name} is empty")
        return self.cells[name]

    def integer(self, name: str) -> int:
        """Give a whole number.

        Raises:
            DatasetError: The cell is empty, or something else.
        """
        try:
            return int(self.text(name))
        except ValueError:
            text = self.cells[name]
            raise DatasetError(f"{self.where}: {name}: '{text}' is no whole number") from None

    def number(self, name: str) -> float:
        """Give a finite number; NaN for an empty cell.

        Raises:
            DatasetError: The cell holds something else.
        """
        return number(self.cells[name], f"{self.where}: {name}") if name in self.cells else np.nan

    def numbers(self, names: Sequence[str]) -> FloatArray | None:
        """Give several numbers, or None if all their cells are empty.

        Raises:
            DatasetError: Some are there and some are not, or one is no finite number.
        """
        missing = [name for name in names if name not in self.cells]
        if len(missing) == len(names):
            return None
        if missing:
            raise DatasetError(
                f"{self.where}: {', '.join(missing)}: empty; give all of {', '.join(names)}, or"
                " none of them"
            )
        return np.array([self.number(name) for name in names])


def read_text(path: Path) -> str:
    """Read a text file.

    Raises:
        DatasetError: It cannot be read, or is no UTF-8 text.
    """
    try:
        return path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise DatasetError(f"{path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise DatasetError(f"{path}: is not UTF-8 text (byte {error.start})") from error


def read_table(path: Path, *, required: Sequence[str], known: Sequence[str]) -> list[Row]:
    """Read a CSV file whose first line names its columns; others than those known are passed over.

    Raises:
        DatasetError: It cannot be read, a required column is missing, a column is there twice, a
            row has more or fewer cells than there are columns, or there is no row.
    """
    lines = _csv_lines(path)
    header = [name.strip() for name in next(lines, ("", []))[1]]
    missing = [name for name in required if name not in header]
    if missing:
        raise DatasetError(
            f"{path}:1: no column {', '.join(missing)}; the first line names the columns, with"
            f" commas between; needed are {', '.join(required)}"
        )
    twice = sorted({name for name in header if header.count(name) > 1})
    if twice:
        raise DatasetError(f"{path}:1: columns that are there twice: {', '.join(twice)}")
    rows: list[Row] = []
    for where, cells in lines:
        if not any(cell.strip() for cell in cells):
            continue
        if len(cells) != len(header):
            raise DatasetError(f"{where}: {len(cells)} cells, but there are {len(header)} columns")
        named = zip(header, cells, strict=True)
        rows.append(Row(where, {k: v.strip() for k, v in named if k in known and v.strip()}))
    if not rows:
        raise DatasetError(f"{path}: has no rows below its header")
    return rows


def _csv_lines(path: Path) -> Iterator[tuple[str, list[str]]]:
    lines = csv.reader(io.StringIO(read_text(path)))
    try:
        for cells in lines:
            yield f"{path}:{lines.line_num}", cells
    except csv.Error as error:
        raise DatasetError(f"{path}:{lines.line_num}: is no CSV: {error}") from error


def read_lines(path: Path, *, columns: Sequence[str]) -> Iterator[tuple[str, list[str]]]:
    """Read rows of words with blanks or commas between them.

    Comments (#) and empty lines are passed over.

    Args:
        path: The file.
        columns: What the words of a row are.

    Yields:
        File and line for messages, and the words.

    Raises:
        DatasetError: The file cannot be read, or a row has fewer or more words.
    """
    for i, line in enumerate(read_text(path).splitlines(), start=1):
        words = line.replace(",", " ").split()
        if not words or words[0].startswith("#"):
            continue
        if len(words) != len(columns):
            raise DatasetError(f"{path}:{i}: {len(words)} columns, expected {' '.join(columns)}")
        yield f"{path}:{i}", words


def number(text: str, where: str) -> float:
    """Give the finite number that a text stands for.

    Raises:
        DatasetError: It does not stand for one.
    """
    try:
        value = float(text)
    except ValueError:
        raise DatasetError(f"{where}: '{text}' is not a number") from None
    if not np.isfinite(value):
        raise DatasetError(f"{where}: {text} is not finite")
    return value


def pose_of_numbers(xyz_quat: FloatArray, where: str) -> RigidTransform:
    """Make a pose from x y z qx qy qz qw as files have it, the quaternion rounded.

    Raises:
        DatasetError: The quaternion's norm is far from 1.
    """
    return poses_of_numbers(xyz_quat[np.newaxis], [where])[0]


def poses_of_numbers(xyz_quat: FloatArray, where: Sequence[str]) -> RigidTransform:
    """Make poses from rows of x y z qx qy qz qw, shape (n, 7), each named by ``where``.

    Raises:
        DatasetError: The norm of a quaternion is far from 1.
    """
    norms = np.linalg.norm(xyz_quat[:, 3:], axis=1)
    for i in np.flatnonzero(np.abs(norms - 1.0) > _QUATERNION_TOLERANCE)[:1]:
        raise DatasetError(
            f"{where[i]}: the quaternion (qx qy qz qw) has the norm {norms[i]:.6f}, expected 1;"
            " is the order of the columns right?"
        )
    return RigidTransform.from_components(xyz_quat[:, :3], Rotation.from_quat(xyz_quat[:, 3:]))
