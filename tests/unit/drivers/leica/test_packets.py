"""Requests equal golden bytes and those of the independent CESAPI; splitting is harmless."""

import struct

import pytest
from CESAPI import packet as cesapi
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.leica.codes import Command
from drivers.leica.packets import PacketBuffer, encode_request

GOLDEN = {
    "0c000000 00000000 07000000": (Command.INITIALIZE,),
    "0c000000 00000000 31000000": (Command.START_MEASUREMENT,),
    "20000000 00000000 05000000 01000000 00000000 00000000 00000000 00000000": (
        Command.SET_UNITS,
        *(1, 0, 0, 0, 0),
    ),
    "14000000 00000000 1c000000 d0070000 01000000": (Command.SET_STATIONARY_PARAMETERS, 2000, 1),
    "10000000 00000000 28000000 07000000": (Command.SET_REFLECTOR, 7),
    "14000000 00000000 3f000000 0000000000000440": (Command.FIND_REFLECTOR, 2.5),
    "10000000 00000000 18000000 06000000": (Command.SET_MEASUREMENT_MODE, 6),
    "24000000 00000000 3a000000 000000000000f03f 0000000000000040 0000000000000840": (
        Command.POINT_LASER,
        *(1.0, 2.0, 3.0),
    ),
    "24000000 00000000 14000000 0000000000003440 0000000000aa8f40 0000000000004940": (
        Command.SET_ENVIRONMENT,
        *(20.0, 1013.25, 50.0),
    ),
}
"""Requests made with CESAPI 1.1.3, and what they say."""

REQUEST_SIZES = {
    Command.GET_SYSTEM_STATUS: 12,
    Command.GET_TRACKER_STATUS: 12,
    Command.SET_UNITS: 32,
    Command.INITIALIZE: 12,
    Command.SET_STATION_ORIENTATION: 60,
    Command.SET_TRANSFORMATION: 68,
    Command.SET_ENVIRONMENT: 36,
    Command.GET_ENVIRONMENT: 12,
    Command.SET_MEASUREMENT_MODE: 16,
    Command.SET_COORDINATE_SYSTEM_TYPE: 16,
    Command.SET_STATIONARY_PARAMETERS: 20,
    Command.SET_CONTINUOUS_TIME_PARAMETERS: 28,
    Command.SET_REFLECTOR: 16,
    Command.GET_REFLECTOR: 12,
    Command.GET_REFLECTORS: 12,
    Command.SET_SEARCH_PARAMETERS: 24,
    Command.SET_SYSTEM_SETTINGS: 48,
    Command.GET_SYSTEM_SETTINGS: 12,
    Command.START_MEASUREMENT: 12,
    Command.STOP_MEASUREMENT: 12,
    Command.CHANGE_FACE: 12,
    Command.POINT_LASER: 36,
    Command.POINT_LASER_HVD: 36,
    Command.FIND_REFLECTOR: 20,
    Command.GET_DIRECTION: 12,
    Command.SET_STATISTIC_MODE: 20,
    Command.CHECK_BIRDBATH: 12,
    Command.GET_FACE: 12,
    Command.GET_PROBES: 12,
    Command.GET_MEASUREMENT_PROBE_INFO: 12,
    Command.SET_LONG_PARAMETER: 20,
    Command.GET_MEASUREMENT_STATUS_INFO: 12,
    Command.GET_TRACKER_INFO: 12,
    Command.GET_METEO_STATION_INFO: 12,
}
"""Bytes of each request by the emScon 3.6 header."""


