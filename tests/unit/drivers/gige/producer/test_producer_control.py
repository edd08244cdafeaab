"""Discovery and the control channel, through the C interface, against a scripted camera."""

import ctypes
import os
import re
import struct
import time
from pathlib import Path
from typing import Any

import pytest

HEADER = Path(__file__).parents[5] / "drivers/gige/producer/gentl.h"
SOMEWHERE = struct.pack(">I", 0x1000)


def test_the_header_agrees_with_the_constants_of_genicam() -> None:
    gentl = pytest.importorskip("genicam.gentl")
    known = {
        name: int(value)
        for kind in vars(gentl).values()
        if isinstance(kind, type) and hasattr(kind, "__members__")
        for name, value in kind.__members__.items()
    }
    ours: dict[str, int] = {}
    for block in re.findall(r"enum \{(.*?)\}", HEADER.read_text(), re.DOTALL):
        value = -1
        for entry in filter(None, (part.strip() for part in block.split(","))):
            name, _, given = (part.strip() for part in entry.partition("="))
            value = int(given) if given else value + 1
            ours[name] = value
    assert len(ours) > 120
    assert {name: known[name] for name in ours} == ours


def test_it_must_be_opened_first_and_once(closed_library: Any) -> None:
    library = closed_library
    with pytest.raises(RuntimeError, match="NOT_INITIALIZED"):
        library.open("TLOpen")
    with pytest.raises(RuntimeError, match="NOT_INITIALIZED"):
        library("TLClose", ctypes.c_void_p(65537))
    library("GCInitLib")
    with pytest.raises(RuntimeError, match="RESOURCE_IN_USE"):
        library("GCInitLib")
    system = library.open("TLOpen")
    with pytest.raises(RuntimeError, match="RESOURCE_IN_USE"):
        library.open("TLOpen")
    library("GCCloseLib")
    library("GCInitLib")
    with pytest.raises(RuntimeError, match="INVALID_HANDLE"):
        library("TLClose", system)
    library("GCCloseLib")


