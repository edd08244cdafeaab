"""Commands that only ask: each gives the bodies of its replies, one a packet."""

from collections.abc import Callable, Mapping
from math import pi
from typing import Any, Final, TypeAlias

from drivers.leica.simulator.codes import Command, Status
from drivers.leica.simulator.layout import Values
from drivers.leica.simulator.presentation import hvd_of
from drivers.leica.simulator.setters import wrong_parameter
from drivers.leica.simulator.settings import (
    LONG_PARAMETERS,
    LONGEST_DISTANCE_M,
    LONGEST_DISTANCES,
    MOST_POINTS_PER_S,
    READ_ONLY_LONG_PARAMETERS,
    SHORTEST_DISTANCE_M,
)
from drivers.leica.simulator.tables import REPLIES
from drivers.leica.simulator.targets import (
    CAMERA_COMPENSATION_ID,
    N_PROBE_FIELDS,
    PROBE_COMPENSATION_ID,
    PROBE_ID,
    PROBE_NAME,
    PROBE_TYPE,
    REFLECTORS,
    TRACKER_COMPENSATION_ID,
)
from drivers.leica.simulator.tracker import RefusedError, Tracker
from drivers.leica.simulator.units import Units

Getter: TypeAlias = Callable[[Tracker, Mapping[str, Any]], list[Values]]

SENSOR_TYPE: Final = 14
"""AT901-MR."""
MODEL: Final = "AT901-MR"
SOFTWARE_VERSION: Final = (3, 6, 0)
FIRMWARE: Final = (1, 72)

_PROCESSOR_BOOTED, _PROCESSOR_INITIALISED = 3, 5
_LASER_HEATING, _LASER_READY, _LASER_OFF = 2, 3, 5
_ADM_READY: Final = 2
_INFRARED: Final = 4
_THOMMEN: Final = 1


def air_values(tracker: Tracker) -> tuple[float, float, float]:
    """Give temperature, pressure and humidity in the client's units."""
    air, units = tracker.air, tracker.settings.units
    return (
        units.temperature_of(air.temperature_k),
        air.pressure_pa / units.pa_per_pressure,
        100.0 * air.relative_humidity,
    )


def direction_values(tracker: Tracker) -> tuple[float, float]:
    """Give Hz and Vt of the beam in the client's units."""
    hz, vt, _ = hvd_of(tracker.p_beam_m)
    rad = tracker.settings.units.rad_per_angle
    return hz / rad, vt / rad


def _system_status(tracker: Tracker) -> Values:
    laser = _LASER_READY if tracker.is_warm else _LASER_HEATING
    return {
        "last_status": tracker.last_status,
        "processor": _PROCESSOR_INITIALISED if tracker.is_initialised else _PROCESSOR_BOOTED,
        "laser": laser if tracker.is_laser_on else _LASER_OFF,
        "adm": _ADM_READY,
        "version": SOFTWARE_VERSION,
        "weather_monitor": tracker.settings.weather_monitor,
        "flags": 0,
        "serial": tracker.scene.serial,
    }


def _of_client(parameters: tuple[float, ...], units: Units) -> tuple[float, ...]:
    """Give three translations and three rotations in the client's units."""
    return (
        *(value / units.m_per_length for value in parameters[:3]),
        *(value / units.rad_per_angle for value in parameters[3:6]),
        *parameters[6:],
    )


def _units(tracker: Tracker) -> Values:
    units = tracker.settings.units
    return {"units": (units.length, units.angle, units.temperature, units.pressure, units.humidity)}


def _stationary(tracker: Tracker) -> Values:
    settings = tracker.settings
    return {"time_ms": settings.stationary_ms, "use_adm": int(settings.stationary_uses_adm)}


def _continuous_time(tracker: Tracker) -> Values:
    settings = tracker.settings
    return {
        "separation_ms": settings.separation_ms,
        "count": settings.separation_count,
        "use_region": 0,
        "region": 0,
    }


def _continuous_distance(tracker: Tracker) -> Values:
    settings = tracker.settings
    return {
        "distance": settings.distance_m / settings.units.m_per_length,
        "count": settings.distance_count,
        "use_region": 0,
        "region": 0,
    }


def _search(tracker: Tracker) -> Values:
    settings = tracker.settings
    return {
        "radius": settings.search_radius_m / settings.units.m_per_length,
        "timeout_ms": settings.search_timeout_ms,
    }


