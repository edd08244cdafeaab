"""The stream channel, received packet by packet."""

import struct
import threading
import time
from itertools import pairwise

import numpy as np
import pytest

from drivers.gige.simulator.features import ADDRESSES, Model
from drivers.gige.simulator.registers import Registers
from drivers.gige.simulator.scene import pattern
from drivers.gige.simulator.transmission import N_HELD
from tronlab.errors import DeviceFaultError, DeviceTimeoutError, NotConnectedError

MONO8, MONO12, MONO12_PACKED = 0x01080001, 0x01100005, 0x010C0006
ACCESS_DENIED, LOCAL_PROBLEM, UNAVAILABLE, RESENT = 0x8006, 0x8008, 0x800C, 0x0100
SCP, SCPS, SCPD = 0xD00, 0xD04, 0xD08
LARGEST_PACKET = 8228


def start(stream) -> None:
    stream.host.set(AcquisitionStart=1)


def stop(stream) -> None:
    stream.host.set(AcquisitionStop=1)


def trigger(stream) -> None:
    stream.host.set(TriggerSoftware=1)


def write_at_once(stream, **features: int) -> None:
    """Write features by one command; what follows ``_`` in a name only tells repetitions apart."""
    words = [
        word
        for name, value in features.items()
        for word in (ADDRESSES[name.partition("_")[0]], value)
    ]
    assert stream.host.ask(0x82, struct.pack(f">{len(words)}I", *words))[0] == 0


def shoot(stream):
    trigger(stream)
    return stream.frame()


def unpack(data: bytes, n_pixels: int) -> np.ndarray:
    """Unpack Mono12Packed pixel by pixel, as GigE Vision 1.2 shows it."""
    pixels = []
    for i in range(n_pixels):
        j = i // 2 * 3
        first = data[j] << 4 | data[j + 1] & 0xF
        pixels.append(first if i % 2 == 0 else data[j + 2] << 4 | data[j + 1] >> 4)
    return np.array(pixels, np.uint16)


def decoded(frame) -> np.ndarray:
    leader = frame.leader
    shape = leader["height"], leader["width"]
    match leader["pixel_format"]:
        case 0x01080001:
            return np.frombuffer(frame.data, np.uint8).reshape(shape)
        case 0x01100005:
            return np.frombuffer(frame.data, "<u2").reshape(shape)
        case _:
            return unpack(frame.data, shape[0] * shape[1]).reshape(shape)


# --- frames ---


@pytest.mark.parametrize(
    ("pixel_format", "name"),
    [(MONO8, "Mono8"), (MONO12, "Mono12"), (MONO12_PACKED, "Mono12Packed")],
)
@pytest.mark.parametrize(("width", "height"), [(64, 48), (33, 47), (1, 1)])
def test_frames_are_bit_exact(small, pixel_format, name, width, height):
    small.host.set(PixelFormat=pixel_format, Width=width, Height=height)
    start(small)
    for block_id in (1, 2, 3):
        frame = shoot(small)
        assert frame.block_id == block_id
        assert not frame.missing
        assert len(frame.data) == small.host.get("PayloadSize")
        np.testing.assert_array_equal(decoded(frame), pattern(block_id, width, height, name))


def test_a_packet_is_as_large_as_asked_but_the_last(small):
    small.host.write(SCPS, 576)
    start(small)
    frame = shoot(small)
    sizes = [len(packet.data) for _, packet in sorted(frame.packets.items())]
    assert sizes[1:-1] == [540] * 5 + [64 * 48 - 5 * 540]
    assert [packet.format for _, packet in sorted(frame.packets.items())] == [1, *[3] * 6, 2]


def test_the_leader_describes_the_image(small):
    small.host.set(OffsetX=100, OffsetY=200, PixelFormat=MONO12)
    start(small)
    first, second = shoot(small), shoot(small)
    leader = first.leader
    assert leader.pop("timestamp") < second.leader["timestamp"]
    assert leader == {
        "payload_type": 1,
        "pixel_format": MONO12,
        "width": 64,
        "height": 48,
        "left": 100,
        "top": 200,
        "pad_x": 0,
        "pad_y": 0,
    }
    trailer = first.packets[max(first.packets)]
    assert trailer.data == struct.pack(">HHI", 0, 1, 48)


