"""The simulated laboratory as a rig file describes it: section ``world``.

Everything here is how the laboratory really is, and how well its devices do; the pipeline knows
the ``laboratory`` section and what it measures, never this. Places, mountings and the lens are
drawn once from ``seed``, when the laboratory is built; the noise of single moves, measurements and
images is drawn from the seed of the run. A sigma is one standard deviation.
"""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from tronlab.devices.accuracy import StatedAccuracy
from tronlab.devices.laboratory import Positive, Vector
from tronlab.render.photometry import LunarLambert, PhotometryField
from tronlab.render.settings import RaysPerPixel, RenderedImages
from tronlab.terrain.config import TerrainConfig
from tronlab.yaml_models import Model

NotNegative = Annotated[float, Field(ge=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Five = tuple[float, float, float, float, float]

ErrorKind = Literal[
    "tracking_lost",
    "timeout",
    "lost",
    "fault",
    "not_ready",
    "unsafe",
    "incomplete_frame",
    "moved",
    "door_open",
    "dimmed",
]

CALLS: dict[str, tuple[str, ...]] = {
    "robot": ("connect", "identify", "check", "move", "read", "stop"),
    "tracker": ("connect", "identify", "identify_target", "measure_point", "measure_pose"),
    "camera": ("connect", "identify", "configure", "grab"),
    "room": ("connect", "identify", "read", "switch_lamp"),
    "operator": ("connect", "identify", "perform"),
}
"""What a scripted fault can interrupt."""


class Deviation(Model):
    """How far something stands from where it should: three normal draws each."""

    sigma_m: NotNegative
    """Of each coordinate."""
    sigma_deg: NotNegative
    """Of each component of the rotation vector."""


class SurfaceConfig(RenderedImages):
    """The surface of the terrain model, and how images of it are made."""

    photometry: PhotometryField = LunarLambert()
    """Real surfaces are not the Lambert reflector that database images are rendered with."""
    albedo: Fraction = 0.35
    stray_radiance_w_per_m2_sr: NotNegative = 0.0005
    """Added everywhere while the lamp burns: black cloth round the model, light in shadows."""
    rays_per_pixel: RaysPerPixel = 4


class TrueLampConfig(Model):
    """The lamp."""

    intensity_w_per_sr: Positive = 48.0
    """Radiant intensity in the camera's band."""
    placement_sigma_m: NotNegative = 0.02
    """How far the light stands from the nominal place; one sigma a coordinate."""
    housing_offset_m: NotNegative = 0.01
    """From the light's centre to the reflector on its housing, which is what can be measured."""
    radius_m: Annotated[float, Field(ge=0, le=0.5)] | None = None
    """Of the luminous sphere; null: as ``laboratory.lamp.radius_m`` has it."""


class RobotConfig(Model):
    """Rail and arm."""

    repeatability_sigma_m: NotNegative = 1e-4
    """Of each coordinate of the flange, new at every move (KR 16: 0.1 mm)."""
    repeatability_sigma_rad: NotNegative = 1e-4
    """Of each component of the flange's rotation vector: 0.1 mm over an arm of 1 m."""
    rail_repeatability_sigma_m: NotNegative = 2e-5
    rail_backlash_m: NotNegative = 2e-4
    """How much too high the rail stands after it moved towards lower values."""
    arm_speed_m_per_s: Positive = 0.25
    rail_speed_m_per_s: Positive = 0.5
    rail_deviation: Deviation = Deviation(sigma_m=0.003, sigma_deg=0.1)
    """True place of the rail against the nominal one."""
    rail_axis_sigma_deg: NotNegative = 0.05
    """Of the two angles by which the way of the rail differs from the x-axis of the base."""
    rail_scale_sigma: NotNegative = 1e-4
    """Of the rail's encoder, relative."""


class MountingConfig(Model):
    """The payload plate: true mounting against the nominal one."""

    camera_deviation: Deviation = Deviation(sigma_m=0.003, sigma_deg=0.3)
    tmac_deviation: Deviation = Deviation(sigma_m=0.003, sigma_deg=0.3)


class TrackerConfig(StatedAccuracy):
    """The laser tracker: its errors are those of its stated accuracy, however long the window."""

    distance_range_m: tuple[Positive, Positive] = (3.0, 6.0)
    """The tracker stands at a distance from the model's centre drawn from this range."""
    reflector_deviation_m: NotNegative = 0.001
    """Reflectors stand up to this far from nominal, along each axis the frame leaves free."""
    survey_sigma_m: NotNegative = 5e-6
    """Instead of this, if more than three reflectors make nominal places count: how far each
    coordinate lies from what a survey found."""

    @model_validator(mode="after")
    def _range_is_ordered(self) -> "TrackerConfig":
        if self.distance_range_m[0] > self.distance_range_m[1]:
            raise ValueError("distance_range_m: the first value must not exceed the second")
        return self


class LensConfig(Model):
    """The lens as built; the nominal one of ``laboratory.camera`` has no distortion."""

    focal_length_m: Positive = 0.00495
    """At the laboratory's focus; a lens engraved 4.8 mm is rarely 4.80 mm."""
    focal_length_sigma: NotNegative = 0.002
    """Relative, one sigma."""
    aspect_sigma: NotNegative = 1e-4
    """fy / fx differs from 1 by this; one sigma."""
    principal_point_sigma_px: NotNegative = 8.0
    """Of each coordinate, from the centre of the sensor."""
    distortion: Five = (-0.10, 0.09, 4e-4, -3e-4, 0.0)
    """k1, k2, p1, p2, k3 of this type of lens."""
    distortion_sigma: Five = (0.005, 0.005, 2e-4, 2e-4, 0.0)
    psf_sigma_px: NotNegative = 0.6
    """Blur of the lens and of charge that spreads: a Gaussian on top of the pixel's own area."""


class SensorConfig(Model):
    """The sensor and its read-out."""

    electrons_per_radiance: Positive = 5.0e6
    """Electrons a pixel collects in 1 s from a radiance of 1 W/(m2 sr): its area (6.45 um squared),
    the solid angle of the lens at f/2.8, transmission, quantum efficiency, photon energy."""
    full_well_e: Positive = 16000.0
    """Electrons that fill a pixel; at a gain of 0 dB they are the highest grey value."""
    read_noise_e: NotNegative = 10.0
    """One sigma."""
    exposure_range_s: tuple[Positive, Positive] = (1e-5, 60.0)
    gain_range_db: tuple[float, float] = (0.0, 33.0)
    readout_s: NotNegative = 0.05
    """From the end of the exposure to the frame."""

    @model_validator(mode="after")
    def _ranges_are_ordered(self) -> "SensorConfig":
        for name in ("exposure_range_s", "gain_range_db"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"{name}: the first value must not exceed the second")
        return self


class BoardConfig(Model):
    """The calibration board."""

    white_albedo: Fraction = 0.6
    black_albedo: Fraction = 0.03
    bow_sigma_m: NotNegative = 2e-4
    """Of each term by which the board departs from a plane: sag along x, sag along y, twist."""
    placement: Deviation = Deviation(sigma_m=0.005, sigma_deg=0.5)
    """A person puts it there by eye, anew each time (drawn from the seed of the run)."""


class RoomConfig(Model):
    """Air and door."""

    air_temperature_k: Positive = 293.15
    air_pressure_pa: Positive = 101325.0
    relative_humidity: Fraction = 0.45
    is_door_closed: bool = True


class FaultSpec(Model):
    """A fault that strikes the n-th call of a device's method; the call does nothing then.

    What happens to the laboratory lets the call go on: the tracker was ``moved``, the door stands
    open (``door_open``), the lamp is ``dimmed``. Door and lamp are as before after ``times`` calls.
    """

    device: Literal["robot", "tracker", "camera", "room", "operator"]
    call: str
    """Name of the device's method."""
    at: Annotated[int, Field(ge=1)]
    """The first call it strikes, counted from 1 over the life of the devices."""
    times: Annotated[int, Field(ge=1)] = 1
    """How many calls in a row it strikes."""
    error: ErrorKind
    moved_m: Vector = (0.0, 0.0, 0.0)
    """For ``moved``: how far, in trs; anew at every call it strikes."""
    lamp_level: Annotated[float, Field(ge=0, lt=1)] | None = None
    """For ``dimmed``: part of the lamp's full light that is left."""

    @model_validator(mode="after")
    def _device_has_the_call(self) -> "FaultSpec":
        if self.call not in CALLS[self.device]:
            allowed = ", ".join(CALLS[self.device])
            raise ValueError(f"call: {self.device} has no '{self.call}'; it has: {allowed}")
        if self.error == "tracking_lost" and not self.call.startswith("measure_"):
            raise ValueError("error: tracking_lost strikes measure_point and measure_pose only")
        if self.error == "moved" and self.device != "tracker":
            raise ValueError("error: only the tracker can be moved")
        if self.error == "incomplete_frame" and self.call != "grab":
            raise ValueError("error: incomplete_frame strikes grab only")
        if (self.error == "moved") != any(self.moved_m):
            raise ValueError("moved_m: says how far for error: moved, and for no other")
        if (self.error == "dimmed") != (self.lamp_level is not None):
            raise ValueError("lamp_level: says how much for error: dimmed, and for no other")
        return self


class WorldConfig(Model):
    """The simulated laboratory: what is true, and how well it can be measured."""

    seed: Annotated[int, Field(ge=0)]
    """Seed of everything that is unknown but fixed: mountings, lens, places. Another seed is
    another laboratory, whose devices have other serial numbers."""
    start_time_s: float = 1767225600.0
    """Simulated time at the start, seconds since 1970 UTC (2026-01-01). Moves, measuring windows
    and exposures let it pass; nobody waits for them."""
    terrain: TerrainConfig | None = None
    """The terrain as it really is, where that differs from the ``terrain`` that the laboratory
    knows, which may be a scan of it; null: they are the same."""
    surface: SurfaceConfig = SurfaceConfig()
    lamp: TrueLampConfig = TrueLampConfig()
    robot: RobotConfig = RobotConfig()
    mounting: MountingConfig = MountingConfig()
    tracker: TrackerConfig = TrackerConfig()
    lens: LensConfig = LensConfig()
    sensor: SensorConfig = SensorConfig()
    board: BoardConfig = BoardConfig()
    room: RoomConfig = RoomConfig()
    faults: tuple[FaultSpec, ...] = ()
    """Scripted faults, to see what a campaign does about them."""
