"""Commands that change a setting: what they accept, and the event that tells of it."""

from collections.abc import Callable, Mapping
from typing import Any, Final, TypeAlias

from drivers.leica.simulator.codes import Command, Event, Mode, Status
from drivers.leica.simulator.faults import WRONG_REFLECTOR
from drivers.leica.simulator.presentation import N_COORDINATE_SYSTEMS
from drivers.leica.simulator.refraction import adm_index, ifm_index
from drivers.leica.simulator.settings import (
    LONG_PARAMETERS,
    MONITOR_COMPUTE,
    MOST_POINTS_PER_S,
    MOST_POSES_PER_S,
    READ_ONLY_LONG_PARAMETERS,
)
from drivers.leica.simulator.targets import (
    CAMERA_COMPENSATION_ID,
    PROBE_COMPENSATION_ID,
    REFLECTORS,
    TRACKER_COMPENSATION_ID,
)
from drivers.leica.simulator.tracker import RefusedError, Tracker
from drivers.leica.simulator.units import N_CHOICES, Units
from tronlab.devices.readings import AirReading
from tronlab.twin.state import Faults

Setter: TypeAlias = Callable[[Tracker, Mapping[str, Any]], None]

_STATIONARY_MS: Final = (100, 100_000)
_INDEX_RANGE: Final = (1.000150, 1.000331)
"""Refractive indices that the tracker accepts."""
_TEMPERATURE_RANGE_K: Final = (243.15, 333.15)
_PRESSURE_RANGE_PA: Final = (50_000.0, 110_000.0)


def wrong_parameter(n: int) -> RefusedError:
    """Say that parameter ``n``, from 1, is none of the values there are."""
    return RefusedError(Status.WRONG_PARAMETER + n)


def out_of_range(n: int) -> RefusedError:
    """Say that parameter ``n``, from 1, is too low or too high; nothing was changed."""
    return RefusedError(Status.OUT_OF_RANGE_1 + 2 * (n - 1))


def apply(command: Command, tracker: Tracker, values: Mapping[str, Any], faults: Faults) -> Event:
    """Carry out a command of ``SETTERS``.

    Returns:
        The event that tells of it.

    Raises:
        RefusedError: A value is not accepted; nothing was changed.
    """
    setter, told = SETTERS[command]
    if command != Command.SET_REFLECTOR or not faults.strike(WRONG_REFLECTOR):
        setter(tracker, values)
    return told


def _check_choice(value: int, n_choices: int, *, parameter: int) -> None:
    if value >= n_choices:
        raise wrong_parameter(parameter)


def _check_range(value: float, low: float, high: float, *, parameter: int) -> None:
    if not low <= value <= high:
        raise out_of_range(parameter)


def _set_units(tracker: Tracker, values: Mapping[str, Any]) -> None:
    for i, (choice, n_choices) in enumerate(zip(values["units"], N_CHOICES, strict=True)):
        _check_choice(choice, n_choices, parameter=i + 1)
    tracker.settings.units = Units(*values["units"])


def _set_temperature_range(tracker: Tracker, values: Mapping[str, Any]) -> None:
    _check_choice(values["range"], 3, parameter=1)
    tracker.settings.temperature_range = values["range"]


def _in_si(parameters: tuple[float, ...], units: Units) -> tuple[float, ...]:
    """Give three translations and three rotations of a client in metres and radians."""
    return (
        *(value * units.m_per_length for value in parameters[:3]),
        *(value * units.rad_per_angle for value in parameters[3:6]),
    )


def _set_station(tracker: Tracker, values: Mapping[str, Any]) -> None:
    settings = tracker.settings
    settings.station = _in_si(values["parameters"], settings.units)


def _set_transformation(tracker: Tracker, values: Mapping[str, Any]) -> None:
    settings, parameters = tracker.settings, values["parameters"]
    _check_range(parameters[6], 1e-6, 1e6, parameter=7)
    settings.transformation = (*_in_si(parameters, settings.units), parameters[6])


