"""An open camera: its features, and frames as they come off the wire.

harvesters holds Python's global lock inside the calls of a producer, so nothing here waits in one:
it asks, and sleeps in between.
"""

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from genicam import genapi, gentl
from harvesters.core import Callback, ParameterKey, ParameterSet

from drivers.gige.faults import GENICAM_ERRORS, first_line, named_errors
from drivers.gige.features import Features
from drivers.gige.options import CameraOptions
from drivers.gige.pixels import WIRE_FORMATS, GreyImage
from drivers.gige.producers import FoundCamera, Producer
from tronlab.errors import AccessDeniedError, DeviceError

POLL_S: Final = 0.001
HEARTBEAT_S: Final = 3.5
"""How long a camera stays with an application that fell silent: 3 s unless it is set otherwise."""
_ACCESS_POLL_S: Final = 0.25
_LOOK_ONCE_S: Final = 1e-5
_SFNC_TICK_HZ: Final = 1e9

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class WireFrame:
    """A complete frame as it was received."""

    image: GreyImage
    """A copy, shape (rows, columns)."""
    block_id: int
    """The camera's count of frames since it was told to start."""
    device_time_s: float | None
    """The camera's clock when it began to expose; None if it does not say."""


@dataclass(frozen=True, slots=True)
class ClockReading:
    """The camera's clock beside the host's, at one time."""

    device_s: float
    host_s: float
    """Seconds since 1970 UTC."""

    def is_after(self, frame: WireFrame) -> bool:
        """Return whether it was read after the frame began to expose, as far as is known."""
        return frame.device_time_s is not None and frame.device_time_s < self.device_s

    def host_time_s(self, frame: WireFrame) -> float:
        """Give when the frame began to expose by the host's clock."""
        if frame.device_time_s is None:
            return time.time()
        return self.host_s + frame.device_time_s - self.device_s


class _Counter(Callback):
    """Counts what harvesters drops."""

    def __init__(self) -> None:
        super().__init__()
        self.n = 0

    def emit(self, context: object | None = None) -> None:
        """Count one."""
        self.n += 1


