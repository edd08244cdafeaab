"""Bodies that could meet, in trs: to hold apart, to draw, and to see whether they cast a shadow.

Links of the arm are capsules, plate and foot boxes. All of them hold the true body.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np

from tronlab.devices.cell import EnvelopeSpec
from tronlab.devices.mounting import Mounting
from tronlab.devices.readings import Posture
from tronlab.geometry.poses import FloatArray
from tronlab.kinematics.kr16_shape import (
    BASE_HIGH_M,
    BASE_LOW_M,
    LINK_NAMES,
    LINK_RADII_M,
    arm_shape,
)
from tronlab.planning.distances import Boxes
from tronlab.planning.terrain_clearance import TerrainClearance
from tronlab.terrain.heightmap import HeightMap

PLATE: Final = "plate"
FOOT: Final = "robot's foot"

Pair: TypeAlias = tuple[str, str]


@dataclass(frozen=True, slots=True)
class Clearance:
    """The least distance between any two bodies."""

    distance_m: float
    """Negative: they meet."""
    between: Pair
    """Which two."""


@dataclass(frozen=True, slots=True)
class Capsule:
    """All within a radius of a line segment."""

    name: str
    p0_trs_m: FloatArray
    p1_trs_m: FloatArray
    radius_m: float


@dataclass(frozen=True, slots=True)
class Box:
    """A box in any attitude."""

    name: str
    boxes: Boxes
    """One, frame trs."""

    @property
    def corners_trs_m(self) -> FloatArray:
        """Get its corners, shape (8, 3)."""
        return self.boxes.corners_m


Solid: TypeAlias = Capsule | Box


@dataclass(frozen=True, slots=True)
class Scene:
    """What stands in the cell, and how the robot stands in it."""

    mounting: Mounting
    envelope: EnvelopeSpec
    terrain: TerrainClearance

    @classmethod
    def of(cls, heightmap: HeightMap, mounting: Mounting, envelope: EnvelopeSpec) -> "Scene":
        """Prepare a scene."""
        return cls(mounting, envelope, TerrainClearance.of(heightmap))

    @property
    def floor(self) -> tuple[FloatArray, float]:
        """Get the upward normal of the floor in trs, shape (3,), and its height along that."""
        up = self.mounting.trs_from_rail.rotation.as_matrix()[:, 2]
        origin = self.mounting.trs_from_rail.translation
        return up, float(up @ origin) - self.envelope.floor_below_rail_m

    @property
    def obstacles(self) -> tuple[Box, ...]:
        """Get what else stands in the cell."""
        return tuple(
            Box(
                name,
                Boxes(
                    np.eye(3),
                    (np.array(spec.low_trs_m) + spec.high_trs_m) / 2.0,
                    (np.array(spec.high_trs_m) - spec.low_trs_m) / 2.0,
                ),
            )
            for name, spec in self.envelope.obstacles.items()
        )


@dataclass(frozen=True, slots=True)
class Bodies:
    """Where the robot's bodies are in trs, for a stack of postures."""

    ends_m: FloatArray
    """Ends of the links' capsules, shape (n, links, 2, 3)."""
    plate: Boxes
    """Stack of n."""
    foot: Boxes

    @classmethod
    def at(cls, rail_m: FloatArray, axes_rad: FloatArray, scene: Scene) -> "Bodies":
        """Place them: rail, shape (n,), and axes, shape (n, 6)."""
        mounting, envelope = scene.mounting, scene.envelope
        shape = arm_shape(axes_rad)
        rotation: FloatArray = mounting.trs_from_rail.rotation.as_matrix()
        p_base = mounting.trs_from_rail.apply(np.multiply.outer(rail_m, mounting.rail_axis))
        flange = rotation @ shape.flange_rotation
        p_flange = p_base + shape.p_flange_base_m @ rotation.T
        foot_low = BASE_LOW_M - [0.0, 0.0, envelope.floor_below_rail_m]
        return cls(
            ends_m=p_base[:, np.newaxis, np.newaxis] + shape.ends_base_m @ rotation.T,
            plate=Boxes(
                flange,
                p_flange + flange @ np.array(envelope.plate_centre_m),
                np.array(envelope.plate_m) / 2.0,
            ),
            foot=Boxes(
                np.broadcast_to(rotation, flange.shape),
                p_base + rotation @ (foot_low + BASE_HIGH_M) / 2.0,
                (BASE_HIGH_M - foot_low) / 2.0,
            ),
        )


def solids_at(posture: Posture, scene: Scene) -> tuple[Solid, ...]:
    """Give the robot's bodies that may stand in the way of light: arm, plate and foot.

    The arm's links come first, from the base to the flange.
    """
    bodies = Bodies.at(*stacked([posture]), scene)
    arm = (
        Capsule(name, ends[0], ends[1], float(radius_m))
        for name, ends, radius_m in zip(LINK_NAMES, bodies.ends_m[0], LINK_RADII_M, strict=True)
    )
    return (*arm, Box(PLATE, _first(bodies.plate)), Box(FOOT, _first(bodies.foot)))


def stacked(postures: Sequence[Posture]) -> tuple[FloatArray, FloatArray]:
    """Give rails, shape (n,), and axes, shape (n, 6), of postures."""
    rail_m = np.array([posture.rail_m for posture in postures])
    return rail_m, np.stack([posture.axes_rad for posture in postures])


def _first(boxes: Boxes) -> Boxes:
    return Boxes(boxes.rotation[0], boxes.centre_m[0], boxes.half_m)
