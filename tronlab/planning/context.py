"""What a plan is held against: the laboratory as calibrated, the cell, the campaign's wishes."""

from dataclasses import dataclass, field
from typing import Protocol

from scipy.spatial.transform import RigidTransform

from tronlab.devices.cell import CellSpec
from tronlab.devices.mounting import Mounting
from tronlab.devices.protocols import MotionModel, Robot
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray
from tronlab.planning.collision import Scene
from tronlab.planning.duration import Timing
from tronlab.planning.shots import RangeFinder
from tronlab.render.renderer import Lamp, Renderer
from tronlab.terrain.heightmap import HeightMap


class TerrainRenderer(Renderer, RangeFinder, Protocol):
    """Renders the terrain, and measures distances to it."""


@dataclass(frozen=True, slots=True)
class Rules:
    """What a campaign wants of its shots."""

    min_usable_fraction: float
    range_los_m: tuple[float, float]
    """Least and greatest."""
    min_lit_fraction: float
    max_robot_shadow: float


@dataclass(frozen=True)
class PlanContext:
    """Everything a plan is held against."""

    robot: Robot
    """Not connected; what it cannot say without a connection is not checked."""
    mounting: Mounting
    camera: CameraModel
    tmac_from_cam: RigidTransform
    p_tracker_trs_m: FloatArray
    """Where the tracker measures from, shape (3,)."""
    lamp: Lamp
    heightmap: HeightMap
    renderer: TerrainRenderer
    cell: CellSpec
    rules: Rules
    timing: Timing
    scene: Scene = field(init=False)
    """Bodies of the robot and what stands around it."""

    def __post_init__(self) -> None:
        scene = Scene.of(self.heightmap, self.mounting, self.cell.envelope)
        object.__setattr__(self, "scene", scene)

    @property
    def motion(self) -> MotionModel | None:
        """Get the robot as one that can say how it would move, if it can."""
        return self.robot if isinstance(self.robot, MotionModel) else None
