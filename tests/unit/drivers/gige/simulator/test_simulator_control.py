"""The control channel, asked byte by byte."""

import io
import socket
import struct
import time
import zipfile

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.gige.simulator.device import CameraServer
from drivers.gige.simulator.features import ADDRESSES, Model
from drivers.gige.simulator.scene import PatternScene
from tronlab.errors import NotConnectedError
from tronlab.twin.state import ArmedFaults

SUCCESS, NOT_IMPLEMENTED, INVALID_PARAMETER, INVALID_ADDRESS = 0, 0x8001, 0x8002, 0x8003
WRITE_PROTECT, BAD_ALIGNMENT, ACCESS_DENIED, INVALID_HEADER = 0x8004, 0x8005, 0x8006, 0x800E

HEARTBEAT, CCP, SCP, SCPS = 0x938, 0xA00, 0xD00, 0xD04
TIMESTAMP_CONTROL, TIMESTAMP_LOW = 0x944, 0x94C


def text(data: bytes) -> str:
    return data.rstrip(b"\0").decode()


# --- discovery ---


def test_discovery_tells_who_and_where_the_camera_is(camera, hosts):
    status, answer = hosts(camera()).ask(0x02, b"")
    assert (status, len(answer)) == (SUCCESS, 0xF8)
    assert answer[:8] == bytes.fromhex("00010002 80000001")
    assert answer[0x0A:0x10] == bytes.fromhex("0200 7f000001")
    assert answer[0x24:0x28] == bytes([127, 0, 0, 1])
    assert text(answer[0x48:0x68]) == "Allied Vision Technologies"
    assert text(answer[0x68:0x88]) == "GC1380H (02-2142A)"
    assert text(answer[0xD8:0xE8]) == Model().serial


@pytest.mark.parametrize("broadcast", ["127.255.255.255", "255.255.255.255"])
def test_discovery_by_broadcast_on_loopback(camera, broadcast):
    server = camera(host="127.0.0.9")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asker:
        asker.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        asker.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, b"lo\0")
        asker.bind(("127.0.0.1", 0))
        asker.settimeout(5.0)
        asker.sendto(bytes.fromhex("4211000200000007"), (broadcast, server.address[1]))
        answer, sender = asker.recvfrom(2048)
    assert sender == server.address
    assert answer[:8] == struct.pack(">HHHH", 0, 3, 0xF8, 7)


def test_two_cameras_of_one_port_hear_the_same_broadcast(camera):
    first = camera(host="127.0.0.11")
    second = camera(host="127.0.0.12", port=first.address[1])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asker:
        asker.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        asker.bind(("127.0.0.1", 0))
        asker.settimeout(5.0)
        asker.sendto(bytes.fromhex("4211000200000007"), ("127.255.255.255", first.address[1]))
        senders = {asker.recvfrom(2048)[1] for _ in range(2)}
    assert senders == {first.address, second.address}


def test_an_address_in_use_is_a_clear_error(camera):
    server = camera()
    with pytest.raises(NotConnectedError, match=r"^camera: cannot listen at 127\.0\.0\.1:\d+: "):
        camera(port=server.address[1])


# --- reading ---


def test_several_registers_are_read_at_once(host):
    status, answer = host.try_read(ADDRESSES["SensorWidth"], ADDRESSES["SensorHeight"], CCP)
    assert status == SUCCESS
    assert struct.unpack(">III", answer) == (1360, 1024, 2)


@pytest.mark.parametrize(
    ("address", "status"),
    [
        (ADDRESSES["Width"] + 2, BAD_ALIGNMENT),
        (0x0E00, INVALID_ADDRESS),
        (0xFFFFFFFC, INVALID_ADDRESS),
        (ADDRESSES["AcquisitionStart"], ACCESS_DENIED),
    ],
)
def test_what_cannot_be_read_ends_a_list_of_registers(host, address, status):
    assert host.try_read(CCP, address, CCP) == (status, struct.pack(">I", 2))


