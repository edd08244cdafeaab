"""The Modbus link against servers made of plain sockets: bytes, pieces, silence, nonsense."""

import socket
import threading
from collections.abc import Callable
from contextlib import ExitStack

import pytest

from drivers.room.modbus import ModbusLink
from tronlab.errors import (
    DeviceFaultError,
    DeviceTimeoutError,
    NotConnectedError,
    NotReadyError,
    ProtocolError,
)

Answer = Callable[[bytes], list[bytes] | None]
TIMEOUT_S = 1.0


def serve(listener: socket.socket, answer: Answer, requests: list[bytes]) -> None:
    """Answer each request with pieces sent one by one; None closes the connection."""
    try:
        connection, _ = listener.accept()
    except OSError:
        return
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    with connection:
        while request := connection.recv(1024):
            requests.append(request)
            pieces = answer(request)
            if pieces is None:
                return
            for piece in pieces:
                connection.sendall(piece)
                threading.Event().wait(0.01)


@pytest.fixture
def requests() -> list[bytes]:
    return []


@pytest.fixture
def link_to(requests: list[bytes]):
    """Give an open link to a server that answers like this."""
    with ExitStack() as stack:

        def make(answer: Answer) -> ModbusLink:
            listener = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
            thread = threading.Thread(target=serve, args=(listener, answer, requests))
            stack.callback(thread.join)
            thread.start()
            link = ModbusLink(
                *listener.getsockname(), device_id=1, timeout_s=TIMEOUT_S, device="here"
            )
            stack.callback(link.close)
            link.open()
            return link

        yield make


def reply(request: bytes, pdu: bytes) -> bytes:
    """Frame a reply to a request: its transaction and unit, and the length of what follows."""
    return request[:4] + (len(pdu) + 1).to_bytes(2, "big") + request[6:7] + pdu


def registers(request: bytes) -> bytes:
    return reply(request, bytes.fromhex("04 04 12 34 ab cd"))


def test_request_has_the_bytes_of_the_specification(link_to, requests: list[bytes]):
    link = link_to(lambda request: [registers(request)])
    assert link.read_input_registers(40, 2) == [0x1234, 0xABCD]
    assert requests[0][2:] == bytes.fromhex("00 00 00 06 01 04 00 28 00 02")
    assert link.last_exchange == (requests[0], registers(requests[0]))


def test_a_coil_is_written_as_ff00_or_0000(link_to, requests: list[bytes]):
    link = link_to(lambda request: [request])
    link.write_coil(2, on=True)
    link.write_coil(2, on=False)
    assert [request[7:] for request in requests] == [
        bytes.fromhex("05 00 02 ff 00"),
        bytes.fromhex("05 00 02 00 00"),
    ]


def test_an_answer_in_single_bytes_is_whole(link_to):
    link = link_to(lambda request: [bytes((byte,)) for byte in registers(request)])
    assert link.read_input_registers(40, 2) == [0x1234, 0xABCD]


def test_inputs_come_in_the_order_of_their_addresses(link_to):
    link = link_to(lambda request: [reply(request, bytes.fromhex("02 01 0d"))])
    assert link.read_discrete_inputs(0, 4) == [True, False, True, True]


@pytest.mark.parametrize(
    ("code", "kind", "text"),
    [
        (1, DeviceFaultError, "illegal function"),
        (2, DeviceFaultError, "illegal address"),
        (4, DeviceFaultError, r"device failure; is plc\.device_id 1 right\?"),
        (6, NotReadyError, "busy"),
        (77, DeviceFaultError, "unknown exception"),
    ],
)
def test_exceptions_keep_their_number(link_to, code: int, kind: type, text: str):
    link = link_to(lambda request: [reply(request, bytes((0x84, code)))])
    with pytest.raises(DeviceFaultError, match=f"exception {code}, {text}") as caught:
        link.read_input_registers(0, 1)
    assert type(caught.value) is kind
    assert caught.value.code == code


def test_silence_is_a_timeout_and_stays_one_until_opened_again(link_to):
    link = link_to(lambda request: [])
    with pytest.raises(DeviceTimeoutError, match=r"no answer from the PLC at .* in 1 s"):
        link.read_input_registers(0, 1)
    with pytest.raises(DeviceTimeoutError, match=r"call connect\(\) again"):
        link.read_input_registers(0, 1)


def test_half_an_answer_is_a_timeout(link_to):
    link = link_to(lambda request: [registers(request)[:-1]])
    with pytest.raises(DeviceTimeoutError):
        link.read_input_registers(40, 2)


def test_a_closed_connection_is_lost_and_not_opened_behind_the_back(link_to):
    link = link_to(lambda request: None)
    with pytest.raises(NotConnectedError, match="lost the PLC"):
        link.read_input_registers(0, 1)
    with pytest.raises(NotConnectedError, match="lost the PLC"):
        link.read_input_registers(0, 1)


@pytest.mark.parametrize(
    "answer",
    [
        pytest.param(lambda request: [reply(request, b"\x04\x04\x12\x34")], id="short"),
        pytest.param(lambda request: [reply(request, b"\x04\x02\x12\x34")], id="one of two"),
        pytest.param(lambda request: [reply(request, b"\x63\x01\x02")], id="unknown function"),
    ],
)
def test_nonsense_is_an_error_with_its_bytes_and_the_end_of_the_link(
    link_to, requests: list[bytes], answer: Answer
):
    link = link_to(answer)
    with pytest.raises(ProtocolError) as caught:
        link.read_input_registers(40, 2)
    assert caught.value.sent == requests[0]
    assert caught.value.received
    with pytest.raises(NotConnectedError, match=r"call connect\(\) again"):
        link.read_input_registers(40, 2)
    assert len(requests) == 1


def test_a_late_answer_to_another_request_is_not_taken(link_to):
    def answer(request: bytes) -> list[bytes]:
        stale = (int.from_bytes(request[:2], "big") + 100).to_bytes(2, "big") + request[2:]
        return [reply(stale, bytes.fromhex("04 04 00 00 00 00")) + registers(request)]

    assert link_to(answer).read_input_registers(40, 2) == [0x1234, 0xABCD]


def test_a_device_that_cannot_identify_itself_is_no_error(link_to):
    link = link_to(lambda request: [reply(request, b"\xab\x01")])
    assert link.read_identification() == {}


def test_nobody_listens():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    link = ModbusLink("127.0.0.1", port, device_id=1, timeout_s=TIMEOUT_S, device="here")
    with pytest.raises(NotConnectedError, match=rf"here: nobody answers at 127\.0\.0\.1:{port}"):
        link.open()


def test_use_before_open():
    link = ModbusLink("127.0.0.1", 1, device_id=1, timeout_s=TIMEOUT_S, device="here")
    with pytest.raises(NotConnectedError, match="not connected"):
        link.read_coils(0, 1)
    link.close()
