"""The part of a simulated laboratory that changes, as plain numbers.

So it crosses processes unchanged. In one process the state is a ``LocalState``; simulators in
processes of their own share one through ``tronlab.twin.server``.
"""

import threading
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Final, Protocol, TypeAlias

from scipy.spatial.transform import RigidTransform

from tronlab.devices.readings import RobotTarget
from tronlab.geometry.poses import pose_from_xyz_quat, xyz_quat_from_pose

PoseNumbers: TypeAlias = tuple[float, float, float, float, float, float, float]
"""x, y, z in metres, and the quaternion qx, qy, qz, qw."""

FOR_EVER: Final = -1
"""A fault armed so often lasts until it is cleared."""


def numbers_of(pose: RigidTransform) -> PoseNumbers:
    """Give a pose as plain numbers."""
    x, y, z, qx, qy, qz, qw = (float(v) for v in xyz_quat_from_pose(pose))
    return x, y, z, qx, qy, qz, qw


@dataclass(frozen=True, slots=True)
class RobotState:
    """Where a robot stands."""

    rail_m: float
    base_from_flange: PoseNumbers

    @classmethod
    def at(cls, target: RobotTarget) -> "RobotState":
        """Make the state of a robot that stands at a target."""
        return cls(target.rail_m, numbers_of(target.base_from_flange))

    @property
    def target(self) -> RobotTarget:
        """Get it as a target."""
        return RobotTarget(self.rail_m, pose_from_xyz_quat(self.base_from_flange))


@dataclass(frozen=True, slots=True)
class WorldState:
    """Everything of a simulated laboratory that its devices can change."""

    robot_encoders: RobotState
    """Where the robot's encoders say it stands."""
    robot_actual: RobotState
    """Where it really stands."""
    trs_from_board: PoseNumbers | None
    """None while no board is placed."""
    lamp_level: float
    """Of the lamp's full light: 0 is dark."""
    is_door_closed: bool
    air_temperature_k: float
    air_pressure_pa: float
    relative_humidity: float
    tracker_shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """How far the tracker was moved since the laboratory was built, in trs."""

    @property
    def view(self) -> tuple[object, ...]:
        """Get what the camera's view depends on."""
        return self.robot_actual, self.trs_from_board, self.lamp_level

    def as_json(self) -> dict[str, Any]:
        """Give the state as JSON knows it; floats keep every bit."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> "WorldState":
        """Read what ``as_json`` gave."""
        return cls(**{key: value_from_json(key, value) for key, value in values.items()})


def value_from_json(key: str, value: Any) -> Any:
    """Read one field of the state.

    Raises:
        KeyError: The state has no such field.
    """
    if key not in {field.name for field in fields(WorldState)}:
        raise KeyError(key)
    if key.startswith("robot_"):
        return RobotState(float(value["rail_m"]), tuple(value["base_from_flange"]))  # pyright: ignore[reportArgumentType]  # seven of them, as as_json wrote
    if key == "trs_from_board":
        return None if value is None else tuple(value)
    if key == "tracker_shift_m":
        return tuple(value)
    return value


class Faults(Protocol):
    """Faults that a person or a test has armed, by names such as ``tracker.beam_broken``."""

    def is_armed(self, name: str) -> bool:
        """Look whether a fault is armed, and leave it so: for a condition that lasts."""
        ...

    def strike(self, name: str) -> bool:
        """Look whether a fault is armed, and use it up once: for one that hits single actions."""
        ...

    def arm(self, name: str, *, times: int = FOR_EVER) -> None:
        """Arm a fault for so many strikes; 0 clears it."""
        ...


class StateStore(Faults, Protocol):
    """Where the state of a simulated laboratory is kept; safe to use from several threads."""

    def read(self) -> WorldState:
        """Get the state now."""
        ...

    def change(self, **values: Any) -> None:
        """Change some fields at once."""
        ...

    def close(self) -> None:
        """Let go of what it holds; it may be used again."""
        ...


class ArmedFaults:
    """Faults kept in this process."""

    def __init__(self, times: Mapping[str, int] | None = None) -> None:
        self._times = dict(times or {})
        self._lock = threading.Lock()

    def is_armed(self, name: str) -> bool:
        """Look whether a fault is armed."""
        with self._lock:
            return self._times.get(name, 0) != 0

    def strike(self, name: str) -> bool:
        """Use a fault up once."""
        with self._lock:
            times = self._times.get(name, 0)
            if times > 0:
                self._times[name] = times - 1
            return times != 0

    def arm(self, name: str, *, times: int = FOR_EVER) -> None:
        """Arm a fault for so many strikes; 0 clears it."""
        with self._lock:
            self._times[name] = times


class LocalState(ArmedFaults):
    """A state kept in this process."""

    def __init__(self, state: WorldState) -> None:
        super().__init__()
        self._state = state

    def read(self) -> WorldState:
        """Get the state now."""
        return self._state

    def change(self, **values: Any) -> None:
        """Change some fields at once."""
        with self._lock:
            self._state = replace(self._state, **values)

    def close(self) -> None:
        """Nothing to let go."""
