"""The campaign file: what shall be recorded, with which rig, and how it is scored."""

from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, ValidationInfo, model_validator

from tronlab.errors import ConfigError
from tronlab.render.renderer import Photometry, RaysPerPixel
from tronlab.trajectory.config import TrajectoryConfig
from tronlab.yaml_models import (
    ExistingFile,
    Model,
    dotted,
    existing_file,
    line_of,
    parse_model,
    read_text,
)


def _calibration_file(value: Path, info: ValidationInfo) -> Path:
    try:
        return existing_file(value, info)
    except ValueError as error:
        raise ValueError(f"{error}; make it: tronlab calibrate all --rig RIG.yaml") from error


Seconds = Annotated[float, Field(gt=0, le=3600)]


class DatabaseConfig(Model):
    """The reference views that navigation cores build their database from."""

    n_views: Annotated[int, Field(ge=1)] = 11
    """Number of nominal poses to render, equally spaced in the trajectory, both ends included."""
    rays_per_pixel: RaysPerPixel = 4
    """Rays cast through a pixel: 1 is faster, 4 has smooth edges."""
    photometry: Photometry = "lambert"
    """How the surface is taken to reflect light."""


class CameraConfig(Model):
    """How images are taken."""

    exposure_s: Annotated[float, Field(gt=0, le=60)]
    """Exposure time."""
    gain_db: Annotated[float, Field(ge=0, le=48)] = 0.0
    """Analogue gain."""
    pixel_format: Literal["Mono8", "Mono12"] = "Mono8"
    """Grey values of 8 or 12 bit."""
    timeout_s: Seconds = 10.0
    """How long one image may take; more than the exposure."""

    @model_validator(mode="after")
    def _exposure_fits(self) -> "CameraConfig":
        if self.exposure_s >= self.timeout_s:
            raise ValueError(f"exposure_s {self.exposure_s:g} must be below timeout_s")
        return self


class SettleConfig(Model):
    """When the camera counts as standing still, judged by the tracker."""

    wait_s: Annotated[float, Field(ge=0, le=600)] = 0.5
    """Wait between two looks."""
    window_s: Seconds = 0.1
    """Averaging time of one look."""
    max_shift_m: Annotated[float, Field(gt=0)] = 5e-4
    """Two looks in a row must agree in position within this."""
    max_turn_deg: Annotated[float, Field(gt=0)] = 0.1
    """Two looks in a row must agree in rotation within this."""
    timeout_s: Seconds = 30.0
    """Give up after this; the shot is then tried again."""


class TrackerConfig(Model):
    """How the ground truth is measured."""

    window_s: Seconds = 1.0
    """Averaging time of the measurement that becomes the ground truth."""


class DriftConfig(Model):
    """How it is watched whether tracker, model or reflectors move while the campaign runs."""

    every_n_shots: Annotated[int, Field(ge=1)] | None = 20
    """The reflectors are measured anew after so many shots; null: only at start and end."""
    limit_m: Annotated[float, Field(gt=0)] = 6e-4
    """How far the model may seem to have moved, where it seems so most. With three reflectors 3 to
    7 m from the tracker, noise alone makes 0.12 mm of it in the median and 0.3 mm once in a
    hundred times: less than 0.6 mm would be a false alarm now and then."""
    window_s: Seconds = 1.0
    """Averaging time of each reflector."""
    on_drift: Literal["stop", "continue"] = "stop"
    """What happens beyond the limit; shots since the last good check count as suspect either way.
    At the start a run refuses to begin unless told by ``--accept-calibration``."""


class RobotConfig(Model):
    """How the robot is driven."""

    timeout_s: Seconds = 300.0
    """How long one move may take."""


class RoomConfig(Model):
    """What the room must be like."""

    needs_closed_door: bool = True
    """Wait while the door is open, and take a shot again during which it was."""
    timeout_s: Seconds = 3600.0
    """How long to wait for a person to make the cell safe."""
    max_temperature_difference_k: Annotated[float, Field(gt=0)] = 1.0
    """Warn if the room's air and the tracker's differ by more: 1 K changes a distance by 1 ppm."""
    max_pressure_difference_pa: Annotated[float, Field(gt=0)] = 200.0
    """Likewise; 400 Pa change a distance by 1 ppm."""


class ScoreConfig(Model):
    """How the dataset is scored by ``tronlab demo``."""

    cores: Annotated[tuple[str, ...], Field(min_length=1)] = (
        "akaze",
        "brisk",
        "akaze-refined",
        "brisk-refined",
    )
    """Navigation cores by name; ``tronlab score --core NAME`` says which there are."""


class CampaignConfig(Model):
    """A campaign file."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
    """Short name; results go to out/NAME unless told otherwise."""
    title: str = ""
    """One line for the report."""
    rig: ExistingFile
    """Rig file, relative to this file."""
    calibration: Annotated[Path, AfterValidator(_calibration_file)]
    """Calibration record of that rig, relative to this file."""
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    """Seed of every random number of the run: noise of simulated devices."""
    trajectory: TrajectoryConfig
    """Camera poses of the shots."""
    database: DatabaseConfig = DatabaseConfig()
    """Reference views for navigation cores."""
    camera: CameraConfig
    """How images are taken."""
    settle: SettleConfig = SettleConfig()
    """When the camera counts as standing still."""
    tracker: TrackerConfig = TrackerConfig()
    """How the ground truth is measured."""
    drift: DriftConfig | None = DriftConfig()
    """How it is watched whether something moves; null: not at all, no shot is vouched for."""
    robot: RobotConfig = RobotConfig()
    """How the robot is driven."""
    room: RoomConfig = RoomConfig()
    """What the room must be like."""
    score: ScoreConfig = ScoreConfig()
    """How the dataset is scored."""


@dataclass(frozen=True)
class Campaign:
    """A campaign file that was read."""

    config: CampaignConfig
    path: Path
    text: str
    """The file as it is written, for provenance."""

    @property
    def name(self) -> str:
        """Get the name of the campaign."""
        return self.config.name

    def error(self, message: str, *location: int | str) -> ConfigError:
        """Make an error about a key of this file, with its line."""
        line = line_of(self.text, location)
        return ConfigError(message, path=self.path, line=line, key=dotted(location))


def load_campaign(path: Path, *, overridden: AbstractSet[str] = frozenset()) -> Campaign:
    """Read a campaign file.

    Args:
        path: The YAML file.
        overridden: Those of ``rig`` and ``calibration`` that the caller brings himself, so that
            the files named here need not exist.

    Raises:
        ConfigError: It cannot be read, or says something that cannot be.
    """
    text = read_text(path)
    config = parse_model(text, CampaignConfig, path=path, overridden=overridden)
    return Campaign(config=config, path=path, text=text)