def test_the_time_stamp_is_of_the_camera_clock(small):
    start(small)
    frame = shoot(small)
    small.host.write(0x944, 2)
    latched = small.host.read(0x948) << 32 | small.host.read(0x94C)
    assert 0 < frame.leader["timestamp"] < latched


def test_block_ids_leave_out_zero(camera, hosts, streams, triggered):
    stream = triggered(streams(hosts(camera(first_block_id=65534)).take_control()))
    start(stream)
    assert [shoot(stream).block_id for _ in range(4)] == [65534, 65535, 1, 2]


def lowbias32(x: int) -> int:
    x = (x ^ x >> 16) * 0x7FEB352D & 0xFFFFFFFF
    x = (x ^ x >> 15) * 0x846CA68B & 0xFFFFFFFF
    return x ^ x >> 16


def test_patterns_differ_from_block_to_block():
    images = [pattern(n, 64, 48, "Mono12") for n in (1, 2, 3, 65535)]
    for one, other in pairwise(images):
        assert np.mean(one != other) > 0.99
    np.testing.assert_array_equal(pattern(7, 64, 48, "Mono8"), pattern(7, 64, 48, "Mono12") >> 4)
    expected = [lowbias32(i + 3 * 40503 % 65536) >> 20 for i in range(64)]
    assert pattern(3, 64, 1, "Mono12")[0].tolist() == expected


# --- acquisition ---


def test_modes_of_acquisition(small):
    small.host.set(TriggerMode=0, AcquisitionFrameRateAbs=1_000_000, AcquisitionMode=2)
    start(small)
    assert small.frame().block_id == 1
    small.expect_silence()
    small.host.set(AcquisitionMode=3, AcquisitionFrameCount=3)
    start(small)
    assert [small.frame().block_id for _ in range(3)] == [1, 2, 3]
    small.expect_silence()
    small.host.set(AcquisitionMode=1)
    start(small)
    assert [small.frame().block_id for _ in range(5)] == [1, 2, 3, 4, 5]


@pytest.mark.parametrize("source", [0, 5])
def test_freerun_and_fixed_rate_need_no_trigger(small, source):
    small.host.set(TriggerSource=source, AcquisitionFrameRateAbs=1_000_000)
    start(small)
    assert [small.frame().block_id for _ in range(3)] == [1, 2, 3]


@pytest.mark.parametrize(
    ("features", "period_s"),
    [
        ({"TriggerMode": 0, "TriggerSource": 6}, 0.02),
        ({"TriggerMode": 1, "TriggerSource": 5}, 0.02),
        ({"TriggerMode": 1, "TriggerSource": 0}, 0.0),
    ],
)
def test_the_source_of_the_trigger_decides_on_the_rate(features, period_s):
    registers = Registers(Model(), host="127.0.0.1", source_port=1)
    for name, value in {"AcquisitionFrameRateAbs": 50_000, **features}.items():
        registers.write(ADDRESSES[name], value, is_acquiring=False)
    assert registers.settings().period_s == period_s
    assert not registers.settings().waits_for_trigger


def test_each_software_trigger_gives_one_frame(small):
    start(small)
    small.expect_silence()
    assert [shoot(small).block_id for _ in range(3)] == [1, 2, 3]
    small.expect_silence()


def test_hardware_lines_are_not_wired(small):
    small.host.set(TriggerSource=1)
    start(small)
    trigger(small)
    small.expect_silence()


def test_a_trigger_before_the_start_is_lost(small):
    trigger(small)
    start(small)
    small.expect_silence()
    assert shoot(small).block_id == 1


@pytest.mark.parametrize(("overlap", "n_frames"), [(0, 1), (1, 2)])
def test_a_trigger_during_an_exposure(small, overlap, n_frames):
    small.host.set(ExposureTimeAbs=200_000, TriggerOverlap=overlap)
    start(small)
    write_at_once(small, TriggerSoftware=1, TriggerSoftware_again=1)
    assert [small.frame().block_id for _ in range(n_frames)] == [*range(1, n_frames + 1)]
    with pytest.raises(TimeoutError):
        small.datagram(timeout_s=0.5)


