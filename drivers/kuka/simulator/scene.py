"""Where a simulated robot stands, and what becomes of its moves."""

from dataclasses import dataclass
from typing import Protocol

from numpy.random import Generator
from scipy.spatial.transform import RigidTransform, Rotation

from drivers.kuka.simulator.machine import HOME, RAIL, flange_of
from tronlab.devices.readings import RobotTarget
from tronlab.geometry.poses import FloatArray
from tronlab.twin.instruments import Positioning
from tronlab.twin.world import World


class Scene(Protocol):
    """What the controller moves its robot in."""

    def robot_at(self) -> RobotTarget:
        """Give where the encoders say the robot stands."""
        ...

    def begin_move(self, target: RobotTarget) -> None:
        """Take note that a move to a target begins.

        Raises:
            DeviceTimeoutError: A script says that it never starts.
            DeviceError: A script says that it fails; any other error of the tree.
        """
        ...

    def stand(self, encoders: RobotTarget, *, progress: float) -> None:
        """Let the robot stand there; ``progress`` of the move is from 0 to 1."""
        ...


class EmptyScene:
    """Nothing but the robot, which goes exactly where it is told."""

    def __init__(self, robot_at: RobotTarget | None = None) -> None:
        self._robot_at = robot_at or RobotTarget(float(HOME[RAIL]) * 1e-3, flange_of(HOME))

    def robot_at(self) -> RobotTarget:
        """Give where the robot stands."""
        return self._robot_at

    def begin_move(self, target: RobotTarget) -> None:
        """Let every move begin."""

    def stand(self, encoders: RobotTarget, *, progress: float) -> None:
        """Let the robot stand there."""
        self._robot_at = encoders


class WorldScene:
    """The simulated laboratory: the robot stands a little off where its encoders say.

    Of every move one error is drawn, when it begins; on the way it grows out of the last one.
    """

    def __init__(self, world: World, noise: Generator) -> None:
        self._world = world
        self._positioning = Positioning(world, noise)
        state = world.state.read()
        here = _Error.between(state.robot_encoders.target, state.robot_actual.target)
        self._last = self._now = self._next = here

    def robot_at(self) -> RobotTarget:
        """Give where the encoders say the robot stands."""
        return self._world.robot_at

    def begin_move(self, target: RobotTarget) -> None:
        """Draw where the robot will really stand, if the rig's script of faults lets it."""
        self._world.faults.count("robot", "move", name="robot")
        self._last = self._now
        self._next = _Error.between(target, self._positioning.actual(target))

    def stand(self, encoders: RobotTarget, *, progress: float) -> None:
        """Let the robot stand there, with its error."""
        self._now = self._last.blended(self._next, progress)
        self._world.stand_robot(encoders, actual=self._now.applied_to(encoders))


@dataclass(frozen=True, slots=True)
class _Error:
    """How far off the encoders a robot really stands."""

    rail_m: float
    translation_m: FloatArray
    turn_rad: FloatArray

    @classmethod
    def between(cls, encoders: RobotTarget, actual: RobotTarget) -> "_Error":
        off = encoders.base_from_flange.inv() * actual.base_from_flange
        return cls(actual.rail_m - encoders.rail_m, off.translation, off.rotation.as_rotvec())

    def blended(self, other: "_Error", progress: float) -> "_Error":
        return _Error(
            self.rail_m + progress * (other.rail_m - self.rail_m),
            self.translation_m + progress * (other.translation_m - self.translation_m),
            self.turn_rad + progress * (other.turn_rad - self.turn_rad),
        )

    def applied_to(self, encoders: RobotTarget) -> RobotTarget:
        off = RigidTransform.from_components(
            self.translation_m, Rotation.from_rotvec(self.turn_rad)
        )
        return RobotTarget(encoders.rail_m + self.rail_m, encoders.base_from_flange * off)
