"""The rig file: which laboratory, which terrain, which devices."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

from pydantic import Field

from tronlab.devices.cell import CellSpec
from tronlab.devices.clock import WallClock
from tronlab.devices.laboratory import LaboratorySpec
from tronlab.devices.protocols import Device
from tronlab.devices.registry import CLOCK_KEY, KINDS, DeviceContext, Devices, make_device
from tronlab.errors import ConfigError
from tronlab.terrain.config import TerrainConfig
from tronlab.terrain.heightmap import HeightMap
from tronlab.twin.config import WorldConfig
from tronlab.yaml_models import Model, join_errors
from tronlab.yaml_variants import Document, read_document

if TYPE_CHECKING:
    from tronlab.twin.world import WorldSetup


class DeviceConfig(Model):
    """Which driver a device has, and the driver's own settings."""

    driver: Annotated[str, Field(min_length=1)]
    """Name of an installed driver: an entry point of the group ``tronlab.devices``."""
    options: Annotated[dict[str, Any], Field(default_factory=dict)]
    """Settings of this driver, such as addresses."""


class DevicesConfig(Model):
    """The devices of the rig."""

    robot: DeviceConfig
    tracker: DeviceConfig
    camera: DeviceConfig
    room: DeviceConfig
    operator: DeviceConfig
    """Who does what no device can do, such as placing the calibration board."""


class CalibrationConfig(Model):
    """How calibrations of this rig are looked after."""

    valid_days: Annotated[float, Field(gt=0)] | None = 30.0
    """How long after it was measured a calibration record serves; null: without end."""


RigName: TypeAlias = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]


class RigConfig(Model):
    """A rig file."""

    name: RigName
    """Name of the rig; calibration records are made for one rig and name it."""
    laboratory: LaboratorySpec
    """The laboratory as designed."""
    terrain: TerrainConfig
    """The terrain model."""
    devices: DevicesConfig
    """The devices, and the drivers that talk to them."""
    calibration: CalibrationConfig = CalibrationConfig()
    """How calibrations of this rig are looked after."""
    cell: CellSpec = CellSpec()
    """What the robot must not hit, what the tracker sees, and how long things take: for plans."""
    world: WorldConfig | None = None
    """The simulated laboratory behind twin devices; a rig of hardware has none."""


@dataclass(frozen=True)
class Rig:
    """A rig file that was read."""

    config: RigConfig
    document: Document
    """The file, and those it extends."""

    @property
    def path(self) -> Path:
        """Get the path of the file."""
        return self.document.path

    @property
    def text(self) -> str:
        """Get the file as it is written."""
        return self.document.text

    @property
    def whole_text(self) -> str:
        """Get everything that was read, for provenance."""
        return self.document.whole_text

    @property
    def name(self) -> str:
        """Get the name of the rig."""
        return self.config.name

    def load_heightmap(self, announce: Callable[[str], None] | None = None) -> HeightMap:
        """Make or read the terrain model; ``announce`` is told of slow steps.

        Raises:
            TerrainError: Its file cannot be read or makes no sense.
        """
        return self._load_terrain(self.config.terrain, announce)

    def open_devices(
        self,
        seed: int,
        *,
        session: str = "run",
        load_heightmap: Callable[[], HeightMap] | None = None,
    ) -> Devices:
        """Make the devices, not yet connected.

        Args:
            seed: Seed of the measurement noise of simulated devices.
            session: What they are opened for; see ``DeviceContext``.
            load_heightmap: Where simulated devices get the terrain; by default ``load_heightmap``.

        Raises:
            ConfigError: A driver is unknown or refuses its options.
        """
        world = self.world_setup(load_heightmap)
        shared: dict[str, object] = {}
        devices: dict[str, Device] = {}
        errors: list[ConfigError] = []
        for kind in KINDS:
            config: DeviceConfig = getattr(self.config.devices, kind)
            context = self.device_context(
                kind, seed=seed, session=session, world=world, shared=shared
            )
            try:
                devices[kind] = make_device(config.driver, kind, context)
            except ConfigError as error:
                errors.extend(self._placed(part, kind) for part in error.parts)
        if errors:
            raise join_errors(errors)
        clock: Any = shared.get(CLOCK_KEY) or WallClock()
        return Devices(**devices, clock=clock)  # pyright: ignore[reportArgumentType]  # make_device checked them

    def device_context(
        self,
        kind: str,
        *,
        seed: int,
        session: str,
        world: "WorldSetup | None",
        shared: dict[str, object] | None = None,
    ) -> DeviceContext:
        """Give what the driver of a kind of device may know, and its simulator on the wire."""
        config: DeviceConfig = getattr(self.config.devices, kind)
        return DeviceContext(
            name=kind,
            options=config.options,
            seed=seed,
            world=world,
            base_dir=self.path.parent,
            session=session,
            shared={} if shared is None else shared,
        )

    def world_setup(
        self, load_heightmap: Callable[[], HeightMap] | None = None
    ) -> "WorldSetup | None":
        """Give what the simulated laboratory is made from; None if the rig describes none.

        Args:
            load_heightmap: Where its camera gets the terrain, unless ``world.terrain`` says
                how that really is; by default ``load_heightmap``.
        """
        world = self.config.world
        if world is None:
            return None
        from tronlab.twin.world import WorldSetup

        if world.terrain is not None:
            load_heightmap = partial(self._load_terrain, world.terrain)
        return WorldSetup(
            config=world,
            laboratory=self.config.laboratory,
            load_heightmap=load_heightmap or self.load_heightmap,
        )

    def _load_terrain(
        self,
        terrain: TerrainConfig,
        announce: Callable[[str], None] | None = None,
    ) -> HeightMap:
        """Make or read a terrain that a section of the file describes."""
        from tronlab.terrain.load import load_terrain

        return load_terrain(terrain, base_dir=self.path.parent, announce=announce)

    def _placed(self, error: ConfigError, kind: str) -> ConfigError:
        """Say where in the rig file a driver's complaint belongs."""
        if error.path is not None:
            return error
        key = error.key or f"devices.{kind}"
        message = str(error).removeprefix(f"{error.key}: ")
        return self.error(message, *key.split("."))

    def error(self, message: str, *key: str) -> ConfigError:
        """Make an error that names file, line and key."""
        return self.document.error(message, *key)


def load_rig(path: Path) -> Rig:
    """Read a rig file.

    Raises:
        ConfigError: It cannot be read, or says something that cannot be.
    """
    document = read_document(path)
    return Rig(config=document.read_as(RigConfig), document=document)
