"""Where each field of each packet lies (emScon 3.6 header)."""

import struct
from collections.abc import Mapping
from typing import Final

from drivers.leica.simulator.codes import Command, DataType
from drivers.leica.simulator.layout import Layout

_REQUEST_HEADER_SIZE: Final = 12

_UNITS = ("units", "5I")
_SIX = ("parameters", "6d")
_SEVEN = ("parameters", "7d")
_ENVIRONMENT = ("environment", "3d")
_POINT = {"point": (12, "3d")}
_SETTINGS = (
    "weather_monitor",
    "apply_transformation",
    "apply_station_orientation",
    "keep_last_position",
    "send_unsolicited",
    "send_positions",
    "try_mode",
    "has_nivel",
    "has_video_camera",
)


def _from(offset: int, *fields: tuple[str, str]) -> dict[str, tuple[int, str]]:
    """Place fields one after the other."""
    placed: dict[str, tuple[int, str]] = {}
    for name, code in fields:
        placed[name] = (offset, code)
        offset += struct.calcsize(f"<{code}")
    return placed


def _settings(offset: int) -> dict[str, tuple[int, str]]:
    return _from(offset, *((name, "I") for name in _SETTINGS))


_STATIONARY = (("time_ms", "i"), ("use_adm", "I"))
_CONTINUOUS_TIME = (("separation_ms", "i"), ("count", "i"), ("use_region", "I"), ("region", "I"))
_CONTINUOUS_DISTANCE = (("distance", "d"), ("count", "i"), ("use_region", "I"), ("region", "I"))
_SEARCH = (("radius", "d"), ("timeout_ms", "i"))
_ADM = (("tolerance", "d"), ("window_ms", "i"), ("retries", "i"))
_STATISTICS = (("stationary", "I"), ("continuous", "I"))

_NO_BODY = Layout(_REQUEST_HEADER_SIZE, {})

REQUESTS: Final[Mapping[int, Layout]] = {
    **dict.fromkeys(set(Command) - {Command.UNKNOWN}, _NO_BODY),
    Command.SET_TEMPERATURE_RANGE: Layout(16, {"range": (12, "I")}),
    Command.SET_UNITS: Layout(32, _from(12, _UNITS)),
    Command.SWITCH_LASER: Layout(16, {"on": (12, "I")}),
    Command.SET_STATION_ORIENTATION: Layout(60, _from(12, _SIX)),
    Command.SET_TRANSFORMATION: Layout(68, _from(12, _SEVEN)),
    Command.SET_ENVIRONMENT: Layout(36, _from(12, _ENVIRONMENT)),
    Command.SET_REFRACTION: Layout(28, {"indices": (12, "2d")}),
    Command.SET_MEASUREMENT_MODE: Layout(16, {"mode": (12, "I")}),
    Command.SET_COORDINATE_SYSTEM: Layout(16, {"kind": (12, "I")}),
    Command.SET_STATIONARY_MODE: Layout(20, _from(12, *_STATIONARY)),
    Command.SET_CONTINUOUS_TIME_MODE: Layout(28, _from(12, *_CONTINUOUS_TIME)),
    Command.SET_CONTINUOUS_DISTANCE_MODE: Layout(32, _from(12, *_CONTINUOUS_DISTANCE)),
    Command.SET_REFLECTOR: Layout(16, {"id": (12, "i")}),
    Command.SET_SEARCH: Layout(24, _from(12, *_SEARCH)),
    Command.SET_ADM: Layout(28, _from(12, *_ADM)),
    Command.SET_SYSTEM_SETTINGS: Layout(48, _settings(12)),
    Command.GO_BIRD_BATH_2: Layout(16, {"clockwise": (12, "I")}),
    Command.GO_POSITION: Layout(40, {**_POINT, "use_adm": (36, "I")}),
    Command.GO_POSITION_HVD: Layout(40, {**_POINT, "use_adm": (36, "I")}),
    Command.POSITION_RELATIVE_HV: Layout(28, {"angles": (12, "2d")}),
    Command.POINT_LASER: Layout(36, _POINT),
    Command.POINT_LASER_HVD: Layout(36, _POINT),
    Command.FIND_REFLECTOR: Layout(20, {"distance": (12, "d")}),
    Command.LOOK_FOR_TARGET: Layout(44, {**_POINT, "radius": (36, "d")}),
    Command.SET_COMPENSATION: Layout(16, {"id": (12, "i")}),
    Command.SET_STATISTIC_MODE: Layout(20, _from(12, *_STATISTICS)),
    Command.SET_CAMERA_MODE: Layout(16, {"mode": (12, "I")}),
    Command.SET_CAMERA_COMPENSATION: Layout(16, {"id": (12, "i")}),
    Command.SET_PROBE_COMPENSATION: Layout(16, {"id": (12, "i")}),
    Command.SET_LONG_PARAMETER: Layout(20, {"parameter": (12, "I"), "value": (16, "i")}),
    Command.GET_LONG_PARAMETER: Layout(16, {"parameter": (12, "I")}),
    Command.SET_DOUBLE_PARAMETER: Layout(24, {"parameter": (12, "I"), "value": (16, "d")}),
    Command.GET_DOUBLE_PARAMETER: Layout(16, {"parameter": (12, "I")}),
    Command.CLEAR_COMMAND_QUEUE: Layout(16, {"whose": (12, "I")}),
    Command.GO_AND_MEASURE: Layout(36, _POINT),
}
"""Body of every request the simulated tracker knows."""

