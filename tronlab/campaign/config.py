"""The campaign file: what shall be recorded, with which rig, and how it is scored."""

from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo, model_validator

from tronlab.errors import ConfigError
from tronlab.render.photometry import Lambert, Photometry, PhotometryName, by_name
from tronlab.render.settings import RaysPerPixel, RendererChoice, RenderOptions
from tronlab.trajectory.config import TrajectoryConfig
from tronlab.yaml_models import ExistingFile, Model, existing_file
from tronlab.yaml_variants import Document, read_document


def _calibration_file(value: Path, info: ValidationInfo) -> Path:
    try:
        return existing_file(value, info)
    except ValueError as error:
        raise ValueError(f"{error}; make it: tronlab calibrate all --rig RIG.yaml") from error


Seconds = Annotated[float, Field(gt=0, le=3600)]
Fraction = Annotated[float, Field(ge=0, le=1)]
NotifyEvent: TypeAlias = Literal["begun", "suspended", "resumed", "done", "aborted", "failed"]


class CalibratedPhotometry(Model):
    """As ``tronlab calibrate photometry`` found it: the calibration record has the function."""

    kind: Literal["calibrated"] = "calibrated"


_DatabasePhotometry: TypeAlias = Annotated[
    CalibratedPhotometry | Photometry, Field(discriminator="kind")
]
DatabasePhotometry: TypeAlias = Annotated[
    _DatabasePhotometry,
    BeforeValidator(
        by_name,
        json_schema_input_type=Literal["calibrated", PhotometryName] | _DatabasePhotometry,
    ),
]


class DatabaseConfig(RendererChoice, RenderOptions):
    """The reference views that navigation cores build their database from."""

    trajectory: TrajectoryConfig | None = None
    """Where the reference views are rendered from, if not from poses of the campaign's own
    trajectory."""
    n_views: Annotated[int, Field(ge=1)] | None = 11
    """Number of poses of the trajectory to render, equally spaced in it, both ends included; null:
    all."""
    rays_per_pixel: RaysPerPixel = 4
    """Rays cast through a pixel: 1 is faster, 4 has smooth edges."""
    photometry: DatabasePhotometry = Lambert()
    """How the surface is taken to reflect light: `calibrated`, or a function by its name, or a
    mapping with kind and parameters."""


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
    max_temperature_difference_k: Annotated[float, Field(gt=0)] = 1.0
    """Warn if the room's air and the tracker's differ by more: 1 K changes a distance by 1 ppm."""
    max_pressure_difference_pa: Annotated[float, Field(gt=0)] = 200.0
    """Likewise; 400 Pa change a distance by 1 ppm."""


GateAction: TypeAlias = Literal["off", "flag", "retake"]


class GateConfig(Model):
    """When a shot that was taken is good enough; each check flags the shot, or has it retaken.

    What still fails after ``max_retakes`` is kept with its flags: nothing that was recorded is
    thrown away.
    """

    max_retakes: Annotated[int, Field(ge=0, le=10)] = 1
    """How often one shot is taken again for its quality."""
    saturation: GateAction = "flag"
    max_saturated_fraction: Fraction = 0.02
    """Part of the pixels within the mask that are at full scale."""
    contrast: GateAction = "flag"
    min_contrast: Annotated[float, Field(ge=0)] = 0.05
    """Standard deviation over mean of the grey values within the mask."""
    blur: GateAction = "retake"
    min_sharpness: Annotated[float, Field(ge=0, le=1)] = 0.5
    """Sharpness against the median of good shots of like range before it: 1 is as sharp as they
    are."""
    target: GateAction = "flag"
    min_usable_fraction: Fraction = 0.05
    """Part of the image that shows the model, by the measured pose."""
    tracker: GateAction = "retake"
    max_tracker_sigma_m: Annotated[float, Field(gt=0)] = 1e-4
    """Scatter of the T-MAC's position as the tracker states it: largest of three axes. A tracker of
    15 um + 6 um/m stays below this up to 14 m."""
    robot: GateAction = "flag"
    max_robot_shift_m: Annotated[float, Field(gt=0)] = 0.03
    """How far the measured camera may be from where the robot was to put it."""
    max_robot_turn_deg: Annotated[float, Field(gt=0)] = 1.0
    """Likewise its rotation."""
    temperature: GateAction = "flag"
    max_temperature_change_k: Annotated[float, Field(gt=0)] = 2.0
    """How far the room's air may be from what it was at the first shot of the session."""
    brightness: GateAction = "flag"
    max_brightness_change: Annotated[float, Field(gt=0, le=1)] = 0.15
    """How far the light on the model, against what a rendering predicts, may be from the median of
    good shots before it: beyond it the lamp has drifted, see ``suspend.on_lamp_drift``."""


class RetryRule(Model):
    """What is done about one class of errors."""

    max_attempts: Annotated[int, Field(ge=1, le=20)] = 3
    """Attempts at one shot; 1 is no second try."""
    pauses_s: Annotated[tuple[Annotated[float, Field(ge=0, le=600)], ...], Field(min_length=1)] = (
        1.0,
        5.0,
    )
    """Before the second, third... attempt; the last one is used again for all that follow."""


class RetryConfig(Model):
    """How often a shot is tried again, by class of error; every failure is counted in the data."""

    tracking_lost: RetryRule = RetryRule()
    """The beam is broken or does not find its target."""
    not_settled: RetryRule = RetryRule()
    """The pose still moves."""
    incomplete_frame: RetryRule = RetryRule()
    """Parts of an image were lost on the way."""
    not_ready: RetryRule = RetryRule()
    """A device is warming up or busy."""
    lost_connection: RetryRule = RetryRule()
    """A device was lost or does not answer; it is connected again first. Never the robot."""
    on_failure: Literal["stop", "skip"] = "skip"
    """When attempts are used up: end the run, or leave the shot out and go on with the next;
    ``tronlab run --retake DIR --failed`` takes them later. A device that stays lost or not ready
    ends the run either way."""
    max_skipped_in_row: Annotated[int, Field(ge=1)] = 3
    """After so many shots skipped one after the other, one more ends the run all the same."""


