"""Streams, buffers, events and the loss of a camera, through the C interface."""

import ctypes
import struct
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest


def wait_until(is_true: Callable[[], bool]) -> None:
    end = time.monotonic() + 10
    while not is_true():
        assert time.monotonic() < end, "it never became true"
        time.sleep(0.005)


def n_threads() -> int:
    return len(list(Path("/proc/self/task").iterdir()))


def test_frames_arrive_with_all_that_the_camera_tells(bench: Any) -> None:
    camera = bench.camera()
    stream = bench.stream(bench.device(camera))
    for packet in camera.packets(7, ticks=2**40 + 5, fill=50):
        camera.send(packet)
    frame = stream.next_frame()
    assert frame == {
        "id": 7,
        "is_incomplete": 0,
        "ticks": 2**40 + 5,
        "filled": 800,
        "width": 40,
        "lines": 20,
        "bytes": b"".join(bytes([50 + i]) * 100 for i in range(8)),
    }
    assert camera.requested() == []


def test_block_ids_wrap_past_zero(bench: Any) -> None:
    camera = bench.camera()
    stream = bench.stream(bench.device(camera))
    for block_id in (65534, 65535, 1, 2):
        for packet in camera.packets(block_id):
            camera.send(packet)
        frame = stream.next_frame()
        assert (frame["id"], frame["is_incomplete"]) == (block_id, 0)


def test_missing_packets_are_asked_for_on_the_wire(bench: Any) -> None:
    camera = bench.camera()
    stream = bench.stream(bench.device(camera))
    packets = camera.packets(3)
    for packet in packets[:2] + packets[5:]:
        camera.send(packet)
    wait_until(lambda: bool(camera.requested()))
    assert camera.requested()[0] == (3, 2, 4)
    assert camera.flags_of(0x40) == {0}  # the packets are the answer, no acknowledge is asked for
    for packet in packets[2:5]:
        camera.send(packet)
    assert stream.next_frame()["is_incomplete"] == 0


def test_packets_that_the_camera_no_longer_holds_make_the_frame_incomplete(bench: Any) -> None:
    camera = bench.camera()
    stream = bench.stream(bench.device(camera))
    packets = camera.packets(3)
    for packet in packets[:4] + packets[5:]:
        camera.send(packet)
    wait_until(lambda: bool(camera.requested()))
    camera.send_error(3, 4, 0x800C)
    frame = stream.next_frame()
    assert (frame["is_incomplete"], frame["filled"]) == (1, 700)
    assert len(camera.requested()) == 1


def test_a_stranger_s_packets_are_passed_over(bench: Any) -> None:
    camera = bench.camera()
    stream = bench.stream(bench.device(camera))
    for packet in camera.packets(1, fill=100):
        camera.send(packet, source="127.0.0.9")
    for packet in camera.packets(1, fill=7):
        camera.send(packet)
    assert stream.next_frame()["bytes"][0] == 7


def test_garbage_between_the_packets_harms_nothing(bench: Any) -> None:
    camera = bench.camera()
    stream = bench.stream(bench.device(camera))
    for packet in camera.packets(1):
        for garbage in (b"", b"\0" * 7, b"\xff" * 60, packet[:9], packet + b"\0" * 500):
            camera.send(garbage)
        camera.send(packet)
    assert stream.next_frame()["is_incomplete"] == 0


def test_streams_of_two_cameras_are_apart(bench: Any) -> None:
    cameras = [bench.camera(), bench.camera()]
    streams = [bench.stream(bench.device(camera)) for camera in cameras]
    for one, other in zip(
        cameras[0].packets(5, fill=1), cameras[1].packets(5, fill=60), strict=True
    ):
        cameras[0].send(one)
        cameras[1].send(other)
    assert streams[0].next_frame()["bytes"][0] == 1
    assert streams[1].next_frame()["bytes"][0] == 60


