"""The laser tracker of a rig: a Leica AT901 or kin, with T-MAC, through its emScon controller."""

import threading
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Final

from drivers.leica.aim import Aim
from drivers.leica.beam import Beam
from drivers.leica.checks import BirdbathDrift, TrackerState, TwoFaceCheck
from drivers.leica.codes import Event, Mode
from drivers.leica.connection import Connection
from drivers.leica.controller import Controller
from drivers.leica.interpreter import Interpreter
from drivers.leica.limits import check_stream, check_window
from drivers.leica.notices import Notice
from drivers.leica.options import TrackerOptions
from drivers.leica.readings import StreamedPoseReading
from drivers.leica.replies import ReflectorType
from tronlab.devices.readings import AirReading, DeviceIdentity, PointReading, PoseReading
from tronlab.devices.registry import DeviceContext
from tronlab.errors import (
    DeviceError,
    DeviceFaultError,
    LimitError,
    TrackingLostError,
)

MAKER: Final = "Leica"
_N_NOTICES: Final = 1000


def open_tracker(context: DeviceContext) -> "LeicaTracker":
    """Make the tracker of a rig, not yet connected.

    Raises:
        ConfigError: The options do not fit ``TrackerOptions``.
    """
    return LeicaTracker(context.name, context.parse_options(TrackerOptions))