def test_settings_count_from_the_next_exposure_on(small):
    start(small)
    shoot(small)
    small.host.set(OffsetX=5, GainRaw=3)
    assert shoot(small).leader["left"] == 5


@pytest.mark.parametrize("feature", ["Width", "Height", "PixelFormat", "AcquisitionMode"])
def test_what_a_host_relies_on_is_locked_during_acquisition(small, feature):
    value = small.host.get(feature)
    start(small)
    assert small.host.try_set(feature, value) == ACCESS_DENIED
    stop(small)
    small.host.set(**{feature: value})


def test_stop_lets_the_exposure_end_and_abort_does_not(small):
    small.host.set(ExposureTimeAbs=200_000)
    start(small)
    write_at_once(small, TriggerSoftware=1, AcquisitionStop=1)
    assert small.frame().block_id == 1
    start(small)
    write_at_once(small, TriggerSoftware=1, AcquisitionAbort=1)
    with pytest.raises(TimeoutError):
        small.datagram(timeout_s=0.5)


def test_no_frame_of_the_last_acquisition_comes_in_the_next(small, streams):
    """Frames wait in the camera when the stream is slower than the exposures."""
    host = small.host
    host.set(TriggerMode=0, AcquisitionFrameRateAbs=10_000_000, StreamBytesPerSecond=1_000_000)
    stream = small
    for pixel_format in (MONO8, MONO12) * 4:
        host.set(PixelFormat=pixel_format)
        start(stream)
        frames = [stream.frame() for _ in range(3)]
        assert [frame.leader["pixel_format"] for frame in frames] == [pixel_format] * 3
        assert [frame.block_id for frame in frames] == [1, 2, 3]
        stop(stream)
        stream = streams(host)


def test_without_a_stream_channel_nothing_is_sent(small):
    start(small)
    small.host.write(SCP, 0)
    trigger(small)
    small.expect_silence()


def test_a_frame_needs_as_long_as_the_bandwidth_allows(small):
    small.host.set(Width=400, Height=1000, StreamBytesPerSecond=1_000_000)
    start(small)
    begin_s = time.monotonic()
    frame = shoot(small)
    assert time.monotonic() - begin_s > 0.38
    np.testing.assert_array_equal(decoded(frame), pattern(1, 400, 1000, "Mono8"))