def test_the_description_lies_where_the_url_says(host):
    url = text(host.read_memory(0x200, 512)[1])
    name, address, length = url.removeprefix("Local:").split(";")
    start, n, archive = int(address, 16), int(length, 16), b""
    while len(archive) < n:
        status, part = host.read_memory(
            start + len(archive), min(512, -(-n // 4) * 4 - len(archive))
        )
        assert status == SUCCESS
        archive += part
    with zipfile.ZipFile(io.BytesIO(archive[:n])) as file:
        (xml_name,) = file.namelist()
        assert file.testzip() is None
        xml = file.read(xml_name)
    assert name.endswith(".zip")
    assert b"<RegisterDescription" in xml


@pytest.mark.parametrize(
    ("address", "n", "status"),
    [
        (0x202, 4, BAD_ALIGNMENT),
        (0x200, 6, BAD_ALIGNMENT),
        (0x200, 0, INVALID_PARAMETER),
        (0x200, 540, INVALID_PARAMETER),
        (0x0E00, 4, INVALID_ADDRESS),
        (0x0D20, 8, INVALID_ADDRESS),
        (0xFFFFFFF0, 32, INVALID_ADDRESS),
    ],
)
def test_memory_that_cannot_be_read(host, address, n, status):
    assert host.read_memory(address, n) == (status, b"")


# --- writing ---


@pytest.mark.parametrize(
    ("address", "value", "status"),
    [
        (ADDRESSES["Width"] + 1, 64, BAD_ALIGNMENT),
        (0x0E00, 1, INVALID_ADDRESS),
        (ADDRESSES["SensorWidth"], 10, WRITE_PROTECT),
        (0x0048, 0, WRITE_PROTECT),
        (ADDRESSES["Width"], 0, INVALID_PARAMETER),
        (ADDRESSES["Width"], 1361, INVALID_PARAMETER),
        (ADDRESSES["OffsetX"], 1, INVALID_PARAMETER),
        (ADDRESSES["OffsetY"], 0xFFFFFFFF, INVALID_PARAMETER),
        (ADDRESSES["BinningHorizontal"], 2, INVALID_PARAMETER),
        (ADDRESSES["PixelFormat"], 0x01100003, INVALID_PARAMETER),
        (ADDRESSES["ExposureTimeAbs"], 9, INVALID_PARAMETER),
        (ADDRESSES["ExposureTimeAbs"], 60_000_001, INVALID_PARAMETER),
        (ADDRESSES["ExposureAuto"], 2, INVALID_PARAMETER),
        (ADDRESSES["GainRaw"], 34, INVALID_PARAMETER),
        (ADDRESSES["AcquisitionMode"], 0, INVALID_PARAMETER),
        (ADDRESSES["AcquisitionMode"], 4, INVALID_PARAMETER),
        (ADDRESSES["AcquisitionFrameCount"], 0, INVALID_PARAMETER),
        (ADDRESSES["AcquisitionFrameRateAbs"], 0, INVALID_PARAMETER),
        (ADDRESSES["TriggerSource"], 7, INVALID_PARAMETER),
        (ADDRESSES["TriggerSelector"], 3, INVALID_PARAMETER),
        (ADDRESSES["StreamBytesPerSecond"], 124_000_001, INVALID_PARAMETER),
        (ADDRESSES["StreamFrameRateConstrain"], 0, INVALID_PARAMETER),
        (HEARTBEAT, 499, INVALID_PARAMETER),
        (SCPS, 572, INVALID_PARAMETER),
        (SCPS, 8232, INVALID_PARAMETER),
        (SCPS, 1501, INVALID_PARAMETER),
        (CCP, 4, INVALID_PARAMETER),
    ],
)
def test_what_cannot_be_written_changes_nothing(host, address, value, status):
    before = host.try_read(address & ~3)
    assert host.try_write(address, value) == status
    assert host.try_read(address & ~3) == before


def test_a_list_of_writes_ends_at_the_first_refusal(host):
    width, height = ADDRESSES["Width"], ADDRESSES["Height"]
    status, answer = host.ask(0x82, struct.pack(">6I", width, 64, height, 0, width, 32))
    assert (status, answer) == (INVALID_PARAMETER, struct.pack(">HH", 0, 1))
    assert (host.get("Width"), host.get("Height")) == (64, 1024)


def test_payload_size_follows_region_and_format(host):
    host.set(Width=33, Height=3)
    assert host.get("PayloadSize") == 99
    host.set(PixelFormat=0x01100005)
    assert host.get("PayloadSize") == 198
    host.set(PixelFormat=0x010C0006)
    assert host.get("PayloadSize") == host.get("ImageSize") == 149


def test_the_region_must_stay_on_the_sensor(host):
    host.set(Width=1000, OffsetX=360)
    assert host.try_set("Width", 1001) == INVALID_PARAMETER
    assert host.try_set("OffsetX", 361) == INVALID_PARAMETER
    host.set(OffsetX=0, Width=1360)


def test_the_frame_rate_limit_follows_exposure_and_bandwidth(host):
    host.set(ExposureTimeAbs=100_000)
    assert host.get("AcquisitionFrameRateLimit") == 10_000
    host.set(ExposureTimeAbs=10, StreamBytesPerSecond=1392640 * 8)
    assert host.get("AcquisitionFrameRateLimit") == 8000


def test_memory_is_written_word_by_word(host):
    assert host.write_memory(0xE8, b"lab camera".ljust(16, b"\0")) == (SUCCESS, b"\0\0\0\x10")
    assert text(host.ask(0x02, b"")[1][0xE8:0xF8]) == "lab camera"
    assert host.write_memory(0xE4, bytes(8)) == (WRITE_PROTECT, b"\0\0\0\0")
    assert host.write_memory(0xF4, bytes(8)) == (INVALID_ADDRESS, b"\0\0\0\x04")
    assert host.write_memory(0xE8, b"abc")[0] == BAD_ALIGNMENT
    assert host.write_memory(0xE8, b"")[0] == INVALID_PARAMETER
    assert host.write_memory(0xE8, bytes(540))[0] == INVALID_PARAMETER


def test_a_write_that_is_repeated_is_done_once(host):
    host.write(TIMESTAMP_CONTROL, 2)
    written, request_id = host.sent, host.request_id
    latched = host.read(TIMESTAMP_LOW)
    host.socket.sendto(written, host.camera.address)
    host.request_id = request_id
    assert host.receive() == (SUCCESS, 0x83, b"\0\0\0\1")
    assert host.read(TIMESTAMP_LOW) == latched
    host.write(TIMESTAMP_CONTROL, 2)
    assert host.read(TIMESTAMP_LOW) > latched


# --- headers ---


def test_unknown_commands_and_wrong_lengths_are_refused(host):
    assert host.ask(0x0100, bytes(12)) == (NOT_IMPLEMENTED, b"")
    host.socket.sendto(struct.pack(">BBHHHI", 0x42, 1, 0x80, 8, 9, CCP), host.camera.address)
    host.request_id = 9
    assert host.receive() == (INVALID_HEADER, 0x81, b"")
    assert host.ask(0x80, b"")[0] == INVALID_PARAMETER
    assert host.ask(0x80, bytes(6))[0] == INVALID_PARAMETER
    assert host.ask(0x82, bytes(4))[0] == INVALID_PARAMETER
    assert host.ask(0x84, bytes(4))[0] == INVALID_PARAMETER
    assert host.ask(0x86, b"")[0] == INVALID_PARAMETER


@pytest.mark.parametrize("datagram", [b"", b"\x42", bytes(8), bytes.fromhex("4101000200000001")])
def test_what_is_no_command_is_ignored(host, datagram):
    host.socket.sendto(datagram, host.camera.address)
    host.expect_silence()
    assert host.read(CCP) == 2


def test_acknowledgements_are_never_answered(host):
    host.send(0x81, bytes(4))
    host.expect_silence()


def test_a_command_is_done_without_an_answer_if_none_is_wanted(host):
    host.send(0x82, struct.pack(">II", ADDRESSES["GainRaw"], 7), flags=0)
    assert host.get("GainRaw") == 7


# --- control ---


def test_nothing_is_written_without_control(camera, hosts):
    host = hosts(camera())
    assert host.try_set("GainRaw", 3) == ACCESS_DENIED
    assert host.write_memory(0xE8, bytes(16)) == (ACCESS_DENIED, bytes(4))
    assert host.get("GainRaw") == 0


def test_one_host_controls_and_others_only_read(host, hosts):
    other = hosts(host.camera)
    assert other.try_write(CCP, 2) == ACCESS_DENIED
    assert other.try_set("GainRaw", 3) == ACCESS_DENIED
    assert other.get("GainRaw") == 0
    assert other.read(0xA04) == host.socket.getsockname()[1]
    assert other.read(0xA14) == 0x7F000001
    host.write(CCP, 0)
    assert other.read(0xA04) == 0
    other.take_control()
    assert host.try_set("GainRaw", 3) == ACCESS_DENIED


def test_exclusive_control_shuts_others_out(host, hosts):
    other = hosts(host.camera)
    host.write(CCP, 1)
    assert other.try_read(ADDRESSES["GainRaw"])[0] == ACCESS_DENIED
    assert other.read_memory(0x48, 32)[0] == ACCESS_DENIED
    assert other.read(CCP) == 1
    assert other.ask(0x02, b"")[0] == SUCCESS
    host.write(CCP, 2)
    assert other.get("GainRaw") == 0


def test_control_expires_with_the_heartbeat(host, hosts, streams):
    streams(host)
    other = hosts(host.camera)
    assert other.read(SCP) != 0
    assert other.try_write(CCP, 2) == ACCESS_DENIED
    host.write(HEARTBEAT, 500)
    deadline_s = time.monotonic() + 20
    while other.try_write(CCP, 2) == ACCESS_DENIED and time.monotonic() < deadline_s:
        time.sleep(0.05)
    assert other.read(0xA04) == other.socket.getsockname()[1]
    assert other.read(SCP) == 0


def test_any_command_keeps_control_alive(host, hosts):
    other = hosts(host.camera)
    host.write(HEARTBEAT, 2000)
    end_s = time.monotonic() + 2.6
    while time.monotonic() < end_s:
        assert host.read(CCP) == 2
        time.sleep(0.05)
    assert other.try_write(CCP, 2) == ACCESS_DENIED


# --- address ---


def force_ip(address: str, *, mac: str = "02007f000001") -> bytes:
    fields = (bytes.fromhex(mac), socket.inet_aton(address), bytes([255, 0, 0, 0]), bytes(4))
    return struct.pack(">2x6s12x4s12x4s12x4s", *fields)


def test_force_ip_to_its_own_address_is_accepted(camera, hosts):
    host = hosts(camera())
    assert host.ask(0x04, force_ip("127.0.0.1")) == (SUCCESS, b"")
    assert host.ask(0x04, force_ip("0.0.0.0")) == (SUCCESS, b"")  # noqa: S104  # none given


def test_force_ip_to_another_address_is_refused(camera, hosts):
    host = hosts(camera())
    assert host.ask(0x04, force_ip("10.0.0.5"))[0] == INVALID_PARAMETER
    assert host.ask(0x04, bytes(20))[0] == INVALID_PARAMETER


def test_force_ip_is_refused_while_a_host_controls(host):
    assert host.ask(0x04, force_ip("127.0.0.1"))[0] == ACCESS_DENIED


def test_force_ip_for_another_camera_is_not_answered(camera, hosts):
    host = hosts(camera())
    host.send(0x04, force_ip("127.0.0.1", mac="02007f000002"))
    host.expect_silence()


# --- clock ---


def test_the_clock_is_latched_and_reset(host):
    assert host.read(0x940) == 36_858_974
    host.write(TIMESTAMP_CONTROL, 2)
    first = host.read(0x948) << 32 | host.read(TIMESTAMP_LOW)
    assert host.read(TIMESTAMP_LOW) == first & 0xFFFFFFFF
    time.sleep(0.2)
    host.write(TIMESTAMP_CONTROL, 2)
    second = host.read(TIMESTAMP_LOW)
    assert second - first >= 0.2 * 36_858_974
    host.write(TIMESTAMP_CONTROL, 1)
    host.write(TIMESTAMP_CONTROL, 2)
    assert host.read(TIMESTAMP_LOW) < second


# --- faults ---


def test_fault_silent(host, faults):
    faults.arm("camera.silent")
    host.send(0x80, struct.pack(">I", CCP))
    host.expect_silence()
    faults.arm("camera.silent", times=0)
    assert host.read(CCP) == 2


@pytest.mark.parametrize("is_asked_meanwhile", [True, False])
def test_fault_gone_forgets_everything(host, faults, is_asked_meanwhile):
    host.set(GainRaw=5)
    faults.arm("camera.gone")
    if is_asked_meanwhile:
        host.send(0x80, struct.pack(">I", CCP))
    host.expect_silence()
    faults.arm("camera.gone", times=0)
    assert host.read(CCP) == 0
    assert host.get("GainRaw") == 0


def test_fault_held(camera, hosts, faults):
    faults.arm("camera.held")
    host = hosts(camera())
    assert host.try_write(CCP, 2) == ACCESS_DENIED
    assert host.read(CCP) == 2
    assert host.get("GainRaw") == 0
    faults.arm("camera.held", times=0)
    host.take_control()


def test_fault_held_takes_the_camera_away(host, faults):
    faults.arm("camera.held")
    assert host.try_set("GainRaw", 1) == ACCESS_DENIED
    assert host.try_write(CCP, 2) == ACCESS_DENIED


def test_fault_slow_command(host, faults):
    faults.arm("camera.slow_command", times=1)
    host.send(0x82, struct.pack(">II", ADDRESSES["GainRaw"], 4))
    assert host.receive() == (SUCCESS, 0x89, struct.pack(">HH", 0, 2000))
    assert host.receive() == (SUCCESS, 0x83, struct.pack(">HH", 0, 1))
    assert host.get("GainRaw") == 4
    host.set(GainRaw=5)


# --- anything at all ---


@pytest.fixture(scope="module")
def fuzzed():
    """A camera, and the application in control of it; it reaches loopback only."""
    server = CameraServer(PatternScene(), ArmedFaults())
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asker:
        asker.bind(("127.0.0.1", 0))
        asker.settimeout(10.0)
        yield server, asker
    server.close()


commands = st.sampled_from([0x02, 0x04, 0x40, 0x80, 0x82, 0x84, 0x86, 0x89, 0xC0, 0x100])
words = st.one_of(
    st.sampled_from([CCP, SCP, SCPS, HEARTBEAT, 0x944, 0xD18, *ADDRESSES.values()]),
    st.integers(0, 2**32 - 1),
    st.integers(0, 4),
)
payloads = st.one_of(
    st.binary(max_size=600),
    st.lists(words, max_size=20).map(lambda values: struct.pack(f">{len(values)}I", *values)),
)
datagrams = st.one_of(
    st.binary(max_size=64),
    st.builds(
        lambda command, payload, flags, error: (
            struct.pack(">BBHHH", 0x42, flags, command, max(0, len(payload) + error), 77) + payload
        ),
        commands,
        payloads,
        st.integers(0, 255),
        st.sampled_from([0, 0, 0, 0, 4, -1]),
    ),
)


@settings(max_examples=150, deadline=None)
@given(sequence=st.lists(datagrams, min_size=1, max_size=8))
def test_no_datagram_ends_the_camera(fuzzed, sequence):
    server, asker = fuzzed
    take_control = struct.pack(">BBHHHII", 0x42, 1, 0x82, 8, 0xFFFD, CCP, 2)
    for datagram in (take_control, *sequence, bytes.fromhex("420100020000fffe")):
        asker.sendto(datagram, server.address)
    answers: dict[int, tuple[int, int]] = {}
    while 0xFFFE not in answers:
        answer = asker.recv(2048)
        status, number, length, request_id = struct.unpack_from(">HHHH", answer)
        assert length == len(answer) - 8
        assert number % 2 == 1
        answers[request_id] = status, number
    assert answers[0xFFFD] == (SUCCESS, 0x83)
    assert answers[0xFFFE] == (SUCCESS, 3)
