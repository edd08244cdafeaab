"""Reading replies and results: sizes of the header file, CESAPI's packets, literal offsets."""

import struct

import pytest
from CESAPI import packet as cesapi

from drivers.leica import replies, results
from drivers.leica.packets import PacketBuffer
from drivers.leica.results import decode_stream
from drivers.leica.wire import decode, size_of

PACKET_SIZES = {
    replies.Number: 20,
    replies.Direction: 32,
    replies.SystemStatus: 56,
    replies.SystemSettings: 52,
    replies.TrackerInfo: 164,
    replies.ReflectorType: 100,
    replies.Probe: 356,
    replies.ProbeInfo: 72,
    replies.MeasurementStatus: 24,
    replies.Environment: 40,
    replies.MeteoStation: 92,
    replies.BirdbathCheck: 64,
}
"""Bytes of each reply by the emScon 3.6 header, 16 of them before the body."""


@pytest.mark.parametrize(("layout", "size"), PACKET_SIZES.items())
def test_replies_have_the_sizes_of_the_header_file(layout: type, size: int):
    assert size_of(layout) == size - 16


@pytest.mark.parametrize(
    ("layout", "size"),
    [
        (results.PointResult, 156 - 12),
        (results.ExtendedPointResult, 204 - 12),
        (results.PoseResult, 376 - 12),
        (results.StreamHead, 68 - 12),
        (results.StreamedPose, 212),
    ],
)
def test_results_have_the_sizes_of_the_header_file(layout: type, size: int):
    assert size_of(layout) == size


def body_of(packet: bytes) -> bytes:
    buffer = PacketBuffer()
    buffer.feed(packet)
    whole = buffer.pop()
    assert whole is not None
    assert whole.status == 0
    return whole.body


def numbered(packet: object, *, skip: tuple[str, ...] = ("packet", "packetInfo")) -> list[str]:
    """Fill every plain field of a CESAPI packet with another number; give their names."""
    names = [name for name in vars(packet) if not name.startswith("_") and name not in skip]
    for i, name in enumerate(names):
        kind = type(getattr(packet, name))
        setattr(packet, name, kind(i + 1))
    return names


def flat(value: object) -> list[object]:
    if isinstance(value, tuple):
        return [part for item in value for part in flat(item)]
    return [value]


def fields_of(decoded: object) -> list[object]:
    return [v for name in decoded.__dataclass_fields__ for v in flat(getattr(decoded, name))]


@pytest.mark.parametrize(
    ("name", "layout"),
    [
        ("SingleMeasResultT", results.PointResult),
        ("SingleMeasResult2T", results.ExtendedPointResult),
        ("GetMeasurementStatusInfoRT", replies.MeasurementStatus),
        ("GetTrackerStatusRT", replies.Number),
        ("GetReflectorRT", replies.Number),
        ("GetFaceRT", replies.Number),
        ("GetDirectionRT", replies.Direction),
    ],
)
def test_every_field_of_cesapis_packet_arrives_in_order(name: str, layout: type):
    packet = getattr(cesapi, name)()
    n = len(numbered(packet))
    decoded = decode(layout, body_of(packet.pack()))
    assert fields_of(decoded) == [i + 1 for i in range(n)]


def test_point_of_cesapi_arrives_where_it_belongs():
    packet = cesapi.SingleMeasResult2T()
    packet.dVal1, packet.dVal2, packet.dVal3 = 1.5, -2.5, 3.5
    packet.dStd1, packet.dStd2, packet.dStd3 = 1e-5, 2e-5, 3e-5
    packet.dCovar12, packet.dCovar13, packet.dCovar23 = 1e-11, 2e-11, 3e-11
    packet.dTemperature, packet.dPressure, packet.dHumidity = 21.0, 987.0, 44.0
    result = decode(results.ExtendedPointResult, body_of(packet.pack()))
    assert result.position == (1.5, -2.5, 3.5)
    assert result.std == (1e-5, 2e-5, 3e-5)
    assert result.covariance == (1e-11, 2e-11, 3e-11)
    assert (result.temperature, result.pressure, result.humidity) == (21.0, 987.0, 44.0)


