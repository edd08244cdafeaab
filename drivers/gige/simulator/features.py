"""The features of a Prosilica GC1380H: names, numbers and limits, and the register each lives in.

Names and enumeration values from the EPICS ADGenICam table of the colour twin GC1380CH and from
Allied Vision's feature reference; not seen on hardware. The numbers of TriggerActivation,
TriggerOverlap, GainAuto, BandwidthControlMode and StreamHoldEnable are assumed. Addresses are our
own: a consumer finds all of this in the description.
"""

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field
from enum import IntEnum
from typing import Final, Literal, TypeAlias

from drivers.gige.simulator.gvsp import MONO8, PIXEL_FORMATS

Access: TypeAlias = Literal["RO", "RW", "WO"]

_EVERY_U32: Final = 0xFFFFFFFF
FULL_BANDWIDTH: Final = 124_000_000
"""Bytes a second that fill Gigabit Ethernet."""


@dataclass(frozen=True)
class Model:
    """What one camera is, and what it can do."""

    vendor: str = "Allied Vision Technologies"
    name: str = "GC1380H (02-2142A)"
    firmware: str = "1.54.04"
    serial: str = "02-2142A-06001"
    sensor_width_px: int = 1360
    sensor_height_px: int = 1024
    exposure_range_us: tuple[int, int] = (10, 60_000_000)
    gain_range_db: tuple[int, int] = (0, 33)
    readout_s: float = 0.0
    """From the end of an exposure until its frame can be sent."""


class AcquisitionMode(IntEnum):
    """How many frames an acquisition takes."""

    CONTINUOUS = 1
    SINGLE_FRAME = 2
    MULTI_FRAME = 3
    RECORDER = 4


class TriggerSource(IntEnum):
    """What starts an exposure while ``TriggerMode`` is On."""

    FREERUN = 0
    LINE1 = 1
    LINE2 = 2
    LINE3 = 3
    LINE4 = 4
    FIXED_RATE = 5
    SOFTWARE = 6


class BandwidthControl(IntEnum):
    """What slows the stream down."""

    BYTES_PER_SECOND = 0
    PACKET_DELAY = 1
    BOTH = 2


@dataclass(frozen=True)
class Feature:
    """What all features have in common."""

    name: str
    category: str
    _: KW_ONLY
    access: Access = "RW"
    initial: int = 0
    """Content of the register when the camera starts."""

    @property
    def address(self) -> int:
        """Get where its register is."""
        return ADDRESSES[self.name]

    def accepts(self, value: int) -> bool:
        """Tell whether the register may be written with a value."""
        return 0 <= value <= _EVERY_U32


@dataclass(frozen=True)
class Integer(Feature):
    """A whole number."""

    low: int = 0
    high: int = _EVERY_U32
    high_formula: str = ""
    """The highest value now, from other features, where that is not always the same."""
    unit: str = ""

    def accepts(self, value: int) -> bool:
        """Tell whether the value is in range."""
        return self.low <= value <= self.high


@dataclass(frozen=True)
class Real(Integer):
    """A real number; its register holds ``per_unit`` times as much, as ``low`` and ``high`` do."""

    per_unit: int = 1


@dataclass(frozen=True)
class Enumeration(Feature):
    """One of several names."""

    entries: Mapping[str, int] = field(default_factory=dict[str, int])
    refused: tuple[str, ...] = ()
    """Entries of the real camera whose effect is not simulated."""

    def accepts(self, value: int) -> bool:
        """Tell whether the value is an entry that is simulated."""
        return value in {v for name, v in self.entries.items() if name not in self.refused}


@dataclass(frozen=True)
class Switch(Feature):
    """On or off."""

    def accepts(self, value: int) -> bool:
        """Tell whether the value is one the simulator can have: only what it starts with."""
        return value == self.initial


@dataclass(frozen=True)
class Action(Feature):
    """A command: its register is only written."""


_SPACE: Final = 0x20000
_AUTO: Final = {"Off": 1, "Continuous": 2, "Once": 3, "Other": 4}
_NOT_OFF: Final = ("Continuous", "Once", "Other")


def features_of(model: Model) -> tuple[Feature, ...]:
    """Give every feature of a camera that lives in a register of its own."""
    return (*_image_format(model), *_acquisition(), *_trigger(), *_analog(model), *_stream())


def _image_format(model: Model) -> tuple[Feature, ...]:
    category = "ImageFormatControl"
    width, height = model.sensor_width_px, model.sensor_height_px

    def fixed(name: str, value: int) -> Integer:
        return Integer(name, category, access="RO", initial=value, high=value)

    def factor(name: str) -> Integer:  # other factors than 1 are not simulated
        return Integer(name, category, initial=1, low=1, high=1)

    return (
        fixed("SensorWidth", width),
        fixed("SensorHeight", height),
        fixed("WidthMax", width),
        fixed("HeightMax", height),
        Integer(
            "Width",
            category,
            initial=width,
            low=1,
            high=width,
            high_formula="WidthMax - OffsetX",
        ),
        Integer(
            "Height",
            category,
            initial=height,
            low=1,
            high=height,
            high_formula="HeightMax - OffsetY",
        ),
        Integer(
            "OffsetX",
            category,
            high=width - 1,
            high_formula="WidthMax - Width",
        ),
        Integer(
            "OffsetY",
            category,
            high=height - 1,
            high_formula="HeightMax - Height",
        ),
        factor("BinningHorizontal"),
        factor("BinningVertical"),
        factor("DecimationHorizontal"),
        factor("DecimationVertical"),
        Enumeration("PixelFormat", category, initial=MONO8, entries=PIXEL_FORMATS),
        Integer("ImageSize", category, access="RO", unit="bytes"),
        Integer("PayloadSize", category, access="RO", unit="bytes"),
    )


