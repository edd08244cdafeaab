"""Distances between simple solids: line segments, boxes and the capsules round segments.

All functions work on stacks: leading dimensions broadcast against each other.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from tronlab.geometry.poses import FloatArray

_N_ROUNDS: Final = 8
_SHARES: Final[FloatArray] = np.linspace(0.0, 1.0, 9)
"""Where a segment is examined; each round leaves the two parts of it beside the least, a quarter:
eight leave 2e-5 of it. Many places at once are faster than a golden section with few."""

CORNER_SIGNS: Final[FloatArray] = np.array(
    [[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]
)
"""Of the corners of a box, shape (8, 3)."""
EDGES: Final = (
    (0, 1), (2, 3), (4, 5), (6, 7),
    (0, 2), (1, 3), (4, 6), (5, 7),
    (0, 4), (1, 5), (2, 6), (3, 7),
)  # fmt: skip
"""Of a box, as pairs of corners: those that differ in one sign."""


@dataclass(frozen=True, slots=True)
class Boxes:
    """A stack of boxes."""

    rotation: FloatArray
    """Whose columns are the edges' directions, shape (..., 3, 3)."""
    centre_m: FloatArray
    """Shape (..., 3)."""
    half_m: FloatArray
    """Half of the edges' lengths, shape (..., 3)."""

    @property
    def corners_m(self) -> FloatArray:
        """Get the corners in the order of ``CORNER_SIGNS``, shape (..., 8, 3)."""
        offsets = CORNER_SIGNS * self.half_m[..., np.newaxis, :]
        return self.centre_m[..., np.newaxis, :] + offsets @ np.swapaxes(self.rotation, -1, -2)

    def local(self, p_m: FloatArray) -> FloatArray:
        """Give points, shape (..., 3), as seen from the middle and along the edges."""
        return np.einsum("...ji,...j->...i", self.rotation, p_m - self.centre_m)


def segment_to_segment_m(
    p0_m: FloatArray, p1_m: FloatArray, q0_m: FloatArray, q1_m: FloatArray
) -> FloatArray:
    """Give the least distance of two line segments, ends of shape (..., 3) each.

    The nearest points are clamped to the segments one after the other: Ericson, Real-Time Collision
    Detection (2005), ch. 5.1.9.
    """
    u, v, w = p1_m - p0_m, q1_m - q0_m, p0_m - q0_m
    uu, vv, uv = _dot(u, u), _dot(v, v), _dot(u, v)
    uw, vw = _dot(u, w), _dot(v, w)
    across = uu * vv - uv * uv
    s = np.clip(_ratio(uv * vw - uw * vv, across), 0.0, 1.0)
    t = np.clip(_ratio(uv * s + vw, vv), 0.0, 1.0)
    s = np.clip(_ratio(uv * t - uw, uu), 0.0, 1.0)
    return np.linalg.norm(w + s[..., np.newaxis] * u - t[..., np.newaxis] * v, axis=-1)


def point_to_box_m(p_m: FloatArray, boxes: Boxes) -> FloatArray:
    """Give the distance of points, shape (..., 3), from boxes; negative inside, by the depth."""
    return _beyond(boxes.local(p_m), boxes.half_m)


def segment_to_box_m(p0_m: FloatArray, p1_m: FloatArray, boxes: Boxes) -> FloatArray:
    """Give the least distance of line segments from boxes; negative by the depth of the deepest.

    The distance from a convex solid is convex along a line, so that it falls towards its least.
    """
    start = boxes.local(p0_m)[..., np.newaxis, :]
    along = np.einsum("...ji,...j->...i", boxes.rotation, p1_m - p0_m)[..., np.newaxis, :]
    half_m = boxes.half_m[..., np.newaxis, :]
    low: FloatArray = np.zeros(1)
    distance_m, width = np.zeros(1), 1.0
    for _ in range(_N_ROUNDS):
        t = low + width * _SHARES
        distance_m = _beyond(start + t[..., np.newaxis] * along, half_m)
        before = np.clip(distance_m.argmin(axis=-1, keepdims=True) - 1, 0, len(_SHARES) - 3)
        low = low + width * _SHARES[before]
        width *= float(_SHARES[2])
    return distance_m.min(axis=-1)


def box_to_box_m(a: Boxes, b: Boxes) -> FloatArray:
    """Give the least distance of boxes; negative if they meet, by the depth of an edge.

    The nearest points of two boxes are always on an edge of one of them.
    """
    return np.minimum(_edges_to_box_m(a, b), _edges_to_box_m(b, a))


def _edges_to_box_m(a: Boxes, b: Boxes) -> FloatArray:
    corners = a.corners_m
    starts, ends = (corners[..., [edge[i] for edge in EDGES], :] for i in (0, 1))
    stacked = Boxes(
        b.rotation[..., np.newaxis, :, :],
        b.centre_m[..., np.newaxis, :],
        b.half_m[..., np.newaxis, :],
    )
    return segment_to_box_m(starts, ends, stacked).min(axis=-1)


def _beyond(p_box_m: FloatArray, half_m: FloatArray) -> FloatArray:
    """Give the distance from a box about 0 along the axes; negative inside."""
    x, y, z = np.moveaxis(np.abs(p_box_m) - half_m, -1, 0)  # much faster than along an axis of 3
    outside = np.sqrt(np.maximum(x, 0.0) ** 2 + np.maximum(y, 0.0) ** 2 + np.maximum(z, 0.0) ** 2)
    return outside + np.minimum(np.maximum(np.maximum(x, y), z), 0.0)


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.einsum("...i,...i->...", a, b)


def _ratio(numerator: FloatArray, denominator: FloatArray) -> FloatArray:
    """Divide; 0 where the denominator is: parallel segments, or one that is a point."""
    is_zero = np.abs(denominator) < np.finfo(np.float64).tiny
    return np.where(is_zero, 0.0, numerator / np.where(is_zero, 1.0, denominator))