def test_environment_and_settings_of_cesapi():
    environment = cesapi.GetEnvironmentParamsRT()
    environment.environmentData.dTemperature = 21.5
    environment.environmentData.dPressure = 1001.25
    environment.environmentData.dHumidity = 43.0
    assert decode(replies.Environment, body_of(environment.pack())) == replies.Environment(
        temperature_c=21.5, pressure_mbar=1001.25, humidity_pct=43.0
    )
    settings = cesapi.GetSystemSettingsRT()
    settings.systemSettings.weatherMonitorStatus = 2
    settings.systemSettings.bKeepLastPosition = 1
    settings.systemSettings.bHasNivel = 1
    decoded = decode(replies.SystemSettings, body_of(settings.pack()))
    assert decoded == replies.SystemSettings(2, 0, 0, 1, 0, 0, 0, 1, 0)


def test_system_status_of_cesapi():
    packet = cesapi.GetSystemStatusRT()
    packet.trackerProcessorStatus, packet.laserStatus, packet.admStatus = 5, 3, 2
    version = packet.esVersionNumber
    version.iMajorVersionNumber, version.iMinorVersionNumber, version.iBuildNumber = 3, 6, 412
    packet.weatherMonitorStatus, packet.lTrackerSerialNumber = 2, 4711
    status = decode(replies.SystemStatus, body_of(packet.pack()))
    assert (status.processor, status.laser, status.adm) == (5, 3, 2)
    assert status.version == "3.6.412"
    assert (status.weather_monitor, status.serial) == (2, 4711)


def poke(packet: bytearray, offset: int, code: str, *values: object) -> None:
    struct.pack_into("<" + code, packet, offset, *values)


def wide(text: str, units: int) -> bytes:
    return text.encode("utf-16-le").ljust(2 * units, b"\0")


def test_reflector_type_by_offsets():
    packet = bytearray(100)
    poke(packet, 0, "iIII", 100, 0, 42, 0)
    poke(packet, 16, "iiI", 9, 7, 1)
    poke(packet, 28, "d", 0.01905)
    packet[36:100] = wide("CCR-1.5in", 32)
    assert decode(replies.ReflectorType, body_of(bytes(packet))) == replies.ReflectorType(
        n_all=9, id=7, target_type=1, surface_offset_m=0.01905, name="CCR-1.5in"
    )


def test_tracker_info_by_offsets():
    packet = bytearray(164)
    poke(packet, 0, "iIII", 164, 0, 132, 0)
    poke(packet, 16, "I", 14)
    packet[20:84] = wide("AT901-MR", 32)
    poke(packet, 84, "i", 2345)
    poke(packet, 104, "dddi", 0.5, 18.0, 1.5, 1000)
    poke(packet, 132, "i", 2)
    poke(packet, 136, "dd", 6.28, 1.57)
    poke(packet, 156, "ii", 2, 19)
    info = decode(replies.TrackerInfo, body_of(bytes(packet)))
    assert (info.sensor_type, info.name, info.serial) == (14, "AT901-MR", 2345)
    assert (info.nivel_offset, info.max_distance_m, info.min_distance_m) == (0.5, 18.0, 1.5)
    assert (info.max_rate, info.n_faces) == (1000, 2)
    assert (info.hz_range_rad, info.vt_range_rad) == (6.28, 1.57)
    assert (info.firmware_major, info.firmware_minor) == (2, 19)


def test_probe_and_probe_info_by_offsets():
    packet = bytearray(356)
    poke(packet, 0, "iIII", 356, 0, 103, 0)
    poke(packet, 16, "iiiIi", 1, 3, 877, 5, 4)
    packet[36:100] = wide("T-MAC", 32)
    packet[100:356] = wide("on the robot", 128)
    assert decode(replies.Probe, body_of(bytes(packet))) == replies.Probe(
        n_all=1, id=3, serial=877, probe_type=5, n_fields=4, name="T-MAC", comment="on the robot"
    )
    packet = bytearray(72)
    poke(packet, 0, "iIII", 72, 0, 119, 0)
    poke(packet, 16, "iiiIii", 1, 7, 877, 4, 11, 2)
    info = decode(replies.ProbeInfo, body_of(bytes(packet)))
    assert (info.firmware_major, info.firmware_minor, info.serial) == (1, 7, 877)
    assert (info.probe_type, info.compensation_id, info.active_field) == (4, 11, 2)


