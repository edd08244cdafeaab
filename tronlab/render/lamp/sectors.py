"""The four sectors around a lamp, and the lines along which they are swept."""

import math
from typing import NamedTuple

_LINE_SPACING = 0.7
"""Columns between two lines where they are farthest apart."""


class Sector(NamedTuple):
    """A quarter of the plan, seen so that its lines run from the lamp to higher rows."""

    start: int
    """Where in the heights node (0, 0) of this view lies."""
    per_row: int
    """From a node of the heights to that of the next row of this view."""
    per_column: int
    """From a node of the heights to that of the next column of this view."""
    n_rows: int
    n_columns: int
    lamp_row: float
    lamp_column: float
    has_diagonals: bool
    """Whether the nodes at 45 degrees from the lamp are its own."""
    first_row: int = 0
    """The first row beyond the lamp."""
    first_slope: float = 0.0
    """Columns a row of the first line."""
    slope_step: float = 0.0
    """How much more that is of the next line."""
    n_lines: int = 0


def sectors(shape: tuple[int, int], lamp_r: float, lamp_c: float) -> tuple[Sector, ...]:
    """Give the four sectors around a lamp; those without nodes of the model have no lines."""
    n_rows, n_columns = shape
    last = n_rows * n_columns - 1
    turned_r, turned_c = n_rows - 1 - lamp_r, n_columns - 1 - lamp_c
    views = (
        Sector(0, n_columns, 1, n_rows, n_columns, lamp_r, lamp_c, True),
        Sector(last, -n_columns, -1, n_rows, n_columns, turned_r, turned_c, True),
        Sector(0, 1, n_columns, n_columns, n_rows, lamp_c, lamp_r, False),
        Sector(last, -1, -n_columns, n_columns, n_rows, turned_c, turned_r, False),
    )
    return tuple(_with_lines(view) for view in views)


def _with_lines(view: Sector) -> Sector:
    """Lay the lines of a sector over the part of the model that lies in it."""
    first_row = max(math.floor(view.lamp_row) + 1, 0)
    if first_row >= view.n_rows:
        return view
    nearest, farthest = first_row - view.lamp_row, view.n_rows - 1 - view.lamp_row
    left, right = -view.lamp_column, view.n_columns - 1 - view.lamp_column
    least = max(left / (nearest if left < 0 else farthest), -1.0)
    most = min(right / (nearest if right > 0 else farthest), 1.0)
    if least > most:
        return view
    step = _LINE_SPACING / farthest
    return view._replace(
        first_row=first_row,
        first_slope=least,
        slope_step=step,
        n_lines=math.ceil((most - least) / step) + 2,
    )
