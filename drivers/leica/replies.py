"""What a tracker answers to questions: everything after the status of a reply."""

from dataclasses import dataclass

from drivers.leica.wire import F64, I32, U32, Text32, Text128, Triple


@dataclass(frozen=True, slots=True)
class Number:
    """The reply of commands that ask for one number."""

    value: I32


@dataclass(frozen=True, slots=True)
class Direction:
    """Where the head points, by its own angles."""

    hz_rad: F64
    vt_rad: F64


@dataclass(frozen=True, slots=True)
class SystemStatus:
    """State of the controller and what is connected to it."""

    last_status: U32
    processor: U32
    laser: U32
    adm: U32
    version_major: I32
    version_minor: I32
    version_build: I32
    weather_monitor: U32
    flags: I32
    serial: I32

    @property
    def version(self) -> str:
        """Get the version of emScon."""
        return f"{self.version_major}.{self.version_minor}.{self.version_build}"


@dataclass(frozen=True, slots=True)
class SystemSettings:
    """Settings, as they are read and as they are set."""

    weather_monitor: U32
    applies_transformation: U32
    applies_station_orientation: U32
    keeps_last_position: U32
    """Whether the head stays where it is when the beam is broken."""
    sends_unsolicited: U32
    sends_reflector_position: U32
    is_try_mode: U32
    has_nivel: U32
    has_video_camera: U32


@dataclass(frozen=True, slots=True)
class TrackerInfo:
    """Which tracker is connected to the controller."""

    sensor_type: U32
    name: Text32
    serial: I32
    compensation_id: I32
    has_adm: U32
    has_overview_camera: U32
    has_nivel: U32
    nivel_offset: F64
    max_distance_m: F64
    min_distance_m: F64
    max_rate: I32
    n_faces: I32
    hz_range_rad: F64
    vt_range_rad: F64
    accuracy_model: U32
    firmware_major: I32
    firmware_minor: I32


@dataclass(frozen=True, slots=True)
class ReflectorType:
    """A kind of reflector in the tracker's list."""

    n_all: I32
    """How many there are: one reply for each."""
    id: I32
    target_type: U32
    surface_offset_m: F64
    name: Text32


@dataclass(frozen=True, slots=True)
class Probe:
    """A probe in the tracker's list."""

    n_all: I32
    id: I32
    serial: I32
    probe_type: U32
    n_fields: I32
    name: Text32
    comment: Text128


@dataclass(frozen=True, slots=True)
class ProbeInfo:
    """The probe that the tracker sees."""

    firmware_major: I32
    firmware_minor: I32
    serial: I32
    probe_type: U32
    compensation_id: I32
    active_field: I32
    connection: U32
    n_tip_adapters: I32
    button_type: U32
    n_fields: I32
    has_wide_angle_receiver: U32
    n_tip_data_sets: I32
    n_melodies: I32
    n_loudness_steps: I32


@dataclass(frozen=True, slots=True)
class MeasurementStatus:
    """What of a measurement is there."""

    last_status: U32
    ready: I32
    """Bits of ``codes.Ready``."""


@dataclass(frozen=True, slots=True)
class Environment:
    """The air the tracker corrects for, in the units set."""

    temperature_c: F64
    pressure_mbar: F64
    humidity_pct: F64


@dataclass(frozen=True, slots=True)
class MeteoStation:
    """The weather station, if there is one."""

    station_type: U32
    identifier: Text32
    firmware_major: I32
    firmware_minor: I32


@dataclass(frozen=True, slots=True)
class BirdbathCheck:
    """The home reflector as it was at initialisation, and how it differs now."""

    initial_hvd: Triple
    """Horizontal and vertical angle, rad, and distance, m."""
    difference_hvd: Triple
