"""The camera as tronlab knows it: configured, triggered by software, or running free."""

import time
from collections.abc import Generator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from drivers.gige.connection import ClockReading, Connection, WireFrame
from drivers.gige.faults import GENICAM_ERRORS, named_errors
from drivers.gige.features import EXPOSURE, FRAME_RATE, GAIN, PACKET_SIZE, Features
from drivers.gige.options import CameraOptions
from drivers.gige.region import read_out
from drivers.gige.stream import BlockIds, StreamCounters
from tronlab.devices.readings import DeviceIdentity, Frame
from tronlab.errors import (
    DeviceTimeoutError,
    IncompleteFrameError,
    LimitError,
    NotConnectedError,
)

_PIXEL_FORMATS = ("Mono8", "Mono12")


@dataclass(frozen=True, slots=True)
class _Settings:
    """How frames are taken, as read from the camera."""

    exposure_s: float
    gain_db: float

    def frame(self, received: WireFrame, *, time_s: float) -> Frame:
        return Frame(
            image=received.image,
            pixel_format="Mono8" if received.image.itemsize == 1 else "Mono12",
            exposure_s=self.exposure_s,
            gain_db=self.gain_db,
            frame_id=received.block_id,
            time_s=time_s,
            device_time_s=received.device_time_s,
        )