def _adm(tracker: Tracker) -> Values:
    settings = tracker.settings
    return {
        "tolerance": settings.adm_tolerance_m / settings.units.m_per_length,
        "window_ms": settings.adm_window_ms,
        "retries": settings.adm_retries,
    }


def _system_settings(tracker: Tracker) -> Values:
    names = REPLIES[Command.GET_SYSTEM_SETTINGS].fields
    return {name: getattr(tracker.settings, name) for name in names}


def _reflectors(tracker: Tracker, _values: Mapping[str, Any]) -> list[Values]:
    m = tracker.settings.units.m_per_length
    return [
        {
            "total": len(REFLECTORS),
            "id": reflector.id,
            "kind": reflector.target_type,
            "surface_offset": reflector.surface_offset_m / m,
            "name": reflector.name,
        }
        for reflector in REFLECTORS.values()
    ]


def _compensation(_tracker: Tracker) -> Values:
    return {
        "total": 1,
        "id": TRACKER_COMPENSATION_ID,
        "name": "factory",
        "comment": "",
        "adm_name": "factory",
        "has_camera": 1,
    }


def _statistics(tracker: Tracker) -> Values:
    stationary, continuous = tracker.settings.statistics
    return {"stationary": stationary, "continuous": continuous}


def _processor(_tracker: Tracker) -> Values:
    return {
        "boot": (1, 4),
        "firmware": FIRMWARE,
        "lcp_firmware": FIRMWARE,
        "processor": 0,
        "chip": 0,
        "clock": 400,
        "sensor": SENSOR_TYPE,
    }


def _probes(tracker: Tracker, _values: Mapping[str, Any]) -> list[Values]:
    """List the data base: a T-MAC stays there while it is not recognised."""
    return [
        {
            "total": 1,
            "id": PROBE_ID,
            "serial": tracker.scene.serial,
            "kind": PROBE_TYPE,
            "n_fields": N_PROBE_FIELDS,
            "name": PROBE_NAME,
            "comment": "",
        }
    ]


def _check_probe(tracker: Tracker) -> None:
    if not tracker.has_probe:
        raise RefusedError(Status.NO_PROBE)


def _probe(tracker: Tracker) -> Values:
    _check_probe(tracker)
    return {"id": PROBE_ID}


def _probe_info(tracker: Tracker) -> Values:
    _check_probe(tracker)
    return {
        "firmware": (2, 10),
        "serial": tracker.scene.serial,
        "kind": PROBE_TYPE,
        "compensation_id": PROBE_COMPENSATION_ID,
        "field": 1,
        "connection": _INFRARED,
        "n_tip_adapters": 0,
        "buttons": 0,
        "n_fields": N_PROBE_FIELDS,
        "has_wide_angle": 1,
        "n_tip_data_sets": 0,
        "n_melodies": 0,
        "n_loudness_steps": 0,
    }


def _probe_compensation(_tracker: Tracker) -> Values:
    return {
        "total": 1,
        "id": PROBE_COMPENSATION_ID,
        "probe_id": PROBE_ID,
        "field": 1,
        "is_active": 1,
        "is_exported": 0,
        "is_preliminary": 0,
        "name": "factory",
        "comment": "",
    }


def _no_tip(_tracker: Tracker) -> Values:
    raise RefusedError(Status.NO_TIP)


def _long_parameter(tracker: Tracker, values: Mapping[str, Any]) -> list[Values]:
    number = values["parameter"]
    if number in READ_ONLY_LONG_PARAMETERS:
        value = READ_ONLY_LONG_PARAMETERS[number]
    elif number in LONG_PARAMETERS:
        value = getattr(tracker.settings, LONG_PARAMETERS[number].attribute)
    else:
        raise wrong_parameter(1)
    return [{"parameter": number, "value": value}]


def _double_parameter(tracker: Tracker, values: Mapping[str, Any]) -> list[Values]:
    number, settings = values["parameter"], tracker.settings
    if number in LONGEST_DISTANCES:
        value = LONGEST_DISTANCE_M / settings.units.m_per_length
    elif number in settings.thresholds:
        value = settings.thresholds[number]
    else:
        raise wrong_parameter(1)
    return [{"parameter": number, "value": value}]


def _prism_position(tracker: Tracker) -> Values:
    if tracker.target is None:
        raise RefusedError(Status.NOT_READY)
    return {"point": tracker.settings.presentation.point(tracker.p_beam_m)}