REPLIES: Final[Mapping[int, Layout]] = {
    Command.GET_SYSTEM_STATUS: Layout(
        56,
        {
            "last_status": (16, "I"),
            "processor": (20, "I"),
            "laser": (24, "I"),
            "adm": (28, "I"),
            "version": (32, "3i"),
            "weather_monitor": (44, "I"),
            "flags": (48, "i"),
            "serial": (52, "i"),
        },
    ),
    Command.GET_TRACKER_STATUS: Layout(20, {"tracker_status": (16, "I")}),
    Command.GET_TEMPERATURE_RANGE: Layout(20, {"range": (16, "I")}),
    Command.GET_UNITS: Layout(36, _from(16, _UNITS)),
    Command.GET_STATION_ORIENTATION: Layout(64, _from(16, _SIX)),
    Command.GET_TRANSFORMATION: Layout(72, _from(16, _SEVEN)),
    Command.GET_ENVIRONMENT: Layout(40, _from(16, _ENVIRONMENT)),
    Command.GET_REFRACTION: Layout(32, {"indices": (16, "2d")}),
    Command.GET_MEASUREMENT_MODE: Layout(20, {"mode": (16, "I")}),
    Command.GET_COORDINATE_SYSTEM: Layout(20, {"kind": (16, "I")}),
    Command.GET_STATIONARY_MODE: Layout(24, _from(16, *_STATIONARY)),
    Command.GET_CONTINUOUS_TIME_MODE: Layout(32, _from(16, *_CONTINUOUS_TIME)),
    Command.GET_CONTINUOUS_DISTANCE_MODE: Layout(36, _from(16, *_CONTINUOUS_DISTANCE)),
    Command.GET_REFLECTOR: Layout(20, {"id": (16, "i")}),
    Command.GET_REFLECTORS: Layout(
        100,
        {
            "total": (16, "i"),
            "id": (20, "i"),
            "kind": (24, "I"),
            "surface_offset": (28, "d"),
            "name": (36, "64s"),
        },
    ),
    Command.GET_SEARCH: Layout(28, _from(16, *_SEARCH)),
    Command.GET_ADM: Layout(32, _from(16, *_ADM)),
    Command.GET_SYSTEM_SETTINGS: Layout(52, _settings(16)),
    Command.LOOK_FOR_TARGET: Layout(32, {"angles": (16, "2d")}),
    Command.GET_DIRECTION: Layout(32, {"angles": (16, "2d")}),
    Command.GET_STATISTIC_MODE: Layout(24, _from(16, *_STATISTICS)),
    Command.GET_COMPENSATION: Layout(20, {"id": (16, "i")}),
    Command.GET_COMPENSATIONS: Layout(
        412,
        {
            "total": (16, "i"),
            "id": (20, "i"),
            "name": (24, "64s"),
            "comment": (88, "256s"),
            "adm_name": (344, "64s"),
            "has_camera": (408, "I"),
        },
    ),
    Command.CHECK_BIRD_BATH: Layout(64, {"initial": (16, "3d"), "difference": (40, "3d")}),
    Command.GET_TP_INFO: Layout(
        56,
        {
            "boot": (16, "2i"),
            "firmware": (24, "2i"),
            "lcp_firmware": (32, "2i"),
            "processor": (40, "I"),
            "chip": (44, "I"),
            "clock": (48, "i"),
            "sensor": (52, "I"),
        },
    ),
    Command.GET_FACE: Layout(20, {"face": (16, "I")}),
    Command.GET_CAMERA_MODE: Layout(20, {"mode": (16, "I")}),
    Command.GET_PROBES: Layout(
        356,
        {
            "total": (16, "i"),
            "id": (20, "i"),
            "serial": (24, "i"),
            "kind": (28, "I"),
            "n_fields": (32, "i"),
            "name": (36, "64s"),
            "comment": (100, "256s"),
        },
    ),
    Command.GET_PROBE: Layout(20, {"id": (16, "i")}),
    Command.GET_CAMERA_COMPENSATION: Layout(20, {"id": (16, "i")}),
    Command.GET_PROBE_COMPENSATIONS: Layout(
        364,
        {
            "total": (16, "i"),
            "id": (20, "i"),
            "probe_id": (24, "i"),
            "field": (28, "i"),
            "is_active": (32, "I"),
            "is_exported": (36, "I"),
            "is_preliminary": (40, "I"),
            "name": (44, "64s"),
            "comment": (108, "256s"),
        },
    ),
    Command.GET_PROBE_COMPENSATION: Layout(20, {"id": (16, "i")}),
    Command.GET_PROBE_INFO: Layout(
        72,
        {
            "firmware": (16, "2i"),
            "serial": (24, "i"),
            "kind": (28, "I"),
            "compensation_id": (32, "i"),
            "field": (36, "i"),
            "connection": (40, "I"),
            "n_tip_adapters": (44, "i"),
            "buttons": (48, "I"),
            "n_fields": (52, "i"),
            "has_wide_angle": (56, "I"),
            "n_tip_data_sets": (60, "i"),
            "n_melodies": (64, "i"),
            "n_loudness_steps": (68, "i"),
        },
    ),
    Command.GET_LONG_PARAMETER: Layout(24, {"parameter": (16, "I"), "value": (20, "i")}),
    Command.GET_MEASUREMENT_STATUS_INFO: Layout(24, {"last_status": (16, "I"), "mask": (20, "i")}),
    Command.GET_COMPENSATIONS_2: Layout(
        672,
        {
            "total": (16, "i"),
            "id": (20, "i"),
            "name": (24, "64s"),
            "comment": (88, "256s"),
            "adm_name": (344, "64s"),
            "adm_comment": (408, "256s"),
            "has_camera": (664, "I"),
            "is_active": (668, "I"),
        },
    ),
    Command.GET_PRISM_POSITION: Layout(40, {"point": (16, "3d")}),
    Command.GET_DOUBLE_PARAMETER: Layout(28, {"parameter": (16, "I"), "value": (20, "d")}),
    Command.GET_TRACKER_INFO: Layout(
        164,
        {
            "sensor": (16, "I"),
            "name": (20, "64s"),
            "serial": (84, "i"),
            "compensation_id": (88, "i"),
            "has_adm": (92, "I"),
            "has_overview_camera": (96, "I"),
            "has_nivel": (100, "I"),
            "nivel_offset": (104, "d"),
            "max_distance": (112, "d"),
            "min_distance": (120, "d"),
            "max_rate": (128, "i"),
            "n_faces": (132, "i"),
            "hz_range": (136, "d"),
            "vt_range": (144, "d"),
            "accuracy_model": (152, "I"),
            "firmware": (156, "2i"),
        },
    ),
    Command.GET_METEO_STATION_INFO: Layout(
        92, {"kind": (16, "I"), "name": (20, "64s"), "firmware": (84, "2i")}
    ),
    Command.GET_SOFTWARE_VERSION: Layout(80, {"version": (16, "64s")}),
}
"""Body of every reply that has one."""