def test_weather_station_and_birdbath_by_offsets():
    packet = bytearray(92)
    poke(packet, 0, "iIII", 92, 0, 139, 0)
    poke(packet, 16, "I", 1)
    packet[20:84] = wide("Thommen", 32)
    station = decode(replies.MeteoStation, body_of(bytes(packet)))
    assert (station.station_type, station.identifier) == (1, "Thommen")
    packet = bytearray(64)
    poke(packet, 0, "iIII", 64, 0, 87, 0)
    poke(packet, 16, "6d", 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    check = decode(replies.BirdbathCheck, body_of(bytes(packet)))
    assert (check.initial_hvd, check.difference_hvd) == ((1.0, 2.0, 3.0), (4.0, 5.0, 6.0))


def test_stationary_pose_by_offsets():
    packet = bytearray(376)
    poke(packet, 0, "iII", 376, 4, 0)
    poke(packet, 12, "I", 6)
    poke(packet, 24, "i", 0x0001)
    poke(packet, 28, "ii", 3, 2)
    poke(packet, 48, "3d", 1.25, -2.5, 0.75)
    poke(packet, 72, "3d", 1e-5, 2e-5, 3e-5)
    poke(packet, 104, "3d", 1e-11, 2e-11, 3e-11)
    poke(packet, 128, "3d", 7.0, 8.0, 9.0)
    poke(packet, 184, "4d", 0.5, -0.5, 0.5, -0.5)
    poke(packet, 216, "3d", 0.1, 0.2, 0.3)
    poke(packet, 240, "3d", 1e-4, 2e-4, 3e-4)
    poke(packet, 272, "3d", 1e-9, 2e-9, 3e-9)
    poke(packet, 352, "3d", 21.0, 987.0, 44.0)
    result = decode(results.PoseResult, body_of(bytes(packet)))
    assert (result.mode, result.rotation_status, result.probe_id, result.field) == (6, 1, 3, 2)
    assert result.position == (1.25, -2.5, 0.75)
    assert result.std == (1e-5, 2e-5, 3e-5)
    assert result.covariance == (1e-11, 2e-11, 3e-11)
    assert result.a_priori_std == (7.0, 8.0, 9.0)
    assert result.quaternion == (0.5, -0.5, 0.5, -0.5)
    assert result.angles == (0.1, 0.2, 0.3)
    assert result.angle_std == (1e-4, 2e-4, 3e-4)
    assert result.angle_covariance == (1e-9, 2e-9, 3e-9)
    assert result.environment == replies.Environment(21.0, 987.0, 44.0)


def stream_packet(n: int) -> bytearray:
    packet = bytearray(68 + 212 * n)
    poke(packet, 0, "iIIi", len(packet), 5, 0, n)
    for i in range(n):
        start = 68 + 212 * i
        poke(packet, start, "IIiii", 0, 0, 1, 100 + i, 250_000)
        poke(packet, start + 20, "3d", 1.0 + i, 2.0, 3.0)
        poke(packet, start + 44, "3d", 1e-5, 2e-5, 3e-5)
        poke(packet, start + 76, "3d", 1e-11, 2e-11, 3e-11)
        poke(packet, start + 100, "4d", 1.0, 0.0, 0.0, 0.0)
        poke(packet, start + 156, "3d", 1e-4, 2e-4, 3e-4)
        poke(packet, start + 188, "3d", 1e-9, 2e-9, 3e-9)
    return packet


def test_stream_of_poses_by_offsets():
    poses = decode_stream(body_of(bytes(stream_packet(3))))
    assert [pose.position for pose in poses] == [(1.0 + i, 2.0, 3.0) for i in range(3)]
    assert [(pose.time_s, pose.time_us) for pose in poses] == [(100 + i, 250_000) for i in range(3)]
    assert {pose.quaternion for pose in poses} == {(1.0, 0.0, 0.0, 0.0)}
    assert {pose.angle_std for pose in poses} == {(1e-4, 2e-4, 3e-4)}
    assert {pose.angle_covariance for pose in poses} == {(1e-9, 2e-9, 3e-9)}
    assert {pose.rotation_status for pose in poses} == {1}


@pytest.mark.parametrize("stated", [-1, 0, 1, 4])
def test_stream_packet_whose_count_does_not_fit_is_an_error(stated: int):
    packet = stream_packet(3)
    poke(packet, 12, "i", stated)
    with pytest.raises(ValueError, match=f"{stated} poses stated"):
        decode_stream(body_of(bytes(packet)))


@pytest.mark.parametrize("n_bytes", [0, 39, 41])
def test_reply_of_another_size_is_an_error(n_bytes: int):
    with pytest.raises(ValueError, match="SystemStatus takes 40 bytes"):
        decode(replies.SystemStatus, bytes(n_bytes))


def test_text_that_is_none_is_an_error():
    body = bytearray(size_of(replies.ReflectorType))
    body[20:22] = b"\x00\xd8"  # half of a surrogate pair
    with pytest.raises(ValueError, match="utf-16"):
        decode(replies.ReflectorType, bytes(body))
