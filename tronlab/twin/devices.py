"""The simulated laboratory's devices: each sees the one world through its Protocol, and no more."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Annotated, TypeVar

from numpy.random import Generator
from pydantic import AfterValidator

from tronlab.devices.address import parse_address
from tronlab.devices.clock import WallClock
from tronlab.devices.protocols import OperatorTask
from tronlab.devices.readings import (
    DeviceIdentity,
    Frame,
    PointReading,
    PoseReading,
    Posture,
    RobotReading,
    RobotTarget,
    RoomReading,
)
from tronlab.devices.registry import CLOCK_KEY, DeviceContext
from tronlab.errors import ConfigError, DeviceTimeoutError, LimitError, NotConnectedError
from tronlab.twin.instruments import CameraOptics, Positioning, TrackerOptics, noise_of
from tronlab.twin.reach import likely_posture, move_duration_s, posture_at
from tronlab.twin.sensor import HIGHEST_CODE
from tronlab.twin.server import RemoteState
from tronlab.twin.state import RobotState
from tronlab.twin.truth import deviate
from tronlab.twin.world import World, WorldSetup
from tronlab.yaml_models import Model

WORLD_KEY = "tronlab.twin.world"
"""Where the devices of a rig keep their common world in ``DeviceContext.shared``."""

_FIRMWARE = "twin-1"

T = TypeVar("T")


class _View(ABC):
    """What all simulated devices have in common."""

    _kind: str

    def __init__(self, context: DeviceContext) -> None:
        self._name = context.name
        self._world = _common_world(context)
        self._rng: Generator = noise_of(self._kind, seed=context.seed, session=context.session)
        self._is_connected = False

    @property
    def name(self) -> str:
        """Get the name errors and logs use."""
        return self._name

    def connect(self) -> None:
        """Make the device ready."""
        self._world.faults.count(self._kind, "connect", name=self._name)
        self._world.state.read()
        self._is_connected = True

    def close(self) -> None:
        """Close the connection."""
        self._is_connected = False
        self._world.state.close()

    def identify(self) -> DeviceIdentity:
        """Read maker, model, serial number and firmware."""
        self._begin("identify")
        maker, model = self._maker_and_model()
        return self._identity(maker, model)

    @abstractmethod
    def _maker_and_model(self) -> tuple[str, str]: ...

    def _identity(self, maker: str, model: str) -> DeviceIdentity:
        return DeviceIdentity(
            maker=maker, model=model, serial=self._world.serial, firmware=_FIRMWARE
        )

    def _begin(self, call: str) -> None:
        """Start a call: fail if not connected, or if the script says so."""
        if not self._is_connected:
            raise NotConnectedError(
                f"{call}: not connected; call connect() first", device=self.name
            )
        self._world.faults.count(self._kind, call, name=self._name)


class TwinRobot(_View):
    """Rail and arm. The encoders say what was commanded; the flange stands elsewhere by chance."""

    _kind = "robot"

    def __init__(self, context: DeviceContext) -> None:
        super().__init__(context)
        self._positioning = Positioning(self._world, self._rng)
        self._posture: Posture | None = None
        self._encoders: RobotState | None = None
        """What they said when the posture was taken."""

    def check(self, target: RobotTarget) -> None:
        """Return if the target can be reached."""
        self._begin("check")
        self._stand_at(target, near=self._posture, call="check")

    def posture_for(self, target: RobotTarget, *, near: Posture | None = None) -> Posture:
        """Choose how to stand at a target, with the least motion from ``near``, or from upright."""
        return self._stand_at(target, near=near, call="posture_for")

    def move_duration_s(self, start: Posture, end: Posture) -> float:
        """Give how long ``move`` takes from one posture to another."""
        return move_duration_s(start, end, self._world.config.robot)

    def move(self, target: RobotTarget, *, timeout_s: float) -> None:
        """Move there; a move that would take longer than allowed is not begun."""
        self._begin("move")
        start = self._posture_now()
        end = self._stand_at(target, near=start, call="move")
        duration_s = self.move_duration_s(start, end)
        if duration_s > timeout_s:
            raise DeviceTimeoutError(
                f"move: takes {duration_s:.1f} s, allowed {timeout_s:.1f} s", device=self.name
            )
        self._world.stand_robot(target, actual=self._positioning.actual(target))
        self._posture, self._encoders = end, RobotState.at(target)
        self._world.clock.advance(duration_s)

    def read(self) -> RobotReading:
        """Read the encoders."""
        self._begin("read")
        at = self._world.robot_at
        return RobotReading(
            rail_m=at.rail_m,
            base_from_flange=at.base_from_flange,
            time_s=self._world.clock.now_s,
        )

    def stop(self) -> None:
        """Stop; moves take no real time here, so there is none to stop."""
        self._begin("stop")

    def _maker_and_model(self) -> tuple[str, str]:
        return "KUKA", "KR 16"

    def _stand_at(self, target: RobotTarget, *, near: Posture | None, call: str) -> Posture:
        rail_range_m = self._world.spec.mounting.rail_range_m
        return posture_at(target, near=near, rail_range_m=rail_range_m, device=self.name, call=call)

    def _posture_now(self) -> Posture:
        """Give the posture of the last move, or a likely one if somebody else moved the robot."""
        encoders = self._world.state.read().robot_encoders
        if self._posture is None or encoders != self._encoders:
            return likely_posture(encoders.target, near=self._posture, device=self.name)
        return self._posture


class TwinTracker(_View):
    """The laser tracker; it sees everything from where it stands."""

    _kind = "tracker"

    def __init__(self, context: DeviceContext) -> None:
        super().__init__(context)
        self._optics = TrackerOptics(self._world, self._rng)

    def identify_target(self) -> DeviceIdentity:
        """Read which T-MAC the tracker sees."""
        self._begin("identify_target")
        return self._identity("Leica", "T-MAC")

    def measure_point(self, target: str, *, window_s: float) -> PointReading:
        """Measure the named reflector."""
        self._begin("measure_point")
        targets = self._optics.reflectors
        if target not in targets:
            raise LimitError(
                f"measure_point: no reflector '{target}'; reflectors: {', '.join(targets)}",
                device=self.name,
            )
        return self._observe(lambda: self._optics.point(target), window_s, call="measure_point")

    def measure_pose(self, *, window_s: float) -> PoseReading:
        """Measure the T-MAC."""
        self._begin("measure_pose")
        return self._observe(self._optics.pose, window_s, call="measure_pose")

    def _maker_and_model(self) -> tuple[str, str]:
        return "Leica", "AT901-MR"

    def _observe(self, look: Callable[[], T], window_s: float, *, call: str) -> T:
        """Look in the middle of the window."""
        if not window_s > 0:
            raise LimitError(
                f"{call}: window is {window_s} s, must be more than 0", device=self.name
            )
        self._world.clock.advance(window_s / 2)
        reading = look()
        self._world.clock.advance(window_s / 2)
        return reading


class TwinCamera(_View):
    """The camera, which sees the world through its lens."""

    _kind = "camera"

    def __init__(self, context: DeviceContext) -> None:
        super().__init__(context)
        self._optics = CameraOptics(self._world, self._rng)
        self._exposure_s = 0.02
        self._gain_db = 0.0
        self._pixel_format = "Mono8"
        self._n_frames = 0

    def connect(self) -> None:
        """Make the camera ready, and the terrain it will see."""
        super().connect()
        self._world.prepare_view()

    def configure(self, *, exposure_s: float, gain_db: float, pixel_format: str) -> None:
        """Set how frames are taken."""
        self._begin("configure")
        sensor = self._world.config.sensor
        self._check_range("exposure", exposure_s, sensor.exposure_range_s, "s")
        self._check_range("gain", gain_db, sensor.gain_range_db, "dB")
        if pixel_format not in HIGHEST_CODE:
            allowed = ", ".join(HIGHEST_CODE)
            raise LimitError(
                f"configure: pixel format is '{pixel_format}', allowed {allowed}", device=self.name
            )
        self._exposure_s, self._gain_db = exposure_s, gain_db
        self._pixel_format = pixel_format

    def grab(self, *, timeout_s: float) -> Frame:
        """Take one frame."""
        self._begin("grab")
        sensor, clock = self._world.config.sensor, self._world.clock
        duration_s = self._exposure_s + sensor.readout_s
        if duration_s > timeout_s:
            raise DeviceTimeoutError(
                f"grab: exposure and read-out take {duration_s:.3f} s, allowed {timeout_s:.3f} s",
                device=self.name,
            )
        clock.advance(self._exposure_s / 2)
        time_s = clock.now_s
        image = self._optics.image(
            exposure_s=self._exposure_s, gain_db=self._gain_db, pixel_format=self._pixel_format
        )
        clock.advance(duration_s - self._exposure_s / 2)
        self._n_frames += 1
        return Frame(
            image=image,
            pixel_format=self._pixel_format,
            exposure_s=self._exposure_s,
            gain_db=self._gain_db,
            frame_id=self._n_frames,
            time_s=time_s,
            device_time_s=time_s,
        )

    def _maker_and_model(self) -> tuple[str, str]:
        return "Allied Vision", self._world.spec.camera.model

    def _check_range(
        self, what: str, value: float, allowed: tuple[float, float], unit: str
    ) -> None:
        low, high = allowed
        if not low <= value <= high:
            raise LimitError(
                f"configure: {what} is {value:g} {unit}, allowed {low:g} to {high:g} {unit}",
                device=self.name,
            )


class TwinRoom(_View):
    """Door, lamp and air."""

    _kind = "room"

    def read(self) -> RoomReading:
        """Read the state of the room."""
        self._begin("read")
        state = self._world.state.read()
        return RoomReading(
            air_temperature_k=state.air_temperature_k,
            air_pressure_pa=state.air_pressure_pa,
            relative_humidity=state.relative_humidity,
            is_door_closed=state.is_door_closed,
            is_lamp_on=state.lamp_level > 0.0,
            time_s=self._world.clock.now_s,
        )

    def switch_lamp(self, *, on: bool) -> None:
        """Switch the lamp."""
        self._begin("switch_lamp")
        self._world.state.change(lamp_level=1.0 if on else 0.0)

    def _maker_and_model(self) -> tuple[str, str]:
        return "tronlab", "room"


class TwinOperator(_View):
    """Someone who places the board where the rig file says, as well as one can by eye."""

    _kind = "operator"

    def perform(self, task: OperatorTask) -> None:
        """Have the task done."""
        self._begin("perform")
        if task == "remove_board":
            self._world.place_board(None)
            return
        nominal = self._world.spec.board.trs_from_board.pose
        placement = self._world.config.board.placement
        self._world.place_board(deviate(nominal, placement, self._rng))

    def _maker_and_model(self) -> tuple[str, str]:
        return "tronlab", "operator"


def open_robot(context: DeviceContext) -> TwinRobot:
    """Make the robot."""
    return TwinRobot(context)


def open_tracker(context: DeviceContext) -> TwinTracker:
    """Make the tracker."""
    return TwinTracker(context)


def open_camera(context: DeviceContext) -> TwinCamera:
    """Make the camera."""
    return TwinCamera(context)


def open_room(context: DeviceContext) -> TwinRoom:
    """Make the room."""
    return TwinRoom(context)


def open_operator(context: DeviceContext) -> TwinOperator:
    """Make the operator."""
    return TwinOperator(context)


def _address(text: str) -> str:
    parse_address(text)
    return text


class TwinOptions(Model):
    """Options of a simulated device: how it behaves is set in section ``world``."""

    world: Annotated[str, AfterValidator(_address)] | None = None
    """HOST:PORT of the laboratory that ``tronlab twin up`` serves; by default one of its own."""


def _common_world(context: DeviceContext) -> World:
    """Give the world of this rig; its first device makes it.

    Raises:
        ConfigError: The rig file describes no world, or has options no simulated device knows.
    """
    setup = context.world
    if not isinstance(setup, WorldSetup):
        raise ConfigError(f"simulated device '{context.name}' needs this section", key="world")
    options = context.parse_options(TwinOptions)
    if options.world is None:
        world = context.share(WORLD_KEY, lambda: World(setup))
        context.share(CLOCK_KEY, lambda: world.clock)
        return world
    host, port = parse_address(options.world)
    return context.share(
        f"{WORLD_KEY} at {options.world}",
        lambda: World(setup, clock=WallClock(), state=RemoteState(host, port)),
    )