def test_counts_are_kept_over_acquisitions(bench: Any) -> None:
    camera = bench.camera()
    stream = bench.stream(bench.device(camera), n_buffers=1)
    library = bench.library
    for packet in camera.packets(1):
        camera.send(packet)
    library.wait_buffer(stream.event)  # and the only buffer is kept
    for packet in camera.packets(2) + camera.packets(9):
        camera.send(packet)
    wait_until(lambda: library.number("DSGetInfo", stream.handle, 2) == 2)
    library("DSStopAcquisition", stream.handle, 0)
    assert library.number("DSGetInfo", stream.handle, 1) == 1
    assert library.number("DSGetInfo", stream.handle, 2) == 2
    assert library.number("DSGetInfo", stream.handle, 6) == 3
    registers = struct.unpack(
        "<7Q", b"".join(library.read(stream.handle, 8 * i, 8) for i in range(7))
    )
    delivered, lost, incomplete, underruns, requested, refused, malformed = registers
    assert (delivered, lost, underruns) == (1, 8, 2)  # 6 skipped
    assert (incomplete, requested, refused, malformed) == (0, 0, 0, 0)


def test_the_stream_channel_is_closed_at_the_end(bench: Any) -> None:
    camera = bench.camera()
    stream = bench.stream(bench.device(camera))
    assert camera.get(0xD18) == 0x7F000001
    assert camera.get(0xD00) != 0
    with pytest.raises(RuntimeError, match="RESOURCE_IN_USE"):
        bench.library("DSStartAcquisition", stream.handle, 0, ctypes.c_uint64(1))
    bench.library("DSStopAcquisition", stream.handle, 0)
    assert camera.get(0xD00) == 0
    with pytest.raises(RuntimeError, match="RESOURCE_IN_USE"):
        bench.library("DSStopAcquisition", stream.handle, 0)


def test_only_so_many_frames_as_asked_for(bench: Any) -> None:
    camera = bench.camera()
    stream = bench.stream(bench.device(camera))
    bench.library("DSStopAcquisition", stream.handle, 0)
    bench.library("DSStartAcquisition", stream.handle, 0, ctypes.c_uint64(1))
    for packet in camera.packets(1) + camera.packets(2):
        camera.send(packet)
    assert stream.next_frame()["id"] == 1
    with pytest.raises(RuntimeError, match="TIMEOUT"):
        bench.library.wait(stream.event, 50)


def test_a_buffer_in_a_queue_cannot_be_revoked(bench: Any) -> None:
    stream = bench.stream(bench.device(bench.camera()), n_buffers=1)
    buffer = bench.library.open("DSGetBufferID", stream.handle, 0)
    with pytest.raises(RuntimeError, match="BUSY"):
        bench.library("DSRevokeBuffer", stream.handle, buffer, None, None)
    with pytest.raises(RuntimeError, match="RESOURCE_IN_USE"):
        bench.library("DSQueueBuffer", stream.handle, buffer)
    bench.library("DSFlushQueue", stream.handle, 4)
    memory = ctypes.c_void_p()
    bench.library("DSRevokeBuffer", stream.handle, buffer, ctypes.byref(memory), None)
    assert memory.value == ctypes.addressof(stream.memories[buffer.value])
    with pytest.raises(RuntimeError, match="INVALID_HANDLE"):
        bench.library("DSQueueBuffer", stream.handle, buffer)
    with pytest.raises(RuntimeError, match="INVALID_INDEX"):
        bench.library.open("DSGetBufferID", stream.handle, 0)


def test_buffers_of_the_producer_s_own_memory(bench: Any) -> None:
    camera = bench.camera()
    stream = bench.stream(bench.device(camera), n_buffers=0)
    buffer = bench.library.open(
        "DSAllocAndAnnounceBuffer", stream.handle, ctypes.c_size_t(800), ctypes.c_void_p(42)
    )
    bench.library("DSQueueBuffer", stream.handle, buffer)
    for packet in camera.packets(1, fill=9):
        camera.send(packet)
    handle, user_pointer = struct.unpack("PP", bench.library.wait(stream.event, 5000))
    assert (handle, user_pointer) == (buffer.value, 42)
    assert ctypes.string_at(stream.info(buffer, 0), 800)[:100] == b"\x09" * 100


def test_a_wait_can_be_ended(bench: Any) -> None:
    stream = bench.stream(bench.device(bench.camera()))
    killing = threading.Timer(0.05, bench.library, ["EventKill", stream.event])
    killing.start()
    with pytest.raises(RuntimeError, match="ABORT"):
        bench.library.wait(stream.event, 60_000)
    killing.join()
    with pytest.raises(RuntimeError, match="TIMEOUT"):
        bench.library.wait(stream.event, 1)


