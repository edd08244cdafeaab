"""How near arm, plate and robot's foot come to each other and to what stands in the cell.

The bodies hold the true ones, so that the distances told are never larger than the true ones.

Towards floor, obstacles and terrain model, whose places are known roughly, the envelope's clearance
is kept. Of the robot with itself it counts only whether its bodies meet: the axes hold them where
they are.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tronlab.devices.readings import Posture
from tronlab.geometry.poses import FloatArray
from tronlab.kinematics.kr16_shape import (
    COLUMN,
    FOREARM,
    HAND,
    LINK_NAMES,
    LINK_RADII_M,
    UPPER_ARM,
    WRIST,
)
from tronlab.planning.collision import FOOT, PLATE, Bodies, Clearance, Pair, Scene, stacked
from tronlab.planning.distances import (
    Boxes,
    box_to_box_m,
    segment_to_box_m,
    segment_to_segment_m,
)
from tronlab.planning.terrain_clearance import TerrainClearance

FLOOR: Final = "floor"
MODEL: Final = "terrain model"

_LINKS_THAT_MEET: Final = (
    (FOREARM, COLUMN),
    (WRIST, COLUMN),
    (HAND, COLUMN),
    (HAND, UPPER_ARM),
)
"""Neighbours are kept apart by the limits of the axis between them."""
_LINKS_OVER_FOOT: Final = (UPPER_ARM, FOREARM, WRIST, HAND)
_LINKS_BY_PLATE: Final = (COLUMN, UPPER_ARM, FOREARM, WRIST)
_PIECE_M: Final = 0.1
"""Arm and plate are held against the terrain in pieces about so long."""
_FOOT_PIECE_M: Final = 0.4
"""So is the foot, which never comes as near."""
_CHUNK: Final = 512
"""Postures examined at once."""


@dataclass(frozen=True, slots=True)
class Distances:
    """Of all pairs of bodies that could meet, for a stack of n postures."""

    distance_m: FloatArray
    """Shape (n, pairs)."""
    pairs: tuple[Pair, ...]
    is_own: NDArray[np.bool_]
    """Whether both are the robot's, shape (pairs,)."""

    @property
    def nearest(self) -> tuple[Clearance, ...]:
        """Get what comes nearest in each posture; of the robot with itself only what meets."""
        counts = ~self.is_own | (self.distance_m < 0.0)
        counting_m = np.where(counts, self.distance_m, np.inf)
        nearest = counting_m.argmin(axis=1)
        return tuple(
            Clearance(float(row[i]), self.pairs[i])
            for row, i in zip(counting_m, nearest, strict=True)
        )


def clearances(postures: Sequence[Posture], scene: Scene) -> tuple[Clearance, ...]:
    """Give what comes nearest to each other in each posture, and how near."""
    return distances_at(*stacked(postures), scene).nearest


def clearance(posture: Posture, scene: Scene) -> Clearance:
    """Give what comes nearest to each other in a posture, and how near."""
    return clearances([posture], scene)[0]


def distances_at(rail_m: FloatArray, axes_rad: FloatArray, scene: Scene) -> Distances:
    """Give the distances of all pairs of bodies that could meet.

    Args:
        rail_m: Shape (n,), n > 0.
        axes_rad: Shape (n, 6).
        scene: The cell.
    """
    parts: list[FloatArray] = []
    pairs: tuple[Pair, ...] = ()
    n_own = 0
    for start in range(0, len(rail_m), _CHUNK):
        chunk = slice(start, start + _CHUNK)
        bodies = Bodies.at(rail_m[chunk], axes_rad[chunk], scene)
        own = list(_robot_with_itself(bodies))
        found = [*own, *_robot_with_surroundings(bodies, scene)]
        n_own, pairs = len(own), tuple(pair for pair, _ in found)
        parts.append(np.stack([distance_m for _, distance_m in found], axis=-1))
    return Distances(np.concatenate(parts), pairs, np.arange(len(pairs)) < n_own)


def _robot_with_itself(bodies: Bodies) -> Iterator[tuple[Pair, FloatArray]]:
    for a, b in _LINKS_THAT_MEET:
        (a0, a1), (b0, b1) = _ends(bodies, a), _ends(bodies, b)
        apart_m = segment_to_segment_m(a0, a1, b0, b1) - LINK_RADII_M[a] - LINK_RADII_M[b]
        yield (LINK_NAMES[a], LINK_NAMES[b]), apart_m
    over_foot_m = _links_to_box_m(bodies, _LINKS_OVER_FOOT, bodies.foot)
    for i, link in enumerate(_LINKS_OVER_FOOT):
        yield (LINK_NAMES[link], FOOT), over_foot_m[:, i]
    by_plate_m = _links_to_box_m(bodies, _LINKS_BY_PLATE, bodies.plate)
    for i, link in enumerate(_LINKS_BY_PLATE):
        yield (PLATE, LINK_NAMES[link]), by_plate_m[:, i]
    yield (PLATE, FOOT), box_to_box_m(bodies.plate, bodies.foot)