DATA: Final[Mapping[int, Layout]] = {
    DataType.SINGLE: Layout(
        156,
        {
            "status": (8, "I"),
            "mode": (12, "I"),
            "try_mode": (16, "I"),
            "value": (20, "3d"),
            "std": (44, "3d"),
            "std_total": (68, "d"),
            "pointing_error": (76, "3d"),
            "apriori_std": (100, "3d"),
            "apriori_total": (124, "d"),
            "air": (132, "3d"),
        },
    ),
    DataType.SINGLE_EXTENDED: Layout(
        204,
        {
            "status": (8, "I"),
            "mode": (12, "I"),
            "try_mode": (16, "I"),
            "value": (20, "3d"),
            "std": (44, "3d"),
            "std_total": (68, "d"),
            "covariance": (76, "3d"),
            "pointing_error": (100, "3d"),
            "apriori_std": (124, "3d"),
            "apriori_total": (148, "d"),
            "apriori_covariance": (156, "3d"),
            "air": (180, "3d"),
        },
    ),
    **dict.fromkeys(
        (DataType.MULTI, DataType.MULTI_EXTENDED),
        Layout(
            48,
            {
                "status": (8, "I"),
                "n": (12, "i"),
                "mode": (16, "I"),
                "try_mode": (20, "I"),
                "air": (24, "3d"),
            },
        ),
    ),
    DataType.PROBE_STATIONARY: Layout(
        376,
        {
            "status": (8, "I"),
            "mode": (12, "I"),
            "try_mode": (16, "I"),
            "trigger": (20, "I"),
            "rotation_status": (24, "i"),
            "probe_id": (28, "i"),
            "field": (32, "i"),
            "tip_status": (36, "I"),
            "tip_id": (40, "i"),
            "tip_interface": (44, "i"),
            "position": (48, "3d"),
            "position_std": (72, "3d"),
            "position_total": (96, "d"),
            "position_covariance": (104, "3d"),
            "apriori_position_std": (128, "3d"),
            "apriori_position_total": (152, "d"),
            "apriori_position_covariance": (160, "3d"),
            "quaternion": (184, "4d"),
            "angles": (216, "3d"),
            "angles_std": (240, "3d"),
            "angles_total": (264, "d"),
            "angles_covariance": (272, "3d"),
            "apriori_angles_std": (296, "3d"),
            "apriori_angles_total": (320, "d"),
            "apriori_angles_covariance": (328, "3d"),
            "air": (352, "3d"),
        },
    ),
    DataType.PROBE_CONTINUOUS: Layout(
        68,
        {
            "status": (8, "I"),
            "n": (12, "i"),
            "mode": (16, "I"),
            "try_mode": (20, "I"),
            "probe_id": (24, "i"),
            "field": (28, "i"),
            "tip_status": (32, "I"),
            "tip_id": (36, "i"),
            "tip_interface": (40, "i"),
            "air": (44, "3d"),
        },
    ),
    DataType.NIVEL: Layout(
        40, {"status": (8, "I"), "state": (12, "I"), "tilt": (16, "2d"), "temperature": (32, "d")}
    ),
    DataType.REFLECTOR_POSITION: Layout(36, {"status": (8, "I"), "value": (12, "3d")}),
    DataType.PROBE_POSITION: Layout(
        108,
        {
            "status": (8, "I"),
            "rotation_status": (12, "i"),
            "tip_status": (16, "I"),
            "tip_id": (20, "i"),
            "tip_interface": (24, "i"),
            "position": (28, "3d"),
            "quaternion": (52, "4d"),
            "angles": (84, "3d"),
        },
    ),
}
"""Data packets, without the samples of continuous ones."""

_SAMPLE = {"status": (0, "I"), "time": (4, "2i"), "value": (12, "3d")}

SAMPLES: Final[Mapping[int, Layout]] = {
    DataType.MULTI: Layout(36, _SAMPLE),
    DataType.MULTI_EXTENDED: Layout(
        92,
        {
            **_SAMPLE,
            "apriori_std": (36, "3d"),
            "apriori_total": (60, "d"),
            "apriori_covariance": (68, "3d"),
        },
    ),
    DataType.PROBE_CONTINUOUS: Layout(
        212,
        {
            "status": (0, "I"),
            "trigger": (4, "I"),
            "rotation_status": (8, "i"),
            "time": (12, "2i"),
            "position": (20, "3d"),
            "position_std": (44, "3d"),
            "position_total": (68, "d"),
            "position_covariance": (76, "3d"),
            "quaternion": (100, "4d"),
            "angles": (132, "3d"),
            "angles_std": (156, "3d"),
            "angles_total": (180, "d"),
            "angles_covariance": (188, "3d"),
        },
    ),
}
"""One sample of a continuous packet; offsets count from where the sample starts."""