def test_closing_the_device_ends_a_wait(bench: Any) -> None:
    device = bench.device(bench.camera())
    stream = bench.stream(device)
    closing = threading.Timer(0.05, bench.library, ["DevClose", device])
    closing.start()
    with pytest.raises(RuntimeError, match="ABORT"):
        bench.library.wait(stream.event, 60_000)
    closing.join()
    with pytest.raises(RuntimeError, match="INVALID_HANDLE"):
        bench.library.wait(stream.event, 1)


@pytest.mark.parametrize("event", [2, 3, 4, 5])
def test_other_events_are_not_offered(bench: Any, event: int) -> None:
    device = bench.device(bench.camera())
    for module in (bench.system, device):
        with pytest.raises(RuntimeError, match="NOT_IMPLEMENTED"):
            bench.library.open("GCRegisterEvent", module, event)


def test_no_thread_is_left(bench: Any) -> None:
    camera = bench.camera()
    before = n_threads()
    device = bench.device(camera)
    bench.stream(device)
    assert n_threads() == before + 2  # the heartbeat and the receiver
    bench.library("DevClose", device)
    assert n_threads() == before


def test_the_heartbeat_keeps_the_privilege(bench: Any) -> None:
    camera = bench.camera()
    camera.put(0x938, 600)
    bench.device(camera)
    wait_until(lambda: camera.n_commands(0x80, 0xA00) >= 3)


@pytest.mark.parametrize("how", ["silence", "privilege gone"])
def test_the_loss_of_the_camera_is_an_event(bench: Any, how: str) -> None:
    camera = bench.camera()
    camera.put(0x938, 600)
    interface = bench.interface(camera)
    device = bench.open_first(interface)
    stream = bench.stream(device)
    loss = bench.library.open("GCRegisterEvent", device, 0)
    if how == "silence":
        camera.is_mute = True
    else:
        camera.put(0xA00, 0)
    with pytest.raises(RuntimeError, match="IO: the camera was lost"):
        bench.library.wait_buffer(stream.event, 20_000)
    data = bench.library.wait(loss, 1000)
    told = bench.library.info("EventGetDataInfo", loss, data, ctypes.c_size_t(len(data)), 1)
    assert told == "the camera was lost"
    assert bench.library.number("DevGetInfo", device, 5) == 3  # no access
    port = bench.library.open("DevGetPort", device)
    with pytest.raises(RuntimeError, match="IO: the camera was lost; close the device"):
        bench.library.read(port, 0x1000, 4)
    bench.library("DSStopAcquisition", stream.handle, 0)
    bench.library("DevClose", device)

    camera.is_mute = False
    bench.library("IFUpdateDeviceList", interface, None, ctypes.c_uint64(500))
    stream = bench.stream(bench.open_first(interface))
    for packet in camera.packets(1):
        camera.send(packet)
    assert stream.next_frame()["is_incomplete"] == 0


def test_a_camera_silent_for_less_than_a_heartbeat_is_not_lost(bench: Any) -> None:
    camera = bench.camera()
    camera.put(0x938, 2500)
    device = bench.device(camera)
    n_asked = camera.n_commands(0x80, 0xA00)
    camera.is_mute = True
    # A heartbeat of which each of the 4 attempts fails, and one attempt of the next.
    wait_until(lambda: camera.n_commands(0x80, 0xA00) >= n_asked + 5)
    camera.is_mute = False
    answered = camera.n_commands(0x80, 0xA00) + 3
    wait_until(lambda: camera.n_commands(0x80, 0xA00) >= answered)
    assert bench.library.number("DevGetInfo", device, 5) == 5  # still open


def test_a_camera_too_busy_to_tell_who_controls_it_is_not_lost(bench: Any) -> None:
    camera = bench.camera()
    camera.put(0x938, 600)
    device = bench.device(camera)

    def say_busy(command: int, request_id: int, payload: bytes) -> bytes | None:
        is_heartbeat = command == 0x80 and payload == struct.pack(">I", 0xA00)
        return struct.pack(">HHHH", 0x8007, 0x81, 0, request_id) if is_heartbeat else None

    camera.react = say_busy
    n_asked = camera.n_commands(0x80, 0xA00)
    wait_until(lambda: camera.n_commands(0x80, 0xA00) >= n_asked + 3)
    assert bench.library.number("DevGetInfo", device, 5) == 5  # still open