def _set_environment(tracker: Tracker, values: Mapping[str, Any]) -> None:
    settings = tracker.settings
    temperature, pressure, humidity = values["environment"]
    air = AirReading(
        temperature_k=settings.units.kelvin(temperature),
        pressure_pa=pressure * settings.units.pa_per_pressure,
        relative_humidity=humidity / 100.0,
    )
    low_k, high_k = _TEMPERATURE_RANGE_K
    low_pa, high_pa = _PRESSURE_RANGE_PA
    is_usual = low_k <= air.temperature_k <= high_k and low_pa <= air.pressure_pa <= high_pa
    if not is_usual or not 0.0 <= air.relative_humidity <= 1.0:
        raise RefusedError(Status.METEO_OUT_OF_RANGE)
    settings.environment = air
    settings.refraction = ifm_index(air), adm_index(air)


def _set_refraction(tracker: Tracker, values: Mapping[str, Any]) -> None:
    for i, index in enumerate(values["indices"]):
        _check_range(index, *_INDEX_RANGE, parameter=i + 1)
    if tracker.settings.weather_monitor == MONITOR_COMPUTE:
        raise RefusedError(Status.USAGE_CONFLICT)
    tracker.settings.refraction = values["indices"]


def _set_mode(tracker: Tracker, values: Mapping[str, Any]) -> None:
    if values["mode"] not in tuple(Mode):
        raise wrong_parameter(1)
    mode = Mode(values["mode"])
    if mode.is_probe and tracker.face == 2:
        raise RefusedError(Status.NO_PROBE_IN_FACE_2)
    tracker.settings.mode = mode


def _set_coordinate_system(tracker: Tracker, values: Mapping[str, Any]) -> None:
    _check_choice(values["kind"], N_COORDINATE_SYSTEMS, parameter=1)
    tracker.settings.coordinate_system = values["kind"]


def _set_stationary(tracker: Tracker, values: Mapping[str, Any]) -> None:
    _check_range(values["time_ms"], *_STATIONARY_MS, parameter=1)
    _check_choice(values["use_adm"], 2, parameter=2)
    tracker.settings.stationary_ms = values["time_ms"]
    tracker.settings.stationary_uses_adm = bool(values["use_adm"])


def _check_count_and_region(values: Mapping[str, Any]) -> None:
    _check_range(values["count"], 0, 2**31 - 1, parameter=2)
    if values["use_region"]:
        raise RefusedError(Status.NOT_IMPLEMENTED)


def _set_continuous_time(tracker: Tracker, values: Mapping[str, Any]) -> None:
    is_probe = tracker.settings.mode.is_probe
    most_per_s = MOST_POSES_PER_S if is_probe else MOST_POINTS_PER_S
    _check_range(values["separation_ms"], 1000 / most_per_s, 100_000, parameter=1)
    _check_count_and_region(values)
    tracker.settings.separation_ms = values["separation_ms"]
    tracker.settings.separation_count = values["count"]


def _set_continuous_distance(tracker: Tracker, values: Mapping[str, Any]) -> None:
    distance_m = values["distance"] * tracker.settings.units.m_per_length
    _check_range(distance_m, 1e-6, 100.0, parameter=1)
    _check_count_and_region(values)
    tracker.settings.distance_m = distance_m
    tracker.settings.distance_count = values["count"]


def _set_reflector(tracker: Tracker, values: Mapping[str, Any]) -> None:
    if values["id"] not in REFLECTORS:
        raise wrong_parameter(1)
    tracker.settings.reflector_id = values["id"]


def _set_search(tracker: Tracker, values: Mapping[str, Any]) -> None:
    radius_m = values["radius"] * tracker.settings.units.m_per_length
    _check_range(radius_m, 0.0, 10.0, parameter=1)
    _check_range(values["timeout_ms"], 1, 600_000, parameter=2)
    tracker.settings.search_radius_m = radius_m
    tracker.settings.search_timeout_ms = values["timeout_ms"]


def _set_adm(tracker: Tracker, values: Mapping[str, Any]) -> None:
    tolerance_m = values["tolerance"] * tracker.settings.units.m_per_length
    _check_range(tolerance_m, 0.0, 0.1, parameter=1)
    _check_range(values["window_ms"], 0, 100_000, parameter=2)
    _check_range(values["retries"], 0, 1000, parameter=3)
    tracker.settings.adm_tolerance_m = tolerance_m
    tracker.settings.adm_window_ms = values["window_ms"]
    tracker.settings.adm_retries = values["retries"]


def _set_system_settings(tracker: Tracker, values: Mapping[str, Any]) -> None:
    for i, (name, value) in enumerate(values.items()):
        _check_choice(value, 3 if name == "weather_monitor" else 2, parameter=i + 1)
    for name, value in values.items():
        setattr(tracker.settings, name, value)


