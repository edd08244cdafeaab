"""Straight ways of light between points, and the solids that bar them."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tronlab.geometry.poses import FloatArray
from tronlab.planning.collision import Capsule, Solid
from tronlab.planning.distances import Boxes, segment_to_segment_m


def are_barred(
    p_trs_m: FloatArray, points_trs_m: FloatArray, solids: Sequence[Solid]
) -> NDArray[np.bool_]:
    """Tell which of the straight ways from one point to others, shape (n, 3), meet a solid."""
    barred = np.zeros(len(points_trs_m), dtype=np.bool_)
    for solid in solids:
        barred |= meet(p_trs_m, points_trs_m, solid)
    return barred


def meet(
    p_trs_m: FloatArray, points_trs_m: FloatArray, solid: Solid, *, margin_m: float = 0.0
) -> NDArray[np.bool_]:
    """Tell which of the ways come within a margin of one solid; at a box's edges a bit farther."""
    if isinstance(solid, Capsule):
        axis = solid.p0_trs_m, solid.p1_trs_m
        return segment_to_segment_m(p_trs_m, points_trs_m, *axis) < solid.radius_m + margin_m
    boxes = solid.boxes
    return meet_box(
        p_trs_m, points_trs_m, Boxes(boxes.rotation, boxes.centre_m, boxes.half_m + margin_m)
    )


def meet_box(p_m: FloatArray, points_m: FloatArray, box: Boxes) -> NDArray[np.bool_]:
    """Tell which ways from ``p_m`` to points, shape (n, 3), pass through a box."""
    start = box.local(p_m)  # a way is in the box while it is between all three pairs of faces
    ways = (points_m - p_m) @ box.rotation
    with np.errstate(divide="ignore", invalid="ignore"):
        through = np.stack([(-box.half_m - start) / ways, (box.half_m - start) / ways])
    is_along = ways == 0.0
    is_inside = np.abs(start) <= box.half_m
    enters = np.where(is_along, np.where(is_inside, -np.inf, np.inf), through.min(axis=0))
    leaves = np.where(is_along, np.where(is_inside, np.inf, -np.inf), through.max(axis=0))
    first = np.maximum(enters.max(axis=1), 0.0)
    return first <= np.minimum(leaves.min(axis=1), 1.0)