def test_only_loopback_is_asked_unless_told_otherwise(
    bench: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("TRONLAB_GEV_INTERFACES", raising=False)
    bench.library("TLUpdateInterfaceList", bench.system, None, ctypes.c_uint64(0))
    assert bench.library.count("TLGetNumInterfaces", bench.system) == 1
    assert bench.library.text("TLGetInterfaceID", bench.system, 0) == "lo"
    with pytest.raises(RuntimeError, match="INVALID_INDEX"):
        bench.library.text("TLGetInterfaceID", bench.system, 1)


@pytest.mark.parametrize(
    "entry", ["nosuch0", "127.0.0.1:0", "127.0.0.1:x", "127.0.0.1:70000", "1.2.3", "a" * 31]
)
def test_an_entry_that_is_neither_interface_nor_address_is_named(
    bench: Any, monkeypatch: pytest.MonkeyPatch, entry: str
) -> None:
    monkeypatch.setenv("TRONLAB_GEV_INTERFACES", f"lo, {entry}")
    message = f"INVALID_PARAMETER: TRONLAB_GEV_INTERFACES: '{re.escape(entry)}' is neither"
    with pytest.raises(RuntimeError, match=message):
        bench.library("TLUpdateInterfaceList", bench.system, None, ctypes.c_uint64(0))


def test_an_interface_no_longer_named_goes_unless_it_is_open(
    bench: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = bench.camera()
    bench.camera()
    bench.interface(kept)
    assert bench.library.count("TLGetNumInterfaces", bench.system) == 2
    monkeypatch.setenv("TRONLAB_GEV_INTERFACES", "lo")
    changed = ctypes.c_uint8()
    bench.library("TLUpdateInterfaceList", bench.system, ctypes.byref(changed), ctypes.c_uint64(0))
    names = [bench.library.text("TLGetInterfaceID", bench.system, i) for i in range(2)]
    assert names == [kept.address, "lo"]
    assert changed.value == 1


def test_a_camera_tells_who_it_is(bench: Any) -> None:
    camera = bench.camera()
    interface = bench.interface(camera)
    camera_id = bench.library.text("IFGetDeviceID", interface, 0)
    assert camera_id == f"S-17@{camera.address}"
    told = [
        bench.library.info("IFGetDeviceInfo", interface, camera_id.encode(), command)
        for command in (1, 2, 3, 6, 7, 8)
    ]
    assert told == ["Maker", "Model 7", "GEV", "upper deck", "S-17", "1.2.3"]


def test_a_camera_without_serial_number_is_known_by_its_hardware_address(bench: Any) -> None:
    camera = bench.camera(serial=b"")
    interface = bench.interface(camera)
    assert bench.library.text("IFGetDeviceID", interface, 0) == f"0a0b0c0d0e0f@{camera.address}"


def test_a_silent_address_has_no_camera(bench: Any) -> None:
    camera = bench.camera(is_mute=True)
    interface = bench.interface(camera)
    assert bench.library.count("IFGetNumDevices", interface) == 0
    assert camera.n_commands(0x02) == 3
    with pytest.raises(RuntimeError, match=f"INVALID_ID: .*{camera.address}.* no camera 'S'"):
        bench.library.open("IFOpenDevice", interface, b"S", 3)


def test_who_controls_a_camera_is_told_before_it_is_opened(bench: Any) -> None:
    camera = bench.camera()
    interface = bench.interface(camera)
    name = f"S-17@{camera.address}".encode()
    told = []
    for privilege in (0, 2, 1):
        camera.put(0xA00, privilege)
        told.append(bench.library.number("IFGetDeviceInfo", interface, name, 5))
    assert told == [1, 2, 3]  # read and write, read only, no access


def test_reads_of_any_place_and_size(bench: Any) -> None:
    camera = bench.camera()
    camera.memory[0x1000:0x3000] = os.urandom(0x2000)
    port = bench.port(camera)
    for address, size in [(0x1000, 4), (0x1001, 2), (0x1003, 5), (0x1002, 2000), (0x1000, 536)]:
        expected = bytes(camera.memory[address : address + size])
        assert bench.library.read(port, address, size) == expected
    sizes = [struct.unpack(">IxxH", payload)[1] for c, _, payload in camera.commands if c == 0x84]
    assert max(sizes) == 536  # what a control packet holds
    assert all(size % 4 == 0 for size in sizes)


def test_writes_go_in_whole_words(bench: Any) -> None:
    camera = bench.camera()
    port = bench.port(camera)
    data = os.urandom(1200)
    bench.library.write(port, 0x1000, data)
    assert camera.memory[0x1000 : 0x1000 + 1200] == data
    for address, size in [(0x1002, 4), (0x1000, 3), (2**32, 4)]:
        with pytest.raises(RuntimeError, match="INVALID_ADDRESS"):
            bench.library.write(port, address, bytes(size))


def test_a_lost_datagram_is_sent_again_with_its_number(bench: Any) -> None:
    camera = bench.camera()
    port = bench.port(camera)
    seen: list[int] = []

    def lose_the_first(_command: int, request_id: int, payload: bytes) -> bytes | None:
        if payload != SOMEWHERE:
            return None
        seen.append(request_id)
        return b"" if len(seen) == 1 else None

    camera.put(0x1000, 0xCAFE)
    camera.react = lose_the_first
    assert bench.library.read(port, 0x1000, 4) == b"\0\0\xca\xfe"
    assert len(seen) == 2
    assert seen[0] == seen[1] != 0


def test_a_late_answer_to_another_request_is_passed_over(bench: Any) -> None:
    camera = bench.camera()
    port = bench.port(camera)

    def answer_another_first(_command: int, request_id: int, payload: bytes) -> None:
        if payload == SOMEWHERE:
            other = struct.pack(">HHHHI", 0, 0x81, 4, request_id - 1, 0xBAD)
            camera.socket.sendto(other, camera.client)
            camera.socket.sendto(b"?", camera.client)

    camera.put(0x1000, 0xCAFE)
    camera.react = answer_another_first
    assert bench.library.read(port, 0x1000, 4) == b"\0\0\xca\xfe"


def test_pending_ack_is_waited_for(bench: Any) -> None:
    camera = bench.camera()
    port = bench.port(camera)

    def take_long(command: int, request_id: int, payload: bytes) -> None:
        if command == 0x82 and payload.startswith(SOMEWHERE):
            pending = struct.pack(">HHHHHH", 0, 0x89, 4, request_id, 0, 900)
            camera.socket.sendto(pending, camera.client)
            time.sleep(0.6)  # longer than an answer may otherwise take

    camera.react = take_long
    bench.library.write(port, 0x1000, b"\0\0\0\7")
    assert camera.n_commands(0x82, 0x1000) == 1
    assert camera.get(0x1000) == 7


@pytest.mark.parametrize(
    ("status", "code"),
    [
        (0x8001, "NOT_IMPLEMENTED"),
        (0x8002, "INVALID_PARAMETER"),
        (0x8003, "INVALID_ADDRESS"),
        (0x8004, "ACCESS_DENIED"),
        (0x8005, "INVALID_ADDRESS"),
        (0x8006, "ACCESS_DENIED"),
        (0x8007, "BUSY"),
        (0x8FFF, "IO"),
        (0x8123, "IO"),
    ],
)
def test_a_status_becomes_an_error_that_carries_its_number(
    bench: Any, status: int, code: str
) -> None:
    camera = bench.camera()
    port = bench.port(camera)

    def refuse(command: int, request_id: int, payload: bytes) -> bytes | None:
        return (
            struct.pack(">HHHH", status, command + 1, 0, request_id)
            if payload == SOMEWHERE
            else None
        )

    camera.react = refuse
    with pytest.raises(RuntimeError, match=f"{code}: READREG 0x00001000: .* 0x{status:04x}"):
        bench.library.read(port, 0x1000, 4)


def test_a_short_answer_is_no_answer(bench: Any) -> None:
    camera = bench.camera()
    port = bench.port(camera)

    def answer_short(command: int, request_id: int, payload: bytes) -> bytes | None:
        return (
            struct.pack(">HHHHH", 0, command + 1, 2, request_id, 7)
            if payload == SOMEWHERE
            else None
        )

    camera.react = answer_short
    with pytest.raises(RuntimeError, match=r"IO: READREG 0x00001000: the acknowledge .* 2 bytes"):
        bench.library.read(port, 0x1000, 4)


def test_silence_ends_in_a_timeout(bench: Any) -> None:
    camera = bench.camera()
    port = bench.port(camera)
    camera.react = lambda _command, _id, payload: b"" if payload == SOMEWHERE else None
    with pytest.raises(RuntimeError, match=r"TIMEOUT: READREG 0x00001000: .* does not answer"):
        bench.library.read(port, 0x1000, 4)
    assert camera.n_commands(0x80, 0x1000) == 4


def test_a_camera_that_another_controls_is_refused(bench: Any) -> None:
    camera = bench.camera()
    interface = bench.interface(camera)

    def deny(command: int, request_id: int, _payload: bytes) -> bytes | None:
        return struct.pack(">HHHH", 0x8006, 0x83, 0, request_id) if command == 0x82 else None

    camera.react = deny
    with pytest.raises(RuntimeError, match=r"ACCESS_DENIED: .* controlled by another application"):
        bench.open_first(interface)
    camera.react = None
    bench.open_first(interface)  # nothing is left of the failure


@pytest.mark.parametrize(("access", "privilege"), [(3, 2), (4, 1)])
def test_the_privilege_is_taken_and_given_back(bench: Any, access: int, privilege: int) -> None:
    camera = bench.camera()
    device = bench.device(camera, access)
    assert camera.get(0xA00) == privilege
    assert bench.library.number("DevGetInfo", device, 5) == 5  # open to read and write
    assert bench.library.number("DevGetInfo", device, 9) == 36_858_974
    bench.library("DevClose", device)
    assert camera.get(0xA00) == 0
    with pytest.raises(RuntimeError, match="INVALID_HANDLE"):
        bench.library("DevClose", device)


def test_read_only_takes_no_privilege(bench: Any) -> None:
    camera = bench.camera()
    device = bench.device(camera, access=2)
    assert camera.n_commands(0x82) == 0
    assert bench.library.number("DevGetInfo", device, 5) == 6


@pytest.mark.parametrize(
    ("largest", "expected"), [(9000, 8228), (1500, 1500), (600, 576), (0, 136)]
)
def test_the_largest_packet_that_comes_through_is_set(
    bench: Any, largest: int, expected: int
) -> None:
    camera = bench.camera(largest_test_packet=largest)
    bench.device(camera)
    assert camera.get(0xD04) == expected
    assert camera.get(0xD00) == 0


def test_a_packet_size_can_be_given(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TRONLAB_GEV_PACKET_SIZE", "1400")
    camera = bench.camera(largest_test_packet=9000)
    bench.device(camera)
    assert camera.get(0xD04) == 1400


@pytest.mark.parametrize("text", ["big", "575", "20000", "1400x"])
def test_a_packet_size_that_is_none_is_refused(
    bench: Any, monkeypatch: pytest.MonkeyPatch, text: str
) -> None:
    monkeypatch.setenv("TRONLAB_GEV_PACKET_SIZE", text)
    with pytest.raises(RuntimeError, match=f"TRONLAB_GEV_PACKET_SIZE: '{text}' .* 576 to 16384"):
        bench.device(bench.camera())


def test_each_module_describes_itself(bench: Any) -> None:
    camera = bench.camera()
    interface = bench.interface(camera)
    device = bench.open_first(interface)
    stream = bench.library.open("DevOpenDataStream", device, b"Stream0")
    modules = {
        "TLSystem": bench.system,
        "TLInterface": interface,
        "TLDevice": device,
        "TLDataStream": stream,
    }
    for module, handle in modules.items():
        url = bench.library.info("GCGetPortURLInfo", handle, 0, 0)
        name, address, size = url.removeprefix("Local:").split(";")
        assert name == f"tronlab_gev_{module}.xml"
        file = bench.library.read(handle, int(address, 16), int(size, 16)).decode()
        port = bench.library.info("GCGetPortInfo", handle, 12)
        assert f'ModelName="{module}"' in file
        assert f'<Port Name="{port}"/>' in file
        assert file.endswith("</RegisterDescription>\n")
    assert bench.library.read(device, 0, 8) == struct.pack("<Q", 0x7F000001)
    assert bench.library.read(device, 8, 8) == struct.pack("<Q", 0x0A0B0C0D0E0F)
    with pytest.raises(RuntimeError, match="INVALID_ADDRESS"):
        bench.library.read(device, 16, 8)


def test_the_camera_s_own_file_is_named(bench: Any) -> None:
    port = bench.port(bench.camera())
    assert bench.library.count("GCGetNumPortURLs", port) == 1
    assert bench.library.info("GCGetPortURLInfo", port, 0, 0) == "Local:camera.zip;2000;700"
    assert bench.library.number("GCGetPortURLInfo", port, 0, 7) == 0x2000
    assert bench.library.number("GCGetPortURLInfo", port, 0, 8) == 0x700
    assert bench.library.info("GCGetPortURLInfo", port, 0, 10) == "camera.zip"
    with pytest.raises(RuntimeError, match="INVALID_INDEX"):
        bench.library.info("GCGetPortURLInfo", port, 1, 0)
