"""What the camera's registers mean: which values they take, and what follows from them."""

import math
from dataclasses import dataclass, replace
from ipaddress import IPv4Address
from typing import Final

from drivers.gige.simulator import description
from drivers.gige.simulator.bootstrap import (
    DO_NOT_FRAGMENT,
    LARGEST_PACKET,
    SHORTEST_HEARTBEAT_MS,
    SMALLEST_PACKET,
    TICK_HZ,
    Bootstrap,
    Content,
    bootstrap,
)
from drivers.gige.simulator.features import (
    ADDRESSES,
    AcquisitionMode,
    BandwidthControl,
    Feature,
    Model,
    TriggerSource,
    features_of,
)
from drivers.gige.simulator.gvcp import RefusedError, Status
from drivers.gige.simulator.gvsp import PIXEL_FORMATS, payload_bytes
from drivers.gige.simulator.memory import Memory
from drivers.gige.simulator.scene import Region

_US_PER_S: Final = 1_000_000
_PORT_BITS: Final = 0xFFFF
_PACKET_SIZE_BITS: Final = 0xFFFF
_REGION: Final = {
    "left_px": ADDRESSES["OffsetX"],
    "top_px": ADDRESSES["OffsetY"],
    "width_px": ADDRESSES["Width"],
    "height_px": ADDRESSES["Height"],
}
_LOCKED: Final = frozenset(
    ADDRESSES[name] for name in ("Width", "Height", "PixelFormat", "AcquisitionMode")
)
"""Registers that keep their value while frames are taken."""


@dataclass(frozen=True, slots=True)
class Settings:
    """How frames are taken, at one instant."""

    region: Region
    pixel_format: int
    exposure_s: float
    gain_db: float
    n_frames: int | None
    """Frames in one acquisition; None: until it is stopped."""
    waits_for_trigger: bool
    """Whether each exposure waits for a trigger."""
    heeds_software: bool
    """Whether that is the software trigger, not one of the lines, to which nothing is wired."""
    period_s: float
    """Time from one exposure to the next where none waits; 0: as short as possible."""
    trigger_delay_s: float
    keeps_early_trigger: bool
    """Whether a trigger during an exposure starts the next one, instead of being ignored."""

    @property
    def scene_format(self) -> str:
        """Get the name of the pixel format, however densely it is packed."""
        return "Mono8" if self.pixel_format == PIXEL_FORMATS["Mono8"] else "Mono12"


@dataclass(frozen=True, slots=True)
class Route:
    """Where the stream goes, and how."""

    host: str
    port: int
    packet_bytes: int
    may_fragment: bool
    bytes_per_second: float
    packet_delay_s: float