class Connection:
    """A camera this application controls, until it is closed."""

    def __init__(self, options: CameraOptions, *, base_dir: Path, device: str) -> None:
        """Find and open the camera.

        Raises:
            NotConnectedError: There is no such camera, or it cannot be opened.
            AccessDeniedError: Another application controls it.
        """
        self._device = device
        self._acquirer: Any = None
        self._producer = Producer(options, base_dir=base_dir, device=device)
        try:
            self.camera: FoundCamera = self._producer.find()
            self._acquirer = self._open(options.n_buffers)
            self.features = Features(self._acquirer.remote_device.node_map, device=device)
            self._tick_hz = self._read_tick_hz()
        except BaseException:
            self.close()
            raise
        self._incomplete = _Counter()
        self._acquirer.add_callback(self._acquirer.Events.INCOMPLETE_BUFFER, self._incomplete)

    @property
    def n_incomplete(self) -> int:
        """Get how many frames with gaps came since the camera was opened."""
        return self._incomplete.n

    @property
    def is_acquiring(self) -> bool:
        """Get whether frames are received."""
        return bool(self._acquirer.is_acquiring())

    def start(self) -> None:
        """Receive frames from now on: none from before can arrive any more."""
        self._acquirer.start()

    def stop(self) -> None:
        """Receive no more frames."""
        self._acquirer.stop()

    def fetch(self, *, call: str) -> WireFrame | None:
        """Give the next complete frame if it is there already."""
        buffer = self._acquirer.try_fetch(timeout=_LOOK_ONCE_S, is_raw=True)
        if buffer is None:
            return None
        try:
            return self._wire_frame(buffer, call=call)
        finally:
            buffer.parent.queue_buffer(buffer)

    def wait_for_frame(
        self, *, until_s: float, call: str, is_given_up: Callable[[], bool] = lambda: False
    ) -> WireFrame | None:
        """Give the next complete frame; None if there is none in time.

        Args:
            until_s: Until when to wait, by ``time.monotonic``.
            call: What waits, for errors.
            is_given_up: Returns True when waiting has become useless.
        """
        while True:
            is_late = time.monotonic() >= until_s
            frame = self.fetch(call=call)
            if frame is not None or is_late or is_given_up():
                return frame
            time.sleep(POLL_S)

    def read_clock(self, *, call: str) -> ClockReading | None:
        """Read the camera's clock; None if it has none that can be read."""
        features = self.features
        if not (features.has("clock latch") and features.has("latched clock")):
            return None
        before_s = time.time()
        features.execute("clock latch", call=call)
        host_s = (before_s + time.time()) / 2
        ticks = features.integer("latched clock", call=call)
        return ClockReading(device_s=ticks / self._tick_hz, host_s=host_s)

    def close(self) -> None:
        """Let go of the camera, whether it still answers or not."""
        if self._acquirer is not None:
            for _ in range(2):  # of a camera that is lost the first attempt fails half way
                with suppress(*GENICAM_ERRORS):
                    self._acquirer.destroy()
                    break
        self._producer.close()

    def _open(self, n_buffers: int) -> Any:
        config = ParameterSet(
            {
                ParameterKey.DEVICE_OWNERSHIP_PRIVILEGE: "exclusive",
                ParameterKey.NUM_BUFFERS_FOR_FETCH_CALL: n_buffers,
                ParameterKey.TIMEOUT_PERIOD_ON_UPDATE_EVENT_DATA_CALL: 0,
                ParameterKey.ENABLE_AUTO_CHUNK_DATA_UPDATE: False,
            }
        )
        harvester, index = self._producer.harvester, self.camera.index
        with named_errors(self._device, "connect"):
            try:
                return _outside_main_thread(
                    lambda: _when_free(lambda: harvester.create(index, config=config))
                )
            except gentl.AccessDeniedException as error:
                raise AccessDeniedError(
                    f"connect: another application controls the camera {self.camera}; "
                    "close it there",
                    device=self._device,
                ) from error
            except genapi.GenericException as error:
                raise DeviceError(
                    "connect: the camera's description of itself (GenICam XML) cannot be used: "
                    f"{first_line(error)}",
                    device=self._device,
                ) from error

    def _read_tick_hz(self) -> float:
        with suppress(*GENICAM_ERRORS):
            return float(self._acquirer.device.timestamp_frequency)
        with named_errors(self._device, "connect"):
            if self.features.has("clock frequency"):
                return float(self.features.integer("clock frequency", call="connect"))
        return _SFNC_TICK_HZ

    def _wire_frame(self, buffer: Any, *, call: str) -> WireFrame:
        number = int(buffer.pixel_format)
        if number not in WIRE_FORMATS:
            known = ", ".join(f"{wire.name} {key:#010x}" for key, wire in WIRE_FORMATS.items())
            raise DeviceError(
                f"{call}: the camera sends pixel format {number:#010x}, expected one of {known}",
                device=self._device,
            )
        wire, shape = WIRE_FORMATS[number], (int(buffer.height), int(buffer.width))
        raw = np.frombuffer(buffer.raw_buffer, np.uint8, count=wire.n_bytes(shape[0] * shape[1]))
        return WireFrame(
            image=wire.decode(raw).reshape(shape),
            block_id=int(buffer.frame_id),
            device_time_s=self._device_time_s(buffer),
        )

    def _device_time_s(self, buffer: Any) -> float | None:
        with suppress(*GENICAM_ERRORS):
            return int(buffer.timestamp) / self._tick_hz
        return None


def _when_free(open_camera: Callable[[], T]) -> T:
    """Open a camera that may still be held by an application that is gone, perhaps this one."""
    until_s = time.monotonic() + HEARTBEAT_S
    while time.monotonic() < until_s:
        with suppress(gentl.AccessDeniedException):
            return open_camera()
        time.sleep(_ACCESS_POLL_S)
    return open_camera()


def _outside_main_thread(make: Callable[[], T]) -> T:
    """Call in another thread: in the main thread harvesters takes Ctrl-C for itself."""
    with ThreadPoolExecutor(max_workers=1) as pool:
        return pool.submit(make).result()
