"""Questions to a tracker controller, and its settings; nothing here moves the head."""

from dataclasses import astuple, replace

from drivers.leica import codes
from drivers.leica import status as statuses
from drivers.leica.codes import Command, LaserStatus, Mode, Ready, laser_text
from drivers.leica.connection import Connection
from drivers.leica.options import TrackerOptions
from drivers.leica.readings import air_reading, environment_of
from drivers.leica.replies import (
    Direction,
    Environment,
    MeasurementStatus,
    MeteoStation,
    Number,
    Probe,
    ProbeInfo,
    ReflectorType,
    SystemSettings,
    SystemStatus,
    TrackerInfo,
)
from drivers.leica.wire import decode
from tronlab.devices.readings import AirReading
from tronlab.errors import DeviceFaultError, LimitError, NotReadyError


class Controller:
    """A tracker controller at the other end of an open connection."""

    def __init__(self, connection: Connection, options: TrackerOptions, *, device: str) -> None:
        self.connection = connection
        self._options = options
        self._device = device
        self._mode: Mode | None = None
        self._reflector_types: tuple[ReflectorType, ...] = ()

    # --- Set-up ---

    def set_up(self) -> None:
        """Set what measurements rely on, right after the connection was opened.

        Raises:
            NotReadyError: The laser still warms up, or the tracker boots.
            DeviceError: Anything else that is not as it must be.
        """
        self._mode = None
        self.check_state(self.system_status())
        exchange = self.connection.exchange
        exchange(Command.SET_UNITS, 0, 0, 0, 0, 0)  # m, rad, degrees Celsius, mbar, %RH
        exchange(Command.SET_COORDINATE_SYSTEM_TYPE, 0)  # right-handed Cartesian
        exchange(Command.SET_STATION_ORIENTATION, *[0.0] * 6)
        exchange(Command.SET_TRANSFORMATION, *[0.0] * 6, 1.0)
        exchange(Command.SET_STATISTIC_MODE, codes.EXTENDED_STATISTICS, codes.STANDARD_STATISTICS)
        exchange(Command.SET_LONG_PARAMETER, codes.TIP_RULE_PARAMETER, codes.NO_TIP_ALLOWED)
        self._set_up_weather()
        self._reflector_types = self.connection.ask_list(ReflectorType, Command.GET_REFLECTORS)
        for reflector in self._options.reflectors.values():
            self._reflector_type(reflector.type)

    def _set_up_weather(self) -> None:
        air = self._options.air
        monitor = codes.WeatherMonitor.READ_AND_CORRECT if air is None else codes.WeatherMonitor.OFF
        if air is None:
            station = self.connection.ask(MeteoStation, Command.GET_METEO_STATION_INFO)
            if station.station_type == codes.NO_METEO_STATION:
                raise DeviceFaultError(
                    f"{self.connection.call}: the tracker has no weather station; connect it or"
                    " give the air in options.air",
                    device=self._device,
                    code=statuses.NO_WEATHER_STATION,
                )
        settings = self.connection.ask(SystemSettings, Command.GET_SYSTEM_SETTINGS)
        self._set_settings(
            replace(
                settings,
                weather_monitor=monitor,
                applies_transformation=0,
                applies_station_orientation=0,
                keeps_last_position=1,
                sends_unsolicited=1,
                sends_reflector_position=0,
                is_try_mode=0,
            )
        )
        if air is not None:
            self.set_environment(AirReading(**air.model_dump()))

    def check_state(self, status: SystemStatus) -> None:
        """Return if the tracker could be used, initialised or not.

        Raises:
            NotReadyError: Not yet.
            DeviceFaultError: Its laser has failed or is off.
        """
        call, device = self.connection.call, self._device
        if status.laser == LaserStatus.HEATING:
            raise statuses.error_of(statuses.NOT_WARMED_UP, f"{call}: the laser", device=device)
        if status.laser != LaserStatus.READY:
            raise DeviceFaultError(
                f"{call}: the laser is not ready: {laser_text(status.laser)}",
                device=device,
                code=status.laser,
            )
        if status.processor < codes.BOOTED:
            raise NotReadyError(
                f"{call}: the tracker processor still boots (state {status.processor}); wait, and"
                " check the cable between controller and tracker",
                device=device,
                code=statuses.NOT_INITIALISED,
            )

    # --- Questions ---

    def system_status(self) -> SystemStatus:
        """Ask for the state of the controller."""
        return self.connection.ask(SystemStatus, Command.GET_SYSTEM_STATUS)

    def tracker_status(self) -> int:
        """Ask whether a measurement could start: a ``TrackerStatus``, or a number unknown here."""
        return self._number(Command.GET_TRACKER_STATUS)

    def tracker_info(self) -> TrackerInfo:
        """Ask which tracker it is."""
        return self.connection.ask(TrackerInfo, Command.GET_TRACKER_INFO)

    def ready(self) -> Ready:
        """Ask what of a measurement is there."""
        status = self.connection.ask(MeasurementStatus, Command.GET_MEASUREMENT_STATUS_INFO)
        return Ready(status.ready)

    def face(self) -> int:
        """Ask in which face the tracker is: 1 or 2; 0 if it does not know."""
        return self._number(Command.GET_FACE)

    def direction(self) -> Direction:
        """Ask where the head points."""
        return self.connection.ask(Direction, Command.GET_DIRECTION)

    def air(self) -> AirReading:
        """Ask for the air."""
        packet = self.connection.exchange(Command.GET_ENVIRONMENT)
        return self.connection.read_by(lambda body: air_reading(decode(Environment, body)), packet)

    @property
    def reflector_types(self) -> tuple[ReflectorType, ...]:
        """Get the tracker's list of kinds of reflectors, as it was when connected."""
        return self._reflector_types

    def probes(self) -> tuple[Probe, ...]:
        """Ask for the tracker's list of probes."""
        return self.connection.ask_list(Probe, Command.GET_PROBES)

    def probe_info(self) -> ProbeInfo:
        """Ask which probe the tracker sees.

        Raises:
            DeviceFaultError: It is no T-MAC.
        """
        info = self.connection.ask(ProbeInfo, Command.GET_MEASUREMENT_PROBE_INFO)
        if info.probe_type not in codes.TMAC_PROBE_TYPES:
            raise DeviceFaultError(
                f"{self.connection.call}: probe missing: the tracker sees a probe of type"
                f" {info.probe_type}, a T-MAC has one of {sorted(codes.TMAC_PROBE_TYPES)}",
                device=self._device,
                code=statuses.NO_ACTIVE_PROBE,
            )
        return info

    # --- Settings ---

    def set_environment(self, air: AirReading) -> None:
        """Set the air to correct distances for."""
        values = environment_of(air)
        self.connection.exchange(
            Command.SET_ENVIRONMENT, values.temperature_c, values.pressure_mbar, values.humidity_pct
        )

    def set_mode(self, mode: Mode) -> None:
        """Set what is measured."""
        if self._mode != mode:
            self._mode = None
            self.connection.exchange(Command.SET_MEASUREMENT_MODE, mode)
            self._mode = mode

    def forget_mode(self) -> None:
        """Set the mode anew next time: the tracker may have changed it."""
        self._mode = None

    def select_reflector(self, type_name: str) -> None:
        """Select a kind of reflector, and make sure that it is selected.

        Raises:
            LimitError: The tracker has none of that name.
            DeviceFaultError: Another one is selected afterwards: distances would be wrong.
        """
        wanted = self._reflector_type(type_name)
        self.connection.exchange(Command.SET_REFLECTOR, wanted.id)
        selected = self._number(Command.GET_REFLECTOR)
        if selected != wanted.id:
            raise DeviceFaultError(
                f"{self.connection.call}: asked for reflector {type_name} (id {wanted.id}), but id"
                f" {selected} is selected; its distances would be wrong",
                device=self._device,
                code=statuses.WRONG_REFLECTOR,
            )

    def _number(self, command: Command) -> int:
        return self.connection.ask(Number, command).value

    def _set_settings(self, settings: SystemSettings) -> None:
        self.connection.exchange(Command.SET_SYSTEM_SETTINGS, *astuple(settings))

    def _reflector_type(self, name: str) -> ReflectorType:
        for reflector in self._reflector_types:
            if reflector.name == name:
                return reflector
        names = ", ".join(reflector.name for reflector in self._reflector_types) or "none"
        raise LimitError(
            f"{self.connection.call}: no reflector of type '{name}' in the tracker's list; it has:"
            f" {names}",
            device=self._device,
        )