def _robot_with_surroundings(bodies: Bodies, scene: Scene) -> Iterator[tuple[Pair, FloatArray]]:
    yield from _robot_with_floor(bodies, scene)
    yield from _robot_with_obstacles(bodies, scene)
    yield from _robot_with_terrain(bodies, scene.terrain)


def _robot_with_floor(bodies: Bodies, scene: Scene) -> Iterator[tuple[Pair, FloatArray]]:
    up, floor_m = scene.floor
    height_m = bodies.ends_m @ up - floor_m - LINK_RADII_M[:, np.newaxis]
    for link in _LINKS_OVER_FOOT:
        yield (LINK_NAMES[link], FLOOR), height_m[:, link].min(axis=-1)
    yield (PLATE, FLOOR), (bodies.plate.corners_m @ up - floor_m).min(axis=-1)


def _robot_with_obstacles(bodies: Bodies, scene: Scene) -> Iterator[tuple[Pair, FloatArray]]:
    for obstacle in scene.obstacles:
        by_obstacle_m = _links_to_box_m(bodies, range(len(LINK_NAMES)), obstacle.boxes)
        for link, name in enumerate(LINK_NAMES):
            yield (name, obstacle.name), by_obstacle_m[:, link]
        yield (PLATE, obstacle.name), box_to_box_m(bodies.plate, obstacle.boxes)
        yield (FOOT, obstacle.name), box_to_box_m(bodies.foot, obstacle.boxes)


def _robot_with_terrain(
    bodies: Bodies, terrain: TerrainClearance
) -> Iterator[tuple[Pair, FloatArray]]:
    for link, name in enumerate(LINK_NAMES):
        ends = bodies.ends_m[:, link]
        length_m = float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1).max())
        n_pieces = max(1, int(np.ceil(length_m / _PIECE_M)))
        share = np.linspace(0.0, 1.0, n_pieces + 1)[:, np.newaxis]
        points = ends[:, :1] + share * (ends[:, 1:] - ends[:, :1])
        apart_m = terrain.of_segments_m(points[:, :-1], points[:, 1:]).min(axis=-1)
        yield (name, MODEL), apart_m - LINK_RADII_M[link]
    yield (PLATE, MODEL), _box_to_terrain_m(bodies.plate, terrain, piece_m=_PIECE_M)
    yield (FOOT, MODEL), _box_to_terrain_m(bodies.foot, terrain, piece_m=_FOOT_PIECE_M)


def _box_to_terrain_m(boxes: Boxes, terrain: TerrainClearance, *, piece_m: float) -> FloatArray:
    """Hold boxes, a stack of n, against the terrain in small boxes, each within a cylinder."""
    half_m = boxes.half_m
    n_pieces = np.maximum(1, np.ceil(2.0 * half_m / piece_m)).astype(int)
    middles = [
        half * (2.0 * np.arange(n) + 1.0 - n) / n for half, n in zip(half_m, n_pieces, strict=True)
    ]
    offsets = np.stack(np.meshgrid(*middles, indexing="ij"), axis=-1).reshape(-1, 3)
    centres = boxes.centre_m[:, np.newaxis] + offsets @ np.swapaxes(boxes.rotation, -1, -2)
    extent_m = np.abs(boxes.rotation) @ (half_m / n_pieces)  # of half a piece along X, Y, Z of trs
    bottom_m = centres[..., 2] - extent_m[:, np.newaxis, 2]
    radius_m = np.linalg.norm(extent_m[:, np.newaxis, :2], axis=-1)
    radius_m = np.broadcast_to(radius_m, bottom_m.shape)
    return terrain.of_cylinders_m(centres, radius_m, bottom_m).min(axis=-1)


def _ends(bodies: Bodies, link: int) -> tuple[FloatArray, FloatArray]:
    return bodies.ends_m[:, link, 0], bodies.ends_m[:, link, 1]


def _links_to_box_m(bodies: Bodies, links: Sequence[int], boxes: Boxes) -> FloatArray:
    """Give the distances of links from a box each posture has, or all have; shape (n, links)."""
    ends = bodies.ends_m[:, list(links)]
    each = Boxes(
        boxes.rotation[..., np.newaxis, :, :],
        boxes.centre_m[..., np.newaxis, :],
        boxes.half_m,
    )
    return segment_to_box_m(ends[:, :, 0], ends[:, :, 1], each) - LINK_RADII_M[list(links)]