class GigeCamera:
    """A GigE Vision camera, or any other that a GenTL producer reaches."""

    def __init__(self, options: CameraOptions, *, name: str, base_dir: Path) -> None:
        self._options = options
        self._name = name
        self._base_dir = base_dir
        self._connection: Connection | None = None
        self._is_armed = False
        self._is_streaming = False
        self._settings = _Settings(exposure_s=0.0, gain_db=0.0)
        self._counters = StreamCounters(0, 0, 0)

    @property
    def name(self) -> str:
        """Get the name errors and logs use."""
        return self._name

    @property
    def counters(self) -> StreamCounters:
        """Get what became of the frames of the latest stream."""
        return self._counters

    def connect(self) -> None:
        """Find the camera, take control of it, and set the region that is read out.

        Everything else that would change an image is set to neutral; exposure and gain stay as
        they are until ``configure``.

        Raises:
            NotConnectedError: No such camera answers; the message lists those that do.
            AccessDeniedError: Another application controls it.
            LimitError: It cannot read out that region, or send packets of that size.
        """
        self.close()
        connection = Connection(self._options, base_dir=self._base_dir, device=self._name)
        try:
            with named_errors(self._name, "connect"):
                self._prepare(connection.features)
        except BaseException:
            connection.close()
            raise
        self._connection = connection

    def close(self) -> None:
        """Give the camera back; it takes no more frames."""
        connection, self._connection = self._connection, None
        self._is_armed = self._is_streaming = False
        if connection is not None:
            connection.close()

    def identify(self) -> DeviceIdentity:
        """Read maker, model, serial number and firmware."""
        connection = self._connected("identify")
        with named_errors(self._name, "identify"):
            text, found = connection.features.text, connection.camera
            return DeviceIdentity(
                maker=text("maker") or found.maker,
                model=text("model") or found.model,
                serial=text("serial number") or found.serial,
                firmware=text("firmware") or found.firmware,
            )

    def diagnose(self) -> Mapping[str, str]:
        """Read where the camera is and how it is set; takes no image."""
        connection = self._connected("diagnose")
        text = connection.features.text
        with named_errors(self._name, "diagnose"):
            settings = self._read_settings(connection.features, call="diagnose")
            left, top = (text(offset) or "0" for offset in ("left column", "top row"))
            facts = {
                "address": connection.camera.address,
                "region": f"{text('width')} x {text('height')} px from column {left}, row {top}",
                "pixel format": text("pixel format"),
                "exposure": f"{settings.exposure_s:g} s",
                "gain": f"{settings.gain_db:g} dB",
                "packet size": text("packet size"),
            }
        return {name: value for name, value in facts.items() if value}

    def configure(self, *, exposure_s: float, gain_db: float, pixel_format: str) -> None:
        """Set how frames are taken: ``Mono8`` or ``Mono12``; nothing changes if it cannot be.

        Raises:
            LimitError: The camera cannot do it; the message says what it can.
        """
        connection = self._idle("configure")
        features = connection.features
        with named_errors(self._name, "configure"):
            if pixel_format not in _PIXEL_FORMATS:
                raise LimitError(
                    f"configure: pixel format is '{pixel_format}', "
                    f"allowed {', '.join(_PIXEL_FORMATS)}",
                    device=self._name,
                )
            wire_format = self._wire_format(pixel_format)
            features.check_choice("pixel format", wire_format, call="configure")
            features.check_number(EXPOSURE, exposure_s, call="configure")
            features.check_number(GAIN, gain_db, call="configure")
            if features.text("pixel format") != wire_format:
                self._disarm(connection)  # buffers are made for one size of image
                features.choose("pixel format", wire_format, call="configure")
            features.set_number(EXPOSURE, exposure_s, call="configure")
            features.set_number(GAIN, gain_db, call="configure")
            self._settings = self._read_settings(features, call="configure")

    def grab(self, *, timeout_s: float) -> Frame:
        """Trigger one exposure and give its frame: exposed wholly after this call began.

        Frames are the trigger's own if the camera's clock says they began to expose after it; of
        a camera whose clock cannot be read, because none from before can be on its way: after a
        frame that did not come the camera is started afresh.

        ``time_s`` of the frame is the host's time half way through the trigger command, plus half
        the exposure.

        Raises:
            IncompleteFrameError: Parts of the frame were lost on the way.
            DeviceTimeoutError: No frame came in time.
        """
        connection = self._idle("grab")
        until_s = time.monotonic() + timeout_s
        with named_errors(self._name, "grab"):
            self._arm(connection)
            self._check_that_exposure_fits(timeout_s)
            self._is_armed = False  # as long as a frame may be on its way
            frame = self._shoot(connection, until_s=until_s, timeout_s=timeout_s)
            self._is_armed = True
            return frame

    def stream(
        self, n_frames: int | None = None, *, rate_hz: float | None = None
    ) -> Generator[Frame]:
        """Let the camera run free, and give its frames until so many came or it is closed.

        Frames with gaps are left out and counted in ``counters``, like those that never came.

        Args:
            n_frames: How many frames; by default without end.
            rate_hz: Frame rate; by default the one the camera is set to.

        Raises:
            LimitError: When the first frame is asked for: the camera cannot do that rate.
            DeviceTimeoutError: When any is: none came in time.
        """
        return self._frames(self._idle("stream"), n_frames, rate_hz)

    def _connected(self, call: str) -> Connection:
        if self._connection is None:
            raise NotConnectedError(
                f"{call}: not connected; call connect() first", device=self._name
            )
        return self._connection

    def _idle(self, call: str) -> Connection:
        connection = self._connected(call)
        if self._is_streaming:
            raise LimitError(
                f"{call}: a stream of this camera is running; close it first", device=self._name
            )
        return connection

    def _prepare(self, features: Features) -> None:
        features.neutralise()
        features.choose("pixel format", self._wire_format("Mono8"), call="connect")
        read_out(self._options.region, features, call="connect")
        if self._options.packet_size_bytes is not None:
            features.set_number(PACKET_SIZE, self._options.packet_size_bytes, call="connect")

    def _wire_format(self, pixel_format: str) -> str:
        is_packed = pixel_format == "Mono12" and self._options.is_packed
        return "Mono12Packed" if is_packed else pixel_format

    def _read_settings(self, features: Features, *, call: str) -> _Settings:
        return _Settings(
            exposure_s=features.number(EXPOSURE, call=call),
            gain_db=features.number(GAIN, call=call),
        )

    def _disarm(self, connection: Connection) -> None:
        self._is_armed = False
        if connection.is_acquiring:
            connection.stop()

    def _arm(self, connection: Connection) -> None:
        """Have the camera wait for a trigger, with no older frame left to be fetched."""
        if self._is_armed:
            while connection.fetch(call="grab") is not None:
                pass
            return
        self._disarm(connection)
        features = connection.features
        _select_frame_trigger(features, call="grab")
        features.choose("trigger source", "Software", call="grab")
        features.choose("trigger mode", "On", call="grab")
        self._settings = self._read_settings(features, call="grab")
        connection.start()
        self._is_armed = True

    def _check_that_exposure_fits(self, timeout_s: float) -> None:
        exposure_s = self._settings.exposure_s
        if exposure_s >= timeout_s:
            raise DeviceTimeoutError(
                f"grab: the exposure takes {exposure_s:g} s, allowed are {timeout_s:g} s in all",
                device=self._name,
            )

    def _shoot(self, connection: Connection, *, until_s: float, timeout_s: float) -> Frame:
        clock = connection.read_clock(call="grab")
        n_incomplete = connection.n_incomplete
        time_s = _timed_trigger(connection.features)
        n_older = 0
        while True:
            received = connection.wait_for_frame(
                until_s=until_s,
                is_given_up=lambda: connection.n_incomplete > n_incomplete,
                call="grab",
            )
            if received is None:
                break
            if clock is None or not clock.is_after(received):
                exposure_s = self._settings.exposure_s
                return self._settings.frame(received, time_s=time_s + exposure_s / 2)
            n_older += 1
        if connection.n_incomplete > n_incomplete:
            raise IncompleteFrameError(
                "grab: parts of the frame were lost on the way; if it happens often, check "
                "packet size, MTU and receive buffers of the network",
                device=self._name,
            )
        older = f"; {n_older} frames from before the trigger came" if n_older else ""
        raise DeviceTimeoutError(
            f"grab: no frame within {timeout_s:g} s of the trigger{older}", device=self._name
        )

    def _run_free(self, connection: Connection, rate_hz: float | None) -> ClockReading | None:
        """Start a stream; give the camera's clock."""
        self._disarm(connection)
        features = connection.features
        if features.has("trigger mode"):
            _select_frame_trigger(features, call="stream")
            features.choose("trigger mode", "Off", call="stream")
        if rate_hz is not None:
            features.enable_frame_rate()
            features.set_number(FRAME_RATE, rate_hz, call="stream")
        self._settings = self._read_settings(features, call="stream")
        clock = connection.read_clock(call="stream")
        connection.start()
        return clock

    def _frames(
        self, connection: Connection, n_frames: int | None, rate_hz: float | None
    ) -> Generator[Frame]:
        self._idle("stream")  # for it may be long ago that the stream was asked for
        self._is_streaming = True
        ids, n_incomplete_before = BlockIds(), connection.n_incomplete
        try:
            with named_errors(self._name, "stream"):
                clock = self._run_free(connection, rate_hz)
            while n_frames is None or ids.n < n_frames:
                received = self._next(connection)
                ids.add(received.block_id)
                n_incomplete = connection.n_incomplete - n_incomplete_before
                self._counters = StreamCounters.of(ids, n_incomplete=n_incomplete)
                time_s = clock.host_time_s(received) if clock else time.time()
                yield self._settings.frame(received, time_s=time_s + self._settings.exposure_s / 2)
        finally:
            if connection is self._connection:  # else there may be a newer stream by now
                self._is_streaming = False
            with suppress(*GENICAM_ERRORS):  # the next call says so if the camera is lost
                connection.stop()

    def _next(self, connection: Connection) -> WireFrame:
        timeout_s = self._options.frame_timeout_s + self._settings.exposure_s
        n_incomplete = connection.n_incomplete
        if connection is not self._connection:
            raise NotConnectedError("stream: the camera was closed meanwhile", device=self._name)
        with named_errors(self._name, "stream"):
            until_s = time.monotonic() + timeout_s
            received = connection.wait_for_frame(until_s=until_s, call="stream")
        if received is None:
            raise DeviceTimeoutError(
                f"stream: no complete frame within {timeout_s:g} s, "
                f"{connection.n_incomplete - n_incomplete} incomplete ones",
                device=self._name,
            )
        return received


def _select_frame_trigger(features: Features, *, call: str) -> None:
    if features.has("trigger selector"):
        features.choose("trigger selector", "FrameStart", call=call)


def _timed_trigger(features: Features) -> float:
    """Give the trigger, and the host's time half way through the command."""
    before_s = time.time()
    features.execute("software trigger", call="grab")
    return (before_s + time.time()) / 2
