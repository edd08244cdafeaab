"""Holes in a height map, filled as smoothly as their rims allow."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse.linalg import cg

from tronlab.terrain.formats.model import Heights
from tronlab.terrain.heightmap import TerrainError

_TOLERANCE = 1e-12
"""Residual at which the equations count as solved, of their right-hand side."""
_NEIGHBOURS = ((-1, 0), (1, 0), (0, -1), (0, 1))


def fill_holes(height_m: Heights, *, widest_px: int) -> tuple[Heights, int]:
    """Fill samples that are not finite with the harmonic surface through the rims of the holes.

    Laplace's equation with the heights around each hole as its boundary: the smoothest surface in
    the sense of least mean square slope, never above or below the rim. A hole at the border of
    the map is taken to go on mirrored beyond it.

    Args:
        height_m: Shape (rows, columns), with NaN where there is no height.
        widest_px: A hole is refused if a square of more samples than this fits into it (at the
            border: into it and its mirror image). Long and narrow holes are no problem.

    Returns:
        Heights of the same type without holes, and how many samples were filled; ``height_m``
        itself if it has no holes.

    Raises:
        TerrainError: A hole is too wide; the message says where.
    """
    is_hole = ~np.isfinite(height_m)
    n_holes = int(np.count_nonzero(is_hole))
    if n_holes == 0:
        return height_m, 0
    if n_holes == is_hole.size:
        raise TerrainError("all samples are holes: there is no rim to fill them from")
    _check_width(is_hole, widest_px)
    filled: Any = np.array(height_m)
    filled[is_hole] = _harmonic(height_m, is_hole)
    return filled, n_holes


def _check_width(is_hole: NDArray[np.bool_], widest_px: int) -> None:
    size = widest_px + 1
    if size > 2 * max(is_hole.shape):
        return
    mirrored = np.pad(is_hole, size // 2, mode="symmetric")
    is_too_wide = ndimage.minimum_filter(mirrored, size=size, mode="constant", cval=0)
    if not is_too_wide.any():
        return
    centre = np.argwhere(is_too_wide)[0] - size // 2
    row, column = np.minimum(centre, np.array(is_hole.shape) - 1)
    labelled: Any = ndimage.label(is_hole)
    labels, n_holes = labelled
    rows, columns = ndimage.find_objects(labels)[labels[row, column] - 1]
    raise TerrainError(
        f"the hole of rows {rows.start} to {rows.stop - 1}, columns {columns.start} to"
        f" {columns.stop - 1} is wider than {widest_px} samples, the widest that may be filled"
        f" ({np.count_nonzero(is_hole)} samples in {n_holes} holes in all); allow wider ones, or"
        " use a part without it"
    )


def _harmonic(height_m: Heights, is_hole: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Solve Laplace's equation in the holes, five-point stencil, by conjugate gradients."""
    holes = np.argwhere(is_hole)
    number = np.full(is_hole.shape, -1, dtype=np.int32)
    number[is_hole] = np.arange(len(holes))
    rim_sum, n_rim, n_neighbours = (np.zeros(len(holes)) for _ in range(3))
    pairs: list[NDArray[Any]] = []
    for step in _NEIGHBOURS:
        place = holes + step
        inside = np.flatnonzero(np.all((place >= 0) & (place < is_hole.shape), axis=1))
        rows, columns = place[inside].T
        n_neighbours[inside] += 1.0
        neighbour = number[rows, columns]
        is_rim = neighbour < 0
        rim_sum[inside[is_rim]] += height_m[rows[is_rim], columns[is_rim]]
        n_rim[inside[is_rim]] += 1.0
        pairs.append(np.stack([inside[~is_rim], neighbour[~is_rim]]))
    datum = rim_sum.sum() / n_rim.sum()  # or a planet's radius would hide the relief
    row, column = np.concatenate(pairs, axis=1)
    laplacian = sparse.diags_array(n_neighbours) - sparse.coo_array(
        (np.ones(len(row)), (row, column)), shape=(len(holes), len(holes))
    )
    solution, n_done = cg(laplacian.tocsr(), rim_sum - datum * n_rim, rtol=_TOLERANCE)
    if n_done:
        raise TerrainError(f"filling holes: no solution after {n_done} iterations")
    return solution + datum