def values_for(command: Command) -> list[int]:
    """As many values as the command takes."""
    n_left = REQUEST_SIZES[command] - 12
    for n in range(n_left // 4 + 1):
        try:
            if len(encode_request(command, *range(1, n + 1))) == REQUEST_SIZES[command]:
                return list(range(1, n + 1))
        except struct.error:
            continue
    raise AssertionError(f"no number of values fills {command}")


@pytest.mark.parametrize(("golden", "request_"), GOLDEN.items())
def test_requests_equal_golden_bytes(golden: str, request_: tuple):
    assert encode_request(*request_) == bytes.fromhex(golden)


def test_every_command_has_the_size_of_the_header_file():
    assert set(REQUEST_SIZES) == set(Command)
    for command, size in REQUEST_SIZES.items():
        data = encode_request(command, *values_for(command))
        assert len(data) == size, command
        assert struct.unpack_from("<iII", data) == (size, 0, command)


def cesapi_request(name: str, **values: object) -> bytes:
    """A request as CESAPI writes it; ``a__b`` is field b of the structure a."""
    packet = getattr(cesapi, name)()
    for key, value in values.items():
        *path, field = key.split("__")
        target = packet
        for step in path:
            target = getattr(target, step)
        assert hasattr(target, field), f"{name} has no {key}"
        setattr(target, field, value)
    return packet.pack()


PLAIN = {
    Command.GET_SYSTEM_STATUS: "GetSystemStatusCT",
    Command.GET_TRACKER_STATUS: "GetTrackerStatusCT",
    Command.INITIALIZE: "InitializeCT",
    Command.GET_ENVIRONMENT: "GetEnvironmentParamsCT",
    Command.GET_REFLECTOR: "GetReflectorCT",
    Command.GET_REFLECTORS: "GetReflectorsCT",
    Command.GET_SYSTEM_SETTINGS: "GetSystemSettingsCT",
    Command.START_MEASUREMENT: "StartMeasurementCT",
    Command.STOP_MEASUREMENT: "StopMeasurementCT",
    Command.CHANGE_FACE: "ChangeFaceCT",
    Command.GET_DIRECTION: "GetDirectionCT",
    Command.GET_FACE: "GetFaceCT",
    Command.GET_MEASUREMENT_STATUS_INFO: "GetMeasurementStatusInfoCT",
    Command.GET_TRACKER_INFO: "GetTrackerInfoCT",
    Command.GET_METEO_STATION_INFO: "GetMeteoStationInfoCT",
}

WITH_VALUES = [
    (
        (Command.SET_UNITS, 0, 1, 1, 4, 0),
        "SetUnitsCT",
        {
            "unitsSettings__lenUnitType": 0,
            "unitsSettings__angUnitType": 1,
            "unitsSettings__tempUnitType": 1,
            "unitsSettings__pressUnitType": 4,
            "unitsSettings__humUnitType": 0,
        },
    ),
    (
        (Command.SET_STATION_ORIENTATION, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
        "SetStationOrientationParamsCT",
        {
            f"stationOrientation__{k}": float(i + 1)
            for i, k in enumerate(["dVal1", "dVal2", "dVal3", "dRot1", "dRot2", "dRot3"])
        },
    ),
    (
        (Command.SET_TRANSFORMATION, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0),
        "SetTransformationParamsCT",
        {
            f"transformationData__{k}": float(i + 1)
            for i, k in enumerate(["dVal1", "dVal2", "dVal3", "dRot1", "dRot2", "dRot3", "dScale"])
        },
    ),
    (
        (Command.SET_ENVIRONMENT, 20.5, 987.5, 41.0),
        "SetEnvironmentParamsCT",
        {
            "environmentData__dTemperature": 20.5,
            "environmentData__dPressure": 987.5,
            "environmentData__dHumidity": 41.0,
        },
    ),
    ((Command.SET_MEASUREMENT_MODE, 0), "SetMeasurementModeCT", {"measMode": 0}),
    ((Command.SET_COORDINATE_SYSTEM_TYPE, 0), "SetCoordinateSystemTypeCT", {"coordSysType": 0}),
    (
        (Command.SET_STATIONARY_PARAMETERS, 100, 1),
        "SetStationaryModeParamsCT",
        {"stationaryModeData__lMeasTime": 100, "stationaryModeData__bUseADM": 1},
    ),
    ((Command.SET_REFLECTOR, 12), "SetReflectorCT", {"iInternalReflectorId": 12}),
    (
        (Command.SET_SEARCH_PARAMETERS, 0.05, 15000),
        "SetSearchParamsCT",
        {"searchParams__dSearchRadius": 0.05, "searchParams__lTimeOut": 15000},
    ),
    (
        (Command.SET_SYSTEM_SETTINGS, 2, 0, 0, 1, 1, 0, 0, 1, 1),
        "SetSystemSettingsCT",
        {
            "systemSettings__weatherMonitorStatus": 2,
            "systemSettings__bApplyTransformationParams": 0,
            "systemSettings__bApplyStationOrientationParams": 0,
            "systemSettings__bKeepLastPosition": 1,
            "systemSettings__bSendUnsolicitedMessages": 1,
            "systemSettings__bSendReflectorPositionData": 0,
            "systemSettings__bTryMeasurementMode": 0,
            "systemSettings__bHasNivel": 1,
            "systemSettings__bHasVideoCamera": 1,
        },
    ),
    (
        (Command.POINT_LASER, 1.5, -2.5, 3.25),
        "PointLaserCT",
        {"dVal1": 1.5, "dVal2": -2.5, "dVal3": 3.25},
    ),
    (
        (Command.POINT_LASER_HVD, 0.25, 1.5, 3.25),
        "PointLaserHVDCT",
        {"dHzAngle": 0.25, "dVtAngle": 1.5, "dDistance": 3.25},
    ),
    ((Command.FIND_REFLECTOR, 4.75), "FindReflectorCT", {"dAproxDistance": 4.75}),
    (
        (Command.SET_STATISTIC_MODE, 1, 0),
        "SetStatisticModeCT",
        {"stationaryMeasurements": 1, "continuousMeasurements": 0},
    ),
    (
        (Command.SET_LONG_PARAMETER, 52, 1),
        "SetLongSystemParamCT",
        {"systemParam": 52, "lParameter": 1},
    ),
]

NOT_IN_CESAPI = {
    Command.SET_CONTINUOUS_TIME_PARAMETERS,
    Command.CHECK_BIRDBATH,
    Command.GET_PROBES,
    Command.GET_MEASUREMENT_PROBE_INFO,
}
"""The T-MAC, continuous measurement and birdbath check are not in that package."""


@pytest.mark.parametrize(("command", "name"), PLAIN.items())
def test_request_without_values_equals_cesapis(command: Command, name: str):
    assert encode_request(command) == cesapi_request(name)


@pytest.mark.parametrize(("request_", "name", "values"), WITH_VALUES)
def test_request_with_values_equals_cesapis(request_: tuple, name: str, values: dict):
    assert encode_request(*request_) == cesapi_request(name, **values)


def test_every_request_is_held_to_cesapi_where_that_has_it():
    compared = set(PLAIN) | {request[0] for request, _, _ in WITH_VALUES}
    assert compared | NOT_IN_CESAPI == set(Command)
    assert not compared & NOT_IN_CESAPI


EVENT = bytes.fromhex("0c000000 08000000 1b000000")
BEAM_BROKEN = bytes.fromhex("10000000 01000000 40000000 bd020000")


def test_event_and_error_are_read_as_golden_bytes_say():
    buffer = PacketBuffer()
    buffer.feed(EVENT + BEAM_BROKEN)
    event, error = buffer.pop(), buffer.pop()
    assert event is not None
    assert error is not None
    assert (event.type, event.event) == (8, 27)
    assert (error.type, error.command, error.status) == (1, 64, 701)
    assert buffer.pop() is None


@settings(deadline=None)
@given(
    bodies=st.lists(st.binary(min_size=8, max_size=60), max_size=8),
    cuts=st.lists(st.integers(1, 30), max_size=80),
)
def test_packets_survive_any_split_of_the_stream(bodies: list[bytes], cuts: list[int]):
    sent = [struct.pack("<iI", 8 + len(body), i) + body for i, body in enumerate(bodies)]
    stream = b"".join(sent)
    buffer = PacketBuffer()
    received: list[bytes] = []
    for cut in [*cuts, len(stream)]:
        buffer.feed(stream[:cut])
        stream = stream[cut:]
        while (packet := buffer.pop()) is not None:
            received.append(packet.data)
    assert received == sent


@pytest.mark.parametrize("size", [-1, 0, 8, 11, 65537, 2**31 - 1])
@pytest.mark.parametrize("kind", [0, 1, 4, 8, 99])
def test_impossible_size_is_an_error(size: int, kind: int):
    buffer = PacketBuffer()
    buffer.feed(struct.pack("<iI", size, kind) + bytes(20))
    with pytest.raises(ValueError, match=f"^{size} is no size of a packet"):
        buffer.pop()


@pytest.mark.parametrize("kind", [0, 1])
def test_an_answer_needs_command_and_status(kind: int):
    buffer = PacketBuffer()
    buffer.feed(struct.pack("<iII", 12, kind, 7))
    with pytest.raises(ValueError, match="no size"):
        buffer.pop()