class LeicaTracker:
    """A laser tracker whose beam follows a T-MAC, and measures reflectors in between.

    Once the T-MAC was found the beam is given back to it after everything else, so that it follows
    the robot to wherever that goes next. Any method may be called from any thread; one waits for
    the other, but ``stop`` and ``close`` end a measurement that another thread waits for.

    Args:
        name: The device's name in the rig file.
        options: Its options there.
        on_notice: Is told every event and every error that answers no command, when it is read; it
            must not call the tracker.
    """

    def __init__(
        self,
        name: str,
        options: TrackerOptions,
        *,
        on_notice: Callable[[Notice], None] = lambda notice: None,
    ) -> None:
        self._name = name
        self._options = options
        self._tell = on_notice
        self._connection = Connection(
            device=name, timeout_s=options.timeout_s, on_notice=self._take_notice
        )
        self._controller = Controller(self._connection, options, device=name)
        self._beam = Beam(self._controller, options, device=name)
        self._aim = Aim(self._controller, self._beam, options, device=name)
        self._interpreter = Interpreter(self._connection, options.accuracy, device=name)
        self._lock = threading.Lock()
        self._notices: deque[Notice] = deque(maxlen=_N_NOTICES)
        self._is_streaming = False

    @property
    def name(self) -> str:
        """Get the name errors and logs use."""
        return self._name

    # --- Connection and state ---

    def connect(self) -> None:
        """Open the connection and set units, coordinates, statistics and air; nothing moves.

        Raises:
            AccessDeniedError: Another client holds the tracker.
            NotReadyError: It warms up or boots.
            LimitError: Its list has not the reflectors of the options.
        """
        with self._lock:
            self._connection.call = "connect"
            self._connection.open(self._options.host, self._options.port)
            self._beam.reset()
            self._aim.reset()
            self._is_streaming = False
            try:
                self._controller.set_up()
            except BaseException:
                self._connection.close()
                raise

    def close(self) -> None:
        """Close the connection; a measurement that another thread waits for ends first."""
        self._connection.interrupt()
        with self._lock:
            self._connection.close()

    def identify(self) -> DeviceIdentity:
        """Read model, serial number and firmware of tracker and controller."""
        with self._calling("identify"):
            info = self._controller.tracker_info()
            version = self._controller.system_status().version
        return DeviceIdentity(
            maker=MAKER,
            model=info.name or f"sensor type {info.sensor_type}",
            serial=str(info.serial),
            firmware=f"{info.firmware_major}.{info.firmware_minor} (emScon {version})",
        )

    def status(self) -> TrackerState:
        """Read how the tracker is."""
        with self._calling("status"):
            return TrackerState(
                system=self._controller.system_status(),
                tracker=self._controller.tracker_status(),
                face=self._controller.face(),
                ready=self._controller.ready(),
            )

    def diagnose(self) -> Mapping[str, str]:
        """Read how the tracker is, and the air it corrects for; nothing moves."""
        air = self.weather()
        return {
            **self.status().in_words(),
            "air": f"{air.temperature_k - 273.15:.2f} degC, {air.pressure_pa / 100:.1f} hPa,"
            f" {100 * air.relative_humidity:.0f} % RH",
        }

    def initialize(self) -> None:
        """Initialise the tracker, which takes up to 1.5 minutes; its head moves."""
        with self._calling("initialize"):
            self._aim.reset()
            self._beam.initialise()

    def stop(self) -> None:
        """Stop whatever is being measured, also by another thread.

        The head stays; only a two-face check still turns it back to the first face.
        """
        self._connection.interrupt()
        with self._calling("stop", is_allowed_in_stream=True):
            if not self._is_streaming:  # the iterator of a stream has yet to see it
                self._connection.resume()
            self._beam.stop()

    def notices(self) -> tuple[Notice, ...]:
        """Take what the tracker has said unasked since the last time, the oldest first."""
        with self._calling("notices", is_allowed_in_stream=True):
            self._connection.drain()
            taken = tuple(self._notices)
            self._notices.clear()
        return taken

    def weather(self) -> AirReading:
        """Read the air that distances are corrected for."""
        with self._calling("weather"):
            return self._controller.air()

    def set_environment(self, air: AirReading) -> None:
        """Set the air, where no weather station measures it.

        Raises:
            LimitError: The tracker measures the air itself, and would overwrite this.
        """
        with self._calling("set_environment"):
            if self._options.air is None:
                raise LimitError(
                    "set_environment: the tracker's own weather station measures the air; give"
                    " options.air to set it by hand",
                    device=self._name,
                )
            self._controller.set_environment(air)

    # --- Reflectors ---

    def reflectors(self) -> tuple[ReflectorType, ...]:
        """Give the tracker's list of kinds of reflectors."""
        with self._calling("reflectors"):
            return self._controller.reflector_types

    def select_reflector(self, type_name: str) -> None:
        """Select a kind of reflector by its name in the tracker's list.

        Raises:
            LimitError: There is none of that name.
            DeviceFaultError: The tracker keeps another one.
        """
        with self._calling("select_reflector"):
            self._controller.select_reflector(type_name)

    def measure_point(self, target: str, *, window_s: float) -> PointReading:
        """Point at the named reflector and measure it, averaging over ``window_s``.

        Raises:
            LimitError: No such reflector, a window that is not allowed, or what was measured lies
                too far from where the reflector should be.
            TrackingLostError: The beam does not reach it.
        """
        with self._calling("measure_point"):
            self._aim.check_known(target)
            check_window(window_s, self._connection.call, device=self._name)
            with self._away_from_tmac():
                self._aim.at_reflector(target)
                reading = self._measure_reflector(target, window_s)
        return reading

    def two_face_check(self, target: str, *, window_s: float = 2.0) -> TwoFaceCheck:
        """Measure the named reflector in both faces; the first face is taken again afterwards.

        Raises:
            DeviceError: As ``measure_point``; or the head does not turn over.
        """
        with self._calling("two_face_check"):
            self._aim.check_known(target)
            check_window(window_s, self._connection.call, device=self._name)
            with self._away_from_tmac():
                self._aim.at_reflector(target)
                readings = [self._measure_face(target, window_s)]
                self._beam.change_face()
                try:
                    self._aim.find_reflector(target)
                    readings.append(self._measure_face(target, window_s))
                finally:
                    if self._connection.is_open:
                        self._beam.change_face()
        by_face = dict(readings)
        if by_face.keys() != {1, 2}:
            raise DeviceFaultError(
                f"two_face_check: the head did not turn over, measured in faces {list(by_face)}",
                device=self._name,
                code=readings[0][0],
            )
        return TwoFaceCheck(target, face_1=by_face[1], face_2=by_face[2])

    def drift_check(self) -> BirdbathDrift:
        """Measure how far the home reflector has drifted since the tracker was initialised."""
        with self._calling("drift_check"):
            self._beam.ensure_initialised()
            self._aim.reset()
            with self._away_from_tmac():
                self._controller.set_mode(Mode.POINT)
                drift = BirdbathDrift.of(self._beam.check_birdbath())
        return drift

    # --- T-MAC ---

    def identify_target(self) -> DeviceIdentity:
        """Read which T-MAC the tracker sees; the beam is pointed at it if need be."""
        with self._calling("identify_target"):
            self._aim.at_tmac()
            info = self._controller.probe_info()
            names = {probe.serial: probe.name for probe in self._controller.probes()}
        return DeviceIdentity(
            maker=MAKER,
            model=names.get(info.serial, "T-MAC"),
            serial=str(info.serial),
            firmware=f"{info.firmware_major}.{info.firmware_minor}",
        )

    def follow_target(self) -> None:
        """Point at the T-MAC, where it was lost, where it was last or at home, and follow it.

        Measurements of the T-MAC do so by themselves, also after a broken beam.

        Raises:
            TrackingLostError: It is in none of these places.
        """
        with self._calling("follow_target"):
            self._aim.at_tmac()

    def measure_pose(self, *, window_s: float) -> PoseReading:
        """Measure the T-MAC, averaging over ``window_s``; it must stand still meanwhile.

        Raises:
            LimitError: A window that is not allowed.
            TrackingLostError: The beam does not reach it, or its rotation is not determined.
        """
        with self._calling("measure_pose"):
            check_window(window_s, self._connection.call, device=self._name)
            self._aim.at_tmac()
            measured = self._beam.measure(window_s=window_s, fatal_events=(Event.POSE_INVALID,))
            reading = self._interpreter.pose(measured)
            self._aim.tmac_is_at(reading.trk_from_tmac.translation)
        return reading

    def stream_poses(self, *, interval_s: float, n: int = 0) -> Iterator[StreamedPoseReading]:
        """Measure the T-MAC again and again while it moves.

        Args:
            interval_s: Time between two poses, a whole number of milliseconds.
            n: How many; 0 for as many as are asked for. Closing the iterator ends the stream.

        Raises:
            LimitError: An interval or a number that is not allowed.
            TrackingLostError: While iterating: the beam broke, or a rotation is not determined.
        """
        check_stream(interval_s, n, "stream_poses", device=self._name)
        return self._stream(interval_s, n)

    def _stream(self, interval_s: float, n: int) -> Generator[StreamedPoseReading]:
        with self._calling("stream_poses"):
            self._aim.at_tmac()
            self._beam.start_stream(interval_s=interval_s, n=n)
            self._is_streaming = True
        try:
            n_got = 0
            while n == 0 or n_got < n:
                for reading in self._next_of_stream(interval_s):
                    n_got += 1
                    yield reading
        finally:
            self._end_stream()

    def _next_of_stream(self, interval_s: float) -> list[StreamedPoseReading]:
        with self._calling("stream_poses", is_allowed_in_stream=True):
            packet = self._beam.next_of_stream(timeout_s=interval_s + self._options.timeout_s)
            readings = self._interpreter.poses(packet)
        for reading in readings:
            self._aim.tmac_is_at(reading.trk_from_tmac.translation)
        return readings

    def _end_stream(self) -> None:
        """Stop the stream; one that ended by itself or with its connection needs no stop."""
        with self._lock:
            self._connection.call = "stream_poses"
            self._connection.resume()
            is_running, self._is_streaming = self._is_streaming, False
            if is_running and self._connection.is_open:
                with suppress(DeviceFaultError):
                    self._beam.stop()

    # --- Calls ---

    @contextmanager
    def _away_from_tmac(self) -> Generator[None]:
        """Give the beam back to the T-MAC afterwards, also when it did not find what it left for.

        The robot may move next: a T-MAC that the beam does not follow would be lost by then.
        """
        try:
            yield
        except (TrackingLostError, LimitError):
            self._aim.give_back()
            raise
        self._aim.give_back()

    def _measure_face(self, target: str, window_s: float) -> tuple[int, PointReading]:
        face = self._controller.face()
        return face, self._measure_reflector(target, window_s)

    def _measure_reflector(self, target: str, window_s: float) -> PointReading:
        measured = self._beam.measure(window_s=window_s)
        reading = self._interpreter.point(measured, target=target)
        self._aim.reflector_is_at(target, reading.p_trk_m)
        return reading

    @contextmanager
    def _calling(self, call: str, *, is_allowed_in_stream: bool = False) -> Generator[None]:
        """Have the tracker to oneself, and have errors name the call."""
        with self._lock:
            self._connection.call = call
            self._connection.check_open()
            if self._is_streaming and not is_allowed_in_stream:
                raise DeviceError(
                    f"{call}: stream_poses is running; close its iterator first", device=self._name
                )
            yield

    def _take_notice(self, notice: Notice) -> None:
        if notice.is_error:
            self._beam.is_lost = True
        self._notices.append(notice)
        self._tell(notice)