def _tracker_info(tracker: Tracker) -> Values:
    units = tracker.settings.units
    return {
        "sensor": SENSOR_TYPE,
        "name": MODEL,
        "serial": tracker.scene.serial,
        "compensation_id": TRACKER_COMPENSATION_ID,
        "has_adm": 1,
        "has_overview_camera": 1,
        "has_nivel": tracker.settings.has_nivel,
        "nivel_offset": 0.0,
        "max_distance": LONGEST_DISTANCE_M / units.m_per_length,
        "min_distance": SHORTEST_DISTANCE_M / units.m_per_length,
        "max_rate": MOST_POINTS_PER_S,
        "n_faces": 2,
        "hz_range": 2.0 * pi / units.rad_per_angle,
        "vt_range": pi / 2.0 / units.rad_per_angle,
        "accuracy_model": 0,
        "firmware": FIRMWARE,
    }


def _one(getter: Callable[[Tracker], Values]) -> Getter:
    """Make a getter of one packet that takes no parameter."""
    return lambda tracker, _values: [getter(tracker)]


GETTERS: Final[Mapping[int, Getter]] = {
    Command.GET_REFLECTORS: _reflectors,
    Command.GET_PROBES: _probes,
    Command.GET_LONG_PARAMETER: _long_parameter,
    Command.GET_DOUBLE_PARAMETER: _double_parameter,
    **{
        command: _one(getter)
        for command, getter in {
            Command.GET_SYSTEM_STATUS: _system_status,
            Command.GET_TRACKER_STATUS: lambda t: {"tracker_status": t.status},
            Command.GET_TEMPERATURE_RANGE: lambda t: {"range": t.settings.temperature_range},
            Command.GET_UNITS: _units,
            Command.GET_STATION_ORIENTATION: lambda t: {
                "parameters": _of_client(t.settings.station, t.settings.units)
            },
            Command.GET_TRANSFORMATION: lambda t: {
                "parameters": _of_client(t.settings.transformation, t.settings.units)
            },
            Command.GET_ENVIRONMENT: lambda t: {"environment": air_values(t)},
            Command.GET_REFRACTION: lambda t: {"indices": t.refraction},
            Command.GET_MEASUREMENT_MODE: lambda t: {"mode": t.settings.mode},
            Command.GET_COORDINATE_SYSTEM: lambda t: {"kind": t.settings.coordinate_system},
            Command.GET_STATIONARY_MODE: _stationary,
            Command.GET_CONTINUOUS_TIME_MODE: _continuous_time,
            Command.GET_CONTINUOUS_DISTANCE_MODE: _continuous_distance,
            Command.GET_REFLECTOR: lambda t: {"id": t.settings.reflector_id},
            Command.GET_SEARCH: _search,
            Command.GET_ADM: _adm,
            Command.GET_SYSTEM_SETTINGS: _system_settings,
            Command.GET_DIRECTION: lambda t: {"angles": direction_values(t)},
            Command.GET_COMPENSATION: lambda _: {"id": TRACKER_COMPENSATION_ID},
            Command.GET_COMPENSATIONS: _compensation,
            Command.GET_COMPENSATIONS_2: lambda t: {
                **_compensation(t),
                "adm_comment": "",
                "is_active": 1,
            },
            Command.GET_STATISTIC_MODE: _statistics,
            Command.GET_TP_INFO: _processor,
            Command.GET_FACE: lambda t: {"face": t.face},
            Command.GET_CAMERA_MODE: lambda t: {"mode": t.settings.camera_mode},
            Command.GET_PROBE: _probe,
            Command.GET_TIP_ADAPTERS: _no_tip,
            Command.GET_TIP_ADAPTER: _no_tip,
            Command.GET_CAMERA_COMPENSATION: lambda _: {"id": CAMERA_COMPENSATION_ID},
            Command.GET_PROBE_COMPENSATIONS: _probe_compensation,
            Command.GET_PROBE_COMPENSATION: lambda _: {"id": PROBE_COMPENSATION_ID},
            Command.GET_PROBE_INFO: _probe_info,
            Command.GET_MEASUREMENT_STATUS_INFO: lambda t: {
                "last_status": t.last_status,
                "mask": t.measurement_status,
            },
            Command.GET_PRISM_POSITION: _prism_position,
            Command.GET_TRACKER_INFO: _tracker_info,
            Command.GET_METEO_STATION_INFO: lambda _: {
                "kind": _THOMMEN,
                "name": "Thommen HM30",
                "firmware": (1, 0),
            },
            Command.GET_SOFTWARE_VERSION: lambda _: {
                "version": ".".join(str(number) for number in SOFTWARE_VERSION)
            },
        }.items()
    },
}
"""What each command that only asks is answered."""