def _set_statistics(tracker: Tracker, values: Mapping[str, Any]) -> None:
    _check_choice(values["stationary"], 2, parameter=1)
    _check_choice(values["continuous"], 2, parameter=2)
    tracker.settings.statistics = values["stationary"], values["continuous"]


def _set_camera_mode(tracker: Tracker, values: Mapping[str, Any]) -> None:
    _check_choice(values["mode"], 2, parameter=1)
    tracker.settings.camera_mode = values["mode"]


def _only(id_in_use: int) -> Setter:
    """Accept the one compensation there is."""

    def check(_tracker: Tracker, values: Mapping[str, Any]) -> None:
        if values["id"] != id_in_use:
            raise RefusedError(Status.NO_SUCH_COMPENSATION)

    return check


def _set_long_parameter(tracker: Tracker, values: Mapping[str, Any]) -> None:
    parameter = LONG_PARAMETERS.get(values["parameter"])
    if parameter is None:
        is_read_only = values["parameter"] in READ_ONLY_LONG_PARAMETERS
        raise RefusedError(Status.USAGE_CONFLICT) if is_read_only else wrong_parameter(1)
    _check_range(values["value"], parameter.lowest, parameter.highest, parameter=2)
    setattr(tracker.settings, parameter.attribute, values["value"])


def _set_double_parameter(tracker: Tracker, values: Mapping[str, Any]) -> None:
    if values["parameter"] not in tracker.settings.thresholds:
        raise wrong_parameter(1)
    _check_range(values["value"], 0.0, 1e6, parameter=2)
    tracker.settings.thresholds[values["parameter"]] = values["value"]


def _restore(tracker: Tracker, _values: Mapping[str, Any]) -> None:
    tracker.settings.restore()


SETTERS: Final[Mapping[int, tuple[Setter, Event]]] = {
    Command.SET_UNITS: (_set_units, Event.UNITS),
    Command.SET_TEMPERATURE_RANGE: (_set_temperature_range, Event.TEMPERATURE_RANGE),
    Command.SET_STATION_ORIENTATION: (_set_station, Event.STATION_ORIENTATION),
    Command.SET_TRANSFORMATION: (_set_transformation, Event.TRANSFORMATION),
    Command.SET_ENVIRONMENT: (_set_environment, Event.ENVIRONMENT),
    Command.SET_REFRACTION: (_set_refraction, Event.REFRACTION),
    Command.SET_MEASUREMENT_MODE: (_set_mode, Event.MEASUREMENT_MODE),
    Command.SET_COORDINATE_SYSTEM: (_set_coordinate_system, Event.COORDINATE_SYSTEM),
    Command.SET_STATIONARY_MODE: (_set_stationary, Event.STATIONARY_MODE),
    Command.SET_CONTINUOUS_TIME_MODE: (_set_continuous_time, Event.CONTINUOUS_TIME_MODE),
    Command.SET_CONTINUOUS_DISTANCE_MODE: (
        _set_continuous_distance,
        Event.CONTINUOUS_DISTANCE_MODE,
    ),
    Command.SET_REFLECTOR: (_set_reflector, Event.REFLECTOR),
    Command.SET_SEARCH: (_set_search, Event.SEARCH),
    Command.SET_ADM: (_set_adm, Event.ADM),
    Command.SET_SYSTEM_SETTINGS: (_set_system_settings, Event.SETTINGS),
    Command.SET_STATISTIC_MODE: (_set_statistics, Event.STATISTIC_MODE),
    Command.SET_CAMERA_MODE: (_set_camera_mode, Event.CAMERA),
    Command.SET_COMPENSATION: (_only(TRACKER_COMPENSATION_ID), Event.COMPENSATION),
    Command.SET_CAMERA_COMPENSATION: (_only(CAMERA_COMPENSATION_ID), Event.CAMERA),
    Command.SET_PROBE_COMPENSATION: (_only(PROBE_COMPENSATION_ID), Event.PROBE_COMPENSATION),
    Command.SET_LONG_PARAMETER: (_set_long_parameter, Event.SETTINGS),
    Command.SET_DOUBLE_PARAMETER: (_set_double_parameter, Event.SETTINGS),
    Command.RESTORE_STARTUP_CONDITIONS: (_restore, Event.SETTINGS),
}
"""What each command changes, and the event that tells of it."""
