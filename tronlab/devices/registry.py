"""From a driver's name in a rig file to a device: through the entry points ``tronlab.devices``.

An entry point is a factory ``factory(context: DeviceContext) -> Device``; nothing is imported
before its name is asked for.
"""

from collections.abc import Callable, Collection, Generator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel

from tronlab.devices.clock import Clock, WallClock
from tronlab.devices.protocols import Camera, Device, Operator, PoseTracker, Robot, RoomIO
from tronlab.errors import ConfigError, TronlabError
from tronlab.yaml_models import parse_mapping

ENTRY_POINT_GROUP = "tronlab.devices"
CLOCK_KEY = "tronlab.clock"
"""Where simulated devices that let time pass at once keep their clock in ``shared``."""
SIMULATOR_GROUP = "tronlab.simulators"
"""Modules that run as ``python -m``, and have ``FAULTS``: name of each fault, and what happens."""

KINDS: Mapping[str, Any] = {
    "robot": Robot,
    "tracker": PoseTracker,
    "camera": Camera,
    "room": RoomIO,
    "operator": Operator,
}
"""The devices a rig has, and the Protocol each keeps."""

T = TypeVar("T")
M = TypeVar("M", bound=BaseModel)


@dataclass
class DeviceContext:
    """What a device factory may know."""

    name: str
    """The device's name in the rig file."""
    options: Mapping[str, Any]
    """The device's own settings from the rig file."""
    seed: int
    """Seed of every random number of this session; hardware ignores it."""
    world: object | None
    """Description of the simulated world, for devices that are views of it."""
    base_dir: Path = Path()
    """Folder of the rig file: relative paths in the options start there."""
    session: str = "run"
    """What the devices are opened for: sessions of one seed but another name have other noise."""
    shared: dict[str, object] = field(default_factory=dict[str, object])
    """One for all devices of a rig: simulated devices keep their common world here."""

    def parse_options(self, model: type[M]) -> M:
        """Read the options as a driver's own model.

        Raises:
            ConfigError: They do not fit; one line a problem, each with key and what is allowed.
        """
        return parse_mapping(self.options, model, key=f"devices.{self.name}.options")

    def share(self, key: str, make: Callable[[], T]) -> T:
        """Give the object of that key, made by the first device that asks."""
        if key not in self.shared:
            self.shared[key] = make()
        return self.shared[key]  # pyright: ignore[reportReturnType]  # keys belong to their makers


@dataclass(frozen=True)
class Devices:
    """The devices of a rig, connected."""

    robot: Robot
    tracker: PoseTracker
    camera: Camera
    room: RoomIO
    operator: Operator
    clock: Clock = field(default_factory=WallClock)
    """The time of the laboratory they are in."""

    def all(self) -> tuple[Device, ...]:
        """Give every device."""
        return self.of(KINDS)

    def of(self, kinds: Collection[str]) -> tuple[Device, ...]:
        """Give the devices of some kinds, in the order of ``KINDS``."""
        return tuple(getattr(self, kind) for kind in KINDS if kind in kinds)


def known_drivers() -> dict[str, EntryPoint]:
    """Give every installed driver by name."""
    return {point.name: point for point in entry_points(group=ENTRY_POINT_GROUP)}


def known_simulators() -> dict[str, EntryPoint]:
    """Give every installed simulator by the name of the driver that talks to it."""
    return {point.name: point for point in entry_points(group=SIMULATOR_GROUP)}


def make_device(driver: str, kind: str, context: DeviceContext) -> Device:
    """Make one device, not yet connected.

    Raises:
        ConfigError: No such driver, or it does not keep the Protocol of its kind.
    """
    drivers = known_drivers()
    if driver not in drivers:
        raise ConfigError(
            f"no driver '{driver}'; installed drivers: {', '.join(sorted(drivers)) or 'none'}",
            key=f"devices.{kind}.driver",
        )
    device = drivers[driver].load()(context)
    if not isinstance(device, KINDS[kind]):
        raise ConfigError(
            f"driver '{driver}' is not a {KINDS[kind].__name__}", key=f"devices.{kind}.driver"
        )
    return device


@contextmanager
def connected(devices: Devices, kinds: Collection[str] = tuple(KINDS)) -> Generator[Devices]:
    """Connect the devices of some kinds, by default every one, and close them at the end.

    Raises:
        ExceptionGroup: Of every device that failed to connect, not only the first.
    """
    with ExitStack() as stack:
        failures: list[TronlabError] = []
        needed = devices.of(kinds)
        for device in needed:
            stack.callback(device.close)
            try:
                device.connect()
            except TronlabError as error:
                failures.append(error)
        if failures:
            raise ExceptionGroup(
                f"{len(failures)} of {len(needed)} devices failed to connect", failures
            )
        yield devices