class Registers:
    """The camera's memory, with the rules of what may be written to it."""

    def __init__(
        self, model: Model, *, host: str, source_port: int, is_unthrottled: bool = False
    ) -> None:
        features = features_of(model)
        archive = description.zipped(description.describe(features))
        self._model = model
        self._is_unthrottled = is_unthrottled
        self._features: dict[int, Feature] = {feature.address: feature for feature in features}
        self._contents = (
            *bootstrap(model, host=host, source_port=source_port, url=description.url(archive)),
            *(Content(f.address, f.initial.to_bytes(4), f.access) for f in features),
            Content(description.ADDRESS, archive),
        )
        self.restart()

    def restart(self) -> None:
        """Forget everything that was written, as without power."""
        self.memory = Memory(self._contents)
        self._compute()

    def feature(self, name: str) -> int:
        """Get the register of a feature."""
        return self.memory.word(ADDRESSES[name])

    def write(self, address: int, value: int, *, is_acquiring: bool) -> None:
        """Write a word, if it may be.

        Raises:
            RefusedError: It may not; nothing has changed.
        """
        self.memory.require_writable(address)
        if is_acquiring and address in _LOCKED:
            raise RefusedError(Status.ACCESS_DENIED)
        if not self._accepts(address, value):
            raise RefusedError(Status.INVALID_PARAMETER)
        self.memory.set_word(address, value)
        self._compute()

    def settings(self) -> Settings:
        """Get how frames are taken now."""
        mode, source = self.feature("AcquisitionMode"), self.feature("TriggerSource")
        counts = {
            AcquisitionMode.SINGLE_FRAME: 1,
            AcquisitionMode.MULTI_FRAME: self.feature("AcquisitionFrameCount"),
        }
        is_triggered = self.feature("TriggerMode") == 1
        is_timed = source in {TriggerSource.FREERUN, TriggerSource.FIXED_RATE}
        is_freerun = is_triggered and source == TriggerSource.FREERUN
        return Settings(
            region=self.region,
            pixel_format=self.feature("PixelFormat"),
            exposure_s=self.feature("ExposureTimeAbs") / _US_PER_S,
            gain_db=float(self.feature("GainRaw")),
            n_frames=counts.get(AcquisitionMode(mode)),
            waits_for_trigger=is_triggered and not is_timed,
            heeds_software=is_triggered and source == TriggerSource.SOFTWARE,
            period_s=0.0 if is_freerun else 1000 / self.feature("AcquisitionFrameRateAbs"),
            trigger_delay_s=self.feature("TriggerDelayAbs") / _US_PER_S,
            keeps_early_trigger=self.feature("TriggerOverlap") == 1,
        )

    @property
    def region(self) -> Region:
        """Get the part of the sensor that is read out."""
        return Region(
            left_px=self.feature("OffsetX"),
            top_px=self.feature("OffsetY"),
            width_px=self.feature("Width"),
            height_px=self.feature("Height"),
        )

    def route(self) -> Route | None:
        """Get where the stream goes now; None while it is closed."""
        port = self.memory.word(Bootstrap.STREAM_PORT) & _PORT_BITS
        host = self.memory.word(Bootstrap.STREAM_ADDRESS)
        if port == 0 or host == 0:
            return None
        size = self.memory.word(Bootstrap.PACKET_SIZE)
        rate, delay_s = self._pace()
        return Route(
            host=str(IPv4Address(host)),
            port=port,
            packet_bytes=size & _PACKET_SIZE_BITS,
            may_fragment=not size & DO_NOT_FRAGMENT,
            bytes_per_second=rate,
            packet_delay_s=delay_s,
        )

    def _pace(self) -> tuple[float, float]:
        """Give the bytes a second and the pause after each packet."""
        if self._is_unthrottled:
            return math.inf, 0.0
        mode = self.feature("BandwidthControlMode")
        rate, delay_s = math.inf, 0.0
        if mode != BandwidthControl.PACKET_DELAY:
            rate = float(self.feature("StreamBytesPerSecond"))
        if mode != BandwidthControl.BYTES_PER_SECOND:
            delay_s = self.memory.word(Bootstrap.PACKET_DELAY) / TICK_HZ
        return rate, delay_s

    def _accepts(self, address: int, value: int) -> bool:
        if address in self._features:
            return self._features[address].accepts(value) and self._fits_sensor(address, value)
        if address == Bootstrap.HEARTBEAT_MS:
            return value >= SHORTEST_HEARTBEAT_MS
        if address == Bootstrap.PACKET_SIZE:
            size = value & _PACKET_SIZE_BITS
            return SMALLEST_PACKET <= size <= LARGEST_PACKET and size % 4 == 0
        return True

    def _fits_sensor(self, address: int, value: int) -> bool:
        """Tell whether the region lies on the sensor if that register is written."""
        changed = {key: value for key, at in _REGION.items() if at == address}
        region = replace(self.region, **changed)
        return (
            region.left_px + region.width_px <= self._model.sensor_width_px
            and region.top_px + region.height_px <= self._model.sensor_height_px
        )

    def _compute(self) -> None:
        """Set the registers that follow from others."""
        n_bytes = payload_bytes(
            self.feature("Width"), self.feature("Height"), self.feature("PixelFormat")
        )
        for name in ("ImageSize", "PayloadSize"):
            self.memory.set_word(ADDRESSES[name], n_bytes)
        shortest_s = max(
            self.feature("ExposureTimeAbs") / _US_PER_S,
            self._model.readout_s,
            n_bytes / self._pace()[0],
        )
        self.memory.set_word(ADDRESSES["AcquisitionFrameRateLimit"], round(1000 / shortest_s))