class SuspendConfig(Model):
    """Conditions in which a run waits, and goes on by itself when they are over."""

    timeout_s: Seconds = 3600.0
    """How long it waits for one of them."""
    look_s: Annotated[float, Field(gt=0, le=60)] = 0.5
    """Between two looks whether it is over."""
    on_beam_lost: bool = True
    """Wait for the tracker's beam when the attempts of ``retry.tracking_lost`` are used up."""
    on_lamp_drift: bool = False
    """Wait until the lamp is as bright again as it was, or a person resumes."""
    min_free_mb: Annotated[float, Field(ge=0)] = 200.0
    """Wait for room on the disk when less is free."""


class RecordingConfig(Model):
    """How the dataset is written."""

    segment_shots: Annotated[int, Field(ge=1, le=100_000)] = 100
    """Images and masks of so many shots go to one file; a full one never changes again, so that a
    running campaign can be copied elsewhere."""


class NotifyConfig(Model):
    """A command that is told how the run goes."""

    command: Annotated[tuple[str, ...], Field(min_length=1)]
    """Program and arguments, without a shell. It gets the environment variables
    ``TRONLAB_EVENT``, ``TRONLAB_TEXT``, ``TRONLAB_CAMPAIGN``, ``TRONLAB_DATASET`` and
    ``TRONLAB_SHOTS`` (taken/planned)."""
    events: Annotated[tuple[NotifyEvent, ...], Field(min_length=1)] = (
        "suspended",
        "resumed",
        "done",
        "aborted",
        "failed",
    )
    """Of what it is told."""
    timeout_s: Seconds = 30.0
    """It is ended after so long; the run never waits for it."""


class PlanConfig(Model):
    """What a plan must be like before anything moves."""

    min_usable_fraction: Fraction = 0.2
    """Least part of each image that shows the model: the paper uses images above 20 % (section
    3.3)."""
    range_los_m: tuple[Annotated[float, Field(ge=0)], Annotated[float, Field(gt=0)]] = (0.3, 100.0)
    """Least and greatest distance to the terrain along the optical axis."""
    min_lit_fraction: Fraction = 0.05
    """Least part of the visible model that the lamp lights, the robot's shadow considered."""
    max_robot_shadow: Fraction = 0.02
    """Greatest part of the visible model that the robot keeps the lamp from."""
    order: Literal["trajectory", "least_motion"] = "trajectory"
    """Take the shots as the trajectory has them, or in the order that takes least time to move."""
    every_n: Annotated[int, Field(ge=1, le=100_000)] = 1
    """Plan only every so many poses of the trajectory, the first one included; shots keep the
    numbers they have in the whole of it."""
    on_refused: Literal["stop", "skip"] = "stop"
    """What a run does about shots that the plan refuses: do not begin, or leave them out."""

    @model_validator(mode="after")
    def _range_is_ordered(self) -> "PlanConfig":
        if self.range_los_m[0] >= self.range_los_m[1]:
            raise ValueError("range_los_m: the first value must be below the second")
        return self


class ScoreConfig(Model):
    """How the dataset is scored by ``tronlab demo``."""

    cores: Annotated[tuple[str, ...], Field(min_length=1)] = (
        "akaze",
        "brisk",
        "akaze-refined",
        "brisk-refined",
    )
    """Navigation cores, named as ``tronlab score --core`` takes them."""


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
    plan: PlanConfig = PlanConfig()
    """What is checked before anything moves."""
    gate: GateConfig = GateConfig()
    """When a shot is good enough."""
    retry: RetryConfig = RetryConfig()
    """How often a shot is tried again."""
    suspend: SuspendConfig = SuspendConfig()
    """When the run waits, and goes on by itself."""
    recording: RecordingConfig = RecordingConfig()
    """How the dataset is written."""
    notify: NotifyConfig | None = None
    """A command that is told how the run goes; null: nobody."""
    score: ScoreConfig = ScoreConfig()
    """How the dataset is scored."""


@dataclass(frozen=True)
class Campaign:
    """A campaign file that was read."""

    config: CampaignConfig
    document: Document
    """The file, and those it extends."""

    @property
    def name(self) -> str:
        """Get the name of the campaign."""
        return self.config.name

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

    def placed(self, error: ConfigError, *section: str) -> ConfigError:
        """Say where in this file a complaint about a key belongs, unless it says so already.

        Args:
            error: With the key as those write it who do not know the file.
            section: Keys above that one, outermost first.
        """
        if error.path is not None or error.key is None:
            return error
        message = str(error).removeprefix(f"{error.key}: ")
        return self.error(message, *section, *error.key.split("."))

    def error(self, message: str, *location: int | str) -> ConfigError:
        """Make an error about a key, with the file and the line it stands in."""
        return self.document.error(message, *location)


def load_campaign(path: Path, *, overridden: AbstractSet[str] = frozenset()) -> Campaign:
    """Read a campaign file.

    Args:
        path: The YAML file.
        overridden: Those of ``rig`` and ``calibration`` that the caller brings himself, so that
            the files named here need not exist.

    Raises:
        ConfigError: It cannot be read, or says something that cannot be.
    """
    document = read_document(path)
    config = document.read_as(CampaignConfig, overridden=overridden)
    return Campaign(config=config, document=document)
