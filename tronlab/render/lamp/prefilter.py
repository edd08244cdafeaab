# pyright: basic
# ruff: noqa: PLR0917 - kernels work on plain numbers
"""The mean light on squares of the terrain: what a pixel sees that covers many samples.

What a square reflects depends on which normals its lit samples have, but for Lambert's function
only on the sum of their normals: cos i is linear in the normal. So a pyramid holds the means over
squares of 2 x 2, 4 x 4, ... nodes of ``share * albedo * normal`` and of ``share * albedo``, where
share is how much of the lamp a node sees; nodes that face away from the lamp count as 0. With V and
w for these two means, the light of a square is

    w * reflected(V . to_lamp / w, V . to_eye / w, cos_phase),

the function at the mean cosines: for Lambert the mean light itself, for the others that of first
order in the spread of the normals.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tronlab.render.quadtree import Grid
from tronlab.terrain.kernels import compiled, inlined, kernel, run_interleaved

_SCALE = 32767.0
_BAND = 64
"""Rows of squares of the lowest level that a thread does at a time."""


class Pyramid(NamedTuple):
    """Mean light of squares of 2^level nodes, levels from 1 up."""

    means: NDArray[np.int16]
    """Shape (squares of all levels, 4), level by level, each by rows: the mean vector along x, y
    and z of trs and the mean share, 32767 for 1."""
    level_start: NDArray[np.int64]
    """Where in ``means`` a level begins; entry 0 is not used."""
    level_rows: NDArray[np.int64]
    level_columns: NDArray[np.int64]


def make_pyramid(
    grid: Grid,
    visibility: NDArray[np.uint8],
    albedo: NDArray[np.uint16],
    lamp: NDArray[np.float64],
    *,
    n_threads: int,
) -> Pyramid:
    """Build the pyramid of one lamp.

    Args:
        grid: The surface.
        visibility: Share of the lamp that each node sees, 255 for the whole, shape as the heights.
        albedo: Relative albedo of each node, 65535 for 1, or ``surface.NO_ALBEDO``.
        lamp: Where the lamp is in grid coordinates: two in cells, the third in metres.
        n_threads: How many threads may run at once; the result does not depend on it.
    """
    pyramid = lay_out(grid.height_m.shape)
    run_interleaved(_fill_lowest, grid, visibility, albedo, lamp, pyramid, n_threads=n_threads)
    for level in range(2, pyramid.level_rows.size):
        run_interleaved(_fill_next, pyramid, level, n_threads=n_threads)
    return pyramid


def n_squares(shape: tuple[int, ...]) -> int:
    """Give how many squares all levels of a pyramid have together."""
    rows, columns = _level_shapes(shape)
    return int((rows * columns)[1:].sum())


def lay_out(shape: tuple[int, ...], means: NDArray[np.int16] | None = None) -> Pyramid:
    """Give a pyramid over a model of this shape: with these means, or room for them."""
    rows, columns = _level_shapes(shape)
    start = np.array([0, 0, *np.cumsum((rows * columns)[1:-1])], dtype=np.int64)
    if means is None:
        means = np.empty((n_squares(shape), 4), dtype=np.int16)
    return Pyramid(means, start, rows, columns)


def _level_shapes(shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Give the rows and the columns of all levels, those of level 0 are the model's."""
    shapes = [np.array(shape, dtype=np.int64)]
    while shapes[-1].max() > 1:
        shapes.append((shapes[-1] + 1) // 2)
    return np.array(shapes).T.copy()


@compiled
def _fill_lowest(grid, visibility, albedo, lamp, pyramid, part, n_parts):
    """Fill level 1 of the part-th of every n_parts bands: a square covers 2 x 2 nodes."""
    n_rows, n_columns = visibility.shape
    light = np.empty((4, n_columns + 1), dtype=np.float32)
    weights = np.empty(n_columns, dtype=np.float32)
    for top in range(part * _BAND, pyramid.level_rows[1], n_parts * _BAND):
        for square in range(top, min(top + _BAND, pyramid.level_rows[1])):
            light[:] = 0.0
            n_nodes = min(2, n_rows - 2 * square)
            for i in range(2 * square, 2 * square + n_nodes):
                _weigh_row(visibility, albedo, i, weights)
                _add_row(grid, lamp, i, weights, light)
            start = pyramid.level_start[1] + square * pyramid.level_columns[1]
            _store_row(light, n_nodes, n_columns, pyramid.means[start:])


@inlined
def _weigh_row(visibility, albedo, i, weights):
    for j in range(weights.size):
        weights[j] = visibility[i, j]
    if albedo.shape[0] > 0:
        for j in range(weights.size):
            weights[j] *= np.float32(albedo[i, j]) * np.float32(1.0 / 65535.0)


@inlined
def _add_row(grid, lamp, i, weights, light):
    """Add the light of a row of nodes; steps between nodes are one-sided at the border."""
    height, spacing = grid.height_m, grid.spacing_m
    last_row, last = height.shape[0] - 1, height.shape[1] - 1
    up, down = max(i - 1, 0), min(i + 1, last_row)
    rows = height[up], height[i], height[down]
    to_lamp = (
        np.float32((lamp[0] - i) * spacing),
        np.float32(lamp[1] * spacing),
        np.float32(lamp[2]),
        np.float32(spacing),
    )
    per_row = np.float32(1.0 / ((down - up) * spacing))
    one_step, two_steps = np.float32(1.0 / spacing), np.float32(0.5 / spacing)
    _add_node(rows, to_lamp, 0, 0, 1, per_row, one_step, weights, light)
    for j in range(1, last):
        _add_node(rows, to_lamp, j, j - 1, j + 1, per_row, two_steps, weights, light)
    _add_node(rows, to_lamp, last, last - 1, last, per_row, one_step, weights, light)


@inlined
def _add_node(rows, to_lamp, j, left, right, per_row, per_column, weights, light):
    """Add the light of a node to ``light``, unless it faces away from the lamp."""
    above, row, below = rows
    x, y, z, spacing = to_lamp
    slope_x = (below[j] - above[j]) * per_row
    slope_y = (row[right] - row[left]) * per_column
    towards = z - row[j] - slope_x * x - slope_y * (y - np.float32(j) * spacing)
    weight = weights[j] if towards > np.float32(0.0) else np.float32(0.0)
    along_z = weight / np.sqrt(np.float32(1.0) + slope_x * slope_x + slope_y * slope_y)
    light[0, j] -= slope_x * along_z
    light[1, j] -= slope_y * along_z
    light[2, j] += along_z
    light[3, j] += weight


@compiled
def _store_row(light, n_nodes, n_columns, means):
    """Store the means of pairs of columns."""
    full = np.float32(_SCALE / 255.0 / n_nodes)
    for j in range((n_columns + 1) // 2):
        scale = full * (np.float32(0.5) if 2 * j + 1 < n_columns else np.float32(1.0))
        for k in range(4):
            means[j, k] = _rounded((light[k, 2 * j] + light[k, 2 * j + 1]) * scale)


@inlined
def _rounded(value):
    return np.int16(np.floor(value + np.float32(0.5)))


@kernel
def _fill_next(pyramid, level, part, n_parts):
    """Fill every n_parts-th row of a level with the means of the one below."""
    columns = pyramid.level_columns[level]
    means = pyramid.means
    for i in range(part, pyramid.level_rows[level], n_parts):
        is_full = (i + 1) << level <= pyramid.level_rows[0]
        n_full = pyramid.level_columns[0] >> level if is_full else 0
        here = pyramid.level_start[level] + i * columns
        upper = pyramid.level_start[level - 1] + 2 * i * pyramid.level_columns[level - 1]
        lower = upper + pyramid.level_columns[level - 1]
        for j in range(n_full):
            for k in range(4):
                total = np.int32(means[upper + 2 * j, k]) + np.int32(means[upper + 2 * j + 1, k])
                total += np.int32(means[lower + 2 * j, k]) + np.int32(means[lower + 2 * j + 1, k])
                means[here + j, k] = (total + 2) >> 2
        for j in range(n_full, columns):
            _fill_border(pyramid, level, i, j)


@inlined
def _fill_border(pyramid, level, i, j):
    """Fill a square that reaches over the border of the model."""
    below = level - 1
    n_rows, n_columns = pyramid.level_rows[0], pyramid.level_columns[0]
    place = pyramid.level_start[level] + i * pyramid.level_columns[level] + j
    n_nodes = _covered(i, level, n_rows) * _covered(j, level, n_columns)
    for k in range(4):
        total = 0
        for a in range(2 * i, min(2 * i + 2, pyramid.level_rows[below])):
            row = pyramid.level_start[below] + a * pyramid.level_columns[below]
            for b in range(2 * j, min(2 * j + 2, pyramid.level_columns[below])):
                weight = _covered(a, below, n_rows) * _covered(b, below, n_columns)
                total += weight * np.int64(pyramid.means[row + b, k])
        pyramid.means[place, k] = _rounded(np.float32(total / n_nodes))


@inlined
def _covered(square, level, n_nodes):
    """Give how many nodes a square covers along one axis."""
    return min((square + 1) << level, n_nodes) - (square << level)


@inlined
def filtered_at(pyramid, r, c, level):
    """Give the mean light around a place, interpolated between squares and between levels.

    Args:
        pyramid: A ``Pyramid``.
        r: Place along the rows' axis, in cells.
        c: Place along the columns' axis, in cells.
        level: log2 of the side of the square in samples, of any value; below 1 that of 1 is given.

    Returns:
        The mean of share * albedo * normal along x, y and z, and of share * albedo.
    """
    top = pyramid.level_rows.size - 1
    level = min(max(level, 1.0), float(top))
    fine = min(int(level), top - 1) if top > 1 else 1
    x, y, z, w = _on_level(pyramid, r, c, fine)
    part = level - fine
    if part > 0.0:
        x_1, y_1, z_1, w_1 = _on_level(pyramid, r, c, fine + 1)
        x += part * (x_1 - x)
        y += part * (y_1 - y)
        z += part * (z_1 - z)
        w += part * (w_1 - w)
    return x, y, z, w


@inlined
def _on_level(pyramid, r, c, level):
    """Interpolate bilinearly between the middles of a level's squares."""
    n_rows, n_columns = pyramid.level_rows[level], pyramid.level_columns[level]
    size = float(1 << level)
    a = min(max((r + 0.5) / size - 0.5, 0.0), n_rows - 1.0)
    b = min(max((c + 0.5) / size - 0.5, 0.0), n_columns - 1.0)
    i, j = min(int(a), max(n_rows - 2, 0)), min(int(b), max(n_columns - 2, 0))
    a -= i
    b -= j
    right = 1 if n_columns > 1 else 0
    place = pyramid.level_start[level] + i * n_columns + j
    below = place + (n_columns if n_rows > 1 else 0)
    means = pyramid.means
    w00, w01, w10, w11 = (1.0 - a) * (1.0 - b), (1.0 - a) * b, a * (1.0 - b), a * b
    return (
        _mix(means, 0, place, below, right, w00, w01, w10, w11),
        _mix(means, 1, place, below, right, w00, w01, w10, w11),
        _mix(means, 2, place, below, right, w00, w01, w10, w11),
        _mix(means, 3, place, below, right, w00, w01, w10, w11),
    )


@inlined
def _mix(means, k, place, below, right, w00, w01, w10, w11):
    mixed = w00 * means[place, k] + w01 * means[place + right, k]
    mixed += w10 * means[below, k] + w11 * means[below + right, k]
    return mixed * (1.0 / _SCALE)