def test_a_packet_delay_holds_the_stream_back(small):
    small.host.write(SCPD, 36_858_974 // 100)
    small.host.set(Height=1000, BandwidthControlMode=1)
    start(small)
    begin_s = time.monotonic()
    assert len(shoot(small).packets) == 46
    assert time.monotonic() - begin_s > 0.4


def test_a_long_packet_delay_keeps_nobody_waiting(small):
    small.host.write(SCPD, 0xFFFFFFFF)
    small.host.set(BandwidthControlMode=2)
    start(small)
    trigger(small)
    assert small.packet().format == 1
    stop(small)
    small.host.set(BandwidthControlMode=0)
    start(small)
    assert {packet.block_id for packet in shoot(small).packets.values()} == {1}
    small.host.set(BandwidthControlMode=1)
    trigger(small)  # and closing the camera does not wait either


# --- resend ---


def resent(stream, block_id: int, first: int, last: int, n: int) -> list:
    stream.host.ask_again(block_id, first, last)
    return [stream.packet() for _ in range(n)]


def test_leader_payload_and_trailer_are_sent_again(small):
    start(small)
    frame = shoot(small)
    again = resent(small, 1, 0, 0xFFFFFF, len(frame.packets))
    assert [packet.packet_id for packet in again] == sorted(frame.packets)
    for packet in again:
        original = frame.packets[packet.packet_id]
        assert packet.status == RESENT
        assert (packet.format, packet.data) == (original.format, original.data)
    assert [packet.packet_id for packet in resent(small, 1, 2, 3, 2)] == [2, 3]
    small.expect_silence()


def test_a_frame_is_held_only_for_a_while(small):
    start(small)
    for _ in range(N_HELD + 1):
        shoot(small)
    gone = resent(small, 1, 1, 3, 3)
    assert [(packet.status, packet.block_id, packet.packet_id) for packet in gone] == [
        (UNAVAILABLE, 1, i) for i in (1, 2, 3)
    ]
    (held,) = resent(small, 2, 1, 1, 1)
    assert held.status == RESENT


def test_packets_that_never_were_are_unavailable(small):
    start(small)
    last = max(shoot(small).packets)
    (beyond,) = resent(small, 1, last + 1, last + 5, 1)
    assert (beyond.status, beyond.packet_id, beyond.data) == (UNAVAILABLE, last + 1, b"")
    small.host.ask_again(999, 0, 0xFFFFFF)
    assert small.packet().status == UNAVAILABLE


def test_only_the_host_in_control_is_answered(small, hosts):
    start(small)
    shoot(small)
    hosts(small.host.camera, ip="127.0.0.2").ask_again(1, 0, 2)
    small.host.ask_again(1, 0, 2, channel=1)
    small.host.ask_again(1, 2, 1)
    small.host.send(0x40, bytes(8), flags=0)
    small.expect_silence()
    other_port = hosts(small.host.camera)
    other_port.ask_again(1, 1, 1)
    assert small.packet().status == RESENT


# --- test packet ---


@pytest.mark.parametrize("size", [576, 1500, LARGEST_PACKET])
def test_a_test_packet_has_the_size_asked_for(small, size):
    small.host.write(SCPS, 1 << 31 | 1 << 30 | size)
    assert len(small.datagram()) == size - 28
    assert small.host.read(SCPS) == 1 << 30 | size


def test_no_test_packet_without_a_channel(small):
    small.host.write(SCP, 0)
    small.host.write(SCPS, 1 << 31 | 1500)
    small.expect_silence()


# --- faults ---


def test_fault_lose_packets_is_mended_by_resend(small, faults):
    faults.arm("camera.lose_packets")
    small.host.set(Width=1360, Height=600)
    small.host.write(SCPS, 576)
    start(small)
    frame = shoot(small)
    missing = sorted(frame.missing)
    assert 0 < len(missing) < 100
    for packet_id in missing:
        (frame.packets[packet_id],) = resent(small, 1, packet_id, packet_id, 1)
    np.testing.assert_array_equal(decoded(frame), pattern(1, 1360, 600, "Mono8"))
    assert small.host.camera.statistics.n_packets_lost == len(missing)
    assert small.host.camera.statistics.n_packets_resent == len(missing)


def test_fault_lose_frame(small, faults):
    start(small)
    shoot(small)
    faults.arm("camera.lose_frame", times=1)
    trigger(small)
    small.expect_silence()
    assert resent(small, 2, 0, 0, 1)[0].status == UNAVAILABLE
    assert shoot(small).block_id == 3


def test_fault_incomplete(small, faults):
    faults.arm("camera.incomplete", times=1)
    small.host.set(Height=1000)
    start(small)
    missing = sorted(shoot(small).missing)
    assert missing
    assert {resent(small, 1, i, i, 1)[0].status for i in missing} == {UNAVAILABLE}
    assert not shoot(small).missing


def test_fault_gone_ends_the_stream(small, faults):
    start(small)
    shoot(small)
    faults.arm("camera.gone")
    small.host.send(0x82, struct.pack(">II", ADDRESSES["TriggerSoftware"], 1))
    small.expect_silence()
    faults.arm("camera.gone", times=0)
    assert small.host.try_set("TriggerSoftware", 1) == ACCESS_DENIED


def test_fault_ignores_trigger(small, faults):
    start(small)
    faults.arm("camera.ignores_trigger", times=1)
    trigger(small)
    small.expect_silence()
    assert shoot(small).block_id == 1


def test_fault_bad_packets(small, faults):
    faults.arm("camera.bad_packets")
    start(small)
    trigger(small)
    good, n_bad = {}, 0
    while True:
        datagram = small.datagram()
        is_good = len(datagram) > 8 and datagram[:2] == b"\0\0"
        kind, packet_id = datagram[4:5], int.from_bytes(datagram[5:8])
        is_good = is_good and kind in {b"\1", b"\2", b"\3"} and packet_id < 1000
        if not is_good or (kind == b"\1" and len(datagram) != 44):
            n_bad += 1
            continue
        good[packet_id] = datagram
        if kind == b"\2":
            break
    assert n_bad >= 6
    assert len(good) == 5


# --- scripted faults and the scene ---


class Script:
    """Raises what it is told at each trigger."""

    def __init__(self, *errors: Exception | None) -> None:
        self.errors = list(errors)

    def __call__(self) -> None:
        error = self.errors.pop(0)
        if error is not None:
            raise error


def test_scripted_faults_strike_at_the_trigger(camera, hosts, streams, triggered):
    script = Script(
        None,
        DeviceTimeoutError("grab: no answer", device="camera"),
        DeviceFaultError("grab: a fault", device="camera", code=900),
        None,
    )
    stream = triggered(streams(hosts(camera(on_trigger=script)).take_control()))
    start(stream)
    assert shoot(stream).block_id == 1
    trigger(stream)
    stream.expect_silence()
    assert stream.host.try_set("TriggerSoftware", 1) == LOCAL_PROBLEM
    stream.expect_silence()
    assert shoot(stream).block_id == 2
    assert script.errors == []


class Watcher:
    """A scene that notes how it is looked at, and cannot always be seen."""

    def __init__(self) -> None:
        self.exposures = []
        self.is_blind = False

    def image(self, exposure):
        self.exposures.append((exposure, time.monotonic()))
        if self.is_blind:
            raise NotConnectedError("read: the world has ended", device="simulated world")
        region = exposure.region
        return np.full((region.height_px, region.width_px), 3000, np.uint16)


def test_the_scene_is_seen_in_mid_exposure(camera, hosts, streams, triggered):
    scene = Watcher()
    stream = triggered(streams(hosts(camera(scene=scene)).take_control()))
    stream.host.set(ExposureTimeAbs=400_000, GainRaw=6, OffsetX=7, PixelFormat=MONO12_PACKED)
    start(stream)
    begin_s = time.monotonic()
    frame = shoot(stream)
    end_s = time.monotonic()
    ((exposure, seen_s),) = scene.exposures
    assert seen_s - begin_s > 0.19
    assert end_s - begin_s > 0.39
    assert (exposure.exposure_s, exposure.gain_db, exposure.pixel_format) == (0.4, 6.0, "Mono12")
    assert exposure.region.left_px == 7
    assert set(decoded(frame).ravel()) == {3000}


def test_a_scene_that_cannot_be_seen_gives_no_frame(camera, hosts, streams, triggered, caplog):
    scene = Watcher()
    stream = triggered(streams(hosts(camera(scene=scene)).take_control()))
    start(stream)
    scene.is_blind = True
    trigger(stream)
    stream.expect_silence()
    assert "the world has ended" in caplog.text
    scene.is_blind = False
    assert shoot(stream).block_id == 2


def test_read_out_takes_its_time(camera, hosts, streams, triggered):
    stream = triggered(streams(hosts(camera(model=Model(readout_s=0.3))).take_control()))
    start(stream)
    begin_s = time.monotonic()
    shoot(stream)
    assert time.monotonic() - begin_s > 0.3


# --- speed ---


@pytest.mark.parametrize("options", [{}, {"uses_segmentation_offload": True}])
def test_full_frames_as_fast_as_possible_are_bit_exact(camera, hosts, streams, options):
    server = camera(is_unthrottled=True, **options)
    stream = streams(hosts(server).take_control(), packet_bytes=LARGEST_PACKET)
    stream.host.set(ExposureTimeAbs=10, TriggerMode=0, AcquisitionFrameRateAbs=10_000_000)
    stream.host.set(AcquisitionMode=2)
    for _ in range(3):
        start(stream)
        np.testing.assert_array_equal(decoded(stream.frame()), pattern(1, 1360, 1024, "Mono8"))


def test_nothing_is_left_after_close(camera):
    before = set(threading.enumerate())
    server = camera()
    assert len(set(threading.enumerate()) - before) == 3
    server.close()
    server.close()
    assert set(threading.enumerate()) <= before
    camera(port=server.address[1]).close()