def _acquisition() -> tuple[Feature, ...]:
    category = "AcquisitionControl"
    return (
        Enumeration(
            "AcquisitionMode",
            category,
            initial=AcquisitionMode.CONTINUOUS,
            entries={
                "Continuous": AcquisitionMode.CONTINUOUS,
                "SingleFrame": AcquisitionMode.SINGLE_FRAME,
                "MultiFrame": AcquisitionMode.MULTI_FRAME,
                "Recorder": AcquisitionMode.RECORDER,
            },
            refused=("Recorder",),
        ),
        Integer(
            "AcquisitionFrameCount",
            category,
            initial=1,
            low=1,
            high=65535,
        ),
        Action("AcquisitionStart", category, access="WO"),
        Action("AcquisitionStop", category, access="WO"),
        Action("AcquisitionAbort", category, access="WO"),
        Real(
            "AcquisitionFrameRateAbs",
            category,
            initial=20_000,
            low=1,
            high=10_000_000,
            unit="Hz",
            per_unit=1000,
        ),
        Real(
            "AcquisitionFrameRateLimit",
            category,
            access="RO",
            unit="Hz",
            per_unit=1000,
        ),
    )


def _trigger() -> tuple[Feature, ...]:
    category = "TriggerControl"
    return (
        Enumeration(
            "TriggerSelector",
            category,
            entries={
                "FrameStart": 0,
                "AcquisitionStart": 3,
                "AcquisitionEnd": 4,
                "AcquisitionRecord": 6,
            },
            refused=("AcquisitionStart", "AcquisitionEnd", "AcquisitionRecord"),
        ),
        Enumeration("TriggerMode", category, entries={"Off": 0, "On": 1}),
        Enumeration(
            "TriggerSource",
            category,
            entries={
                "Freerun": TriggerSource.FREERUN,
                "Line1": TriggerSource.LINE1,
                "Line2": TriggerSource.LINE2,
                "Line3": TriggerSource.LINE3,
                "Line4": TriggerSource.LINE4,
                "FixedRate": TriggerSource.FIXED_RATE,
                "Software": TriggerSource.SOFTWARE,
            },
        ),
        Action("TriggerSoftware", category, access="WO"),
        Enumeration(
            "TriggerActivation",
            category,
            entries={
                "RisingEdge": 0,
                "FallingEdge": 1,
                "AnyEdge": 2,
                "LevelHigh": 3,
                "LevelLow": 4,
            },
        ),
        Enumeration(
            "TriggerOverlap",
            category,
            entries={"Off": 0, "PreviousFrame": 1},
        ),
        Real("TriggerDelayAbs", category, high=60_000_000, unit="us"),
    )


def _analog(model: Model) -> tuple[Feature, ...]:
    exposure, analog = "ExposureControl", "GainControl"
    shortest, longest = model.exposure_range_us
    lowest, highest = model.gain_range_db
    return (
        Enumeration("ExposureMode", exposure, initial=1, entries={"Timed": 1}),
        Enumeration(
            "ExposureAuto",
            exposure,
            initial=1,
            entries=_AUTO,
            refused=_NOT_OFF,
        ),
        Real(
            "ExposureTimeAbs",
            exposure,
            initial=min(max(15_000, shortest), longest),
            low=shortest,
            high=longest,
            unit="us",
        ),
        Enumeration("GainAuto", analog, initial=1, entries=_AUTO, refused=_NOT_OFF),
        Integer("GainRaw", analog, initial=lowest, low=lowest, high=highest, unit="dB"),
        Real("BlackLevel", analog, high=0),
        Real("Gamma", analog, initial=1000, low=1000, high=1000, per_unit=1000),
    )


def _stream() -> tuple[Feature, ...]:
    category = "StreamControl"
    return (
        Integer(
            "StreamBytesPerSecond",
            category,
            initial=115_000_000,
            low=1_000_000,
            high=FULL_BANDWIDTH,
            unit="B/s",
        ),
        Enumeration(
            "BandwidthControlMode",
            category,
            entries={
                "StreamBytesPerSecond": BandwidthControl.BYTES_PER_SECOND,
                "SCPD": BandwidthControl.PACKET_DELAY,
                "Both": BandwidthControl.BOTH,
            },
        ),
        Switch("StreamFrameRateConstrain", category, initial=1),
        Enumeration(
            "StreamHoldEnable",
            category,
            entries={"Off": 0, "On": 1},
            refused=("On",),
        ),
    )


ADDRESSES: Final[Mapping[str, int]] = {
    feature.name: _SPACE + 4 * i for i, feature in enumerate(features_of(Model()))
}
"""Address of the register of every feature."""
