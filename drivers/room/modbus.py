"""A connection to one Modbus TCP device: one request at a time, every failure a named error."""

import logging
import threading
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Final, TypeAlias, TypeVar

from tronlab.errors import (
    DeviceError,
    DeviceFaultError,
    DeviceTimeoutError,
    NotConnectedError,
    NotReadyError,
    ProtocolError,
    TronlabError,
)

if TYPE_CHECKING:
    from pymodbus.client import ModbusTcpClient
    from pymodbus.pdu import ModbusPDU

    Ask: TypeAlias = Callable[[ModbusTcpClient], ModbusPDU]

T = TypeVar("T")

ILLEGAL_FUNCTION: Final = 1
_EXCEPTIONS: Final = {
    ILLEGAL_FUNCTION: "illegal function",
    2: "illegal address",
    3: "illegal value",
    4: "device failure",
    5: "acknowledged, but takes long",
    6: "busy",
    8: "memory parity error",
    10: "gateway path unavailable",
    11: "gateway target does not answer",
}
"""Exception codes of the Modbus Application Protocol 1.1b3, section 7."""
_NOT_YET: Final = (5, 6)
_UNKNOWN_DEVICE: Final = (4, 10, 11)
"""What servers answer to a device number they do not have."""


# pymodbus logs what it also raises. Without any handler, Python would print the log to stderr.
logging.getLogger("pymodbus").addHandler(logging.NullHandler())


class ModbusLink:
    """A connection to one Modbus TCP device; may be used from several threads.

    Once it failed it stays down until it is opened again: every further request raises the error
    it failed with, so that nobody goes on with a device that was gone for a while.
    """

    def __init__(
        self, host: str, port: int, *, device_id: int, timeout_s: float, device: str
    ) -> None:
        self._host, self._port = host, port
        self._device_id = device_id
        self._timeout_s = timeout_s
        self._device = device
        self._lock = threading.Lock()
        self._client: ModbusTcpClient | None = None
        self._why_down: tuple[type[NotConnectedError | DeviceTimeoutError], str] | None = None
        self._sent, self._received = b"", b""

    @property
    def last_exchange(self) -> tuple[bytes, bytes]:
        """Get the bytes last sent, and those received since."""
        return self._sent, self._received

    def open(self) -> None:
        """Connect.

        Raises:
            NotConnectedError: Nobody listens there.
            TronlabError: pymodbus is not installed.
        """
        client = self._new_client()
        if not client.connect():
            raise NotConnectedError(
                f"nobody answers at {self._at}; check the network, and plc.host and plc.port",
                device=self._device,
            )
        with self._lock:
            self._client, self._why_down = client, None

    def close(self) -> None:
        """Disconnect; may be called twice."""
        with self._lock:
            self._disconnect()
            self._why_down = None

    def read_discrete_inputs(self, address: int, count: int) -> list[bool]:
        """Read inputs."""
        reply = self._request(
            lambda client: client.read_discrete_inputs(
                address, count=count, device_id=self._device_id
            )
        )
        return self._whole(reply.bits, count, rounded_to=8)

    def read_coils(self, address: int, count: int) -> list[bool]:
        """Read what was requested of the device, as it stands there."""
        reply = self._request(
            lambda client: client.read_coils(address, count=count, device_id=self._device_id)
        )
        return self._whole(reply.bits, count, rounded_to=8)

    def read_input_registers(self, address: int, count: int) -> list[int]:
        """Read registers of 16 bits."""
        reply = self._request(
            lambda client: client.read_input_registers(
                address, count=count, device_id=self._device_id
            )
        )
        return self._whole(reply.registers, count)

    def read_holding_registers(self, address: int, count: int) -> list[int]:
        """Read registers of 16 bits that this side writes."""
        reply = self._request(
            lambda client: client.read_holding_registers(
                address, count=count, device_id=self._device_id
            )
        )
        return self._whole(reply.registers, count)

    def write_coil(self, address: int, *, on: bool) -> None:
        """Request something, or take the request back."""
        self._request(lambda client: client.write_coil(address, on, device_id=self._device_id))

    def write_register(self, address: int, value: int) -> None:
        """Write a holding register of 16 bits."""
        self._request(
            lambda client: client.write_register(address, value, device_id=self._device_id)
        )

    def read_identification(self) -> dict[int, str]:
        """Read the device identification, function 43/14; empty if the device has none."""
        try:
            reply = self._request(
                lambda client: client.read_device_information(
                    read_code=2, device_id=self._device_id
                )
            )
        except DeviceFaultError as error:
            if error.code == ILLEGAL_FUNCTION:
                return {}
            raise
        objects: dict[int, bytes] = getattr(reply, "information", {})
        return {key: text.decode("utf-8", "replace") for key, text in objects.items()}

    @property
    def _at(self) -> str:
        return f"{self._host}:{self._port}"

    def _new_client(self) -> "ModbusTcpClient":
        try:
            from pymodbus.client import ModbusTcpClient
        except ImportError:
            raise TronlabError(
                f"{self._device}: pymodbus is not installed: pip install 'tronlab[lab]'"
            ) from None
        return ModbusTcpClient(
            self._host,
            port=self._port,
            timeout=self._timeout_s,
            retries=0,
            trace_packet=self._remember,
        )

    def _remember(self, is_sent: bool, data: bytes) -> bytes:
        if is_sent:
            self._sent, self._received = data, b""
        else:
            self._received = data
        return data

    def _request(self, ask: "Ask") -> "ModbusPDU":
        with self._lock:
            reply = self._exchange(self._connected(), ask)
        if reply.isError():
            raise self._refusal(reply.exception_code)
        return reply

    def _connected(self) -> "ModbusTcpClient":
        if self._client is None:
            kind, why = self._why_down or (NotConnectedError, "not connected")
            raise kind(f"{why}; call connect() again", device=self._device)
        return self._client

    def _exchange(self, client: "ModbusTcpClient", ask: "Ask") -> "ModbusPDU":
        from pymodbus.exceptions import ConnectionException, ModbusIOException

        begun_s = time.monotonic()
        try:
            return ask(client)
        except (ConnectionException, OSError) as error:
            raise self._fail(NotConnectedError, f"lost the PLC at {self._at}") from error
        except ModbusIOException as error:
            if time.monotonic() - begun_s >= self._timeout_s:
                raise self._fail(
                    DeviceTimeoutError,
                    f"no answer from the PLC at {self._at} in {self._timeout_s:g} s",
                ) from error
            self._fail(NotConnectedError, f"the PLC at {self._at} answered what is no Modbus")
            raise self._nonsense("the answer is no Modbus") from error

    def _fail(self, kind: type[NotConnectedError | DeviceTimeoutError], why: str) -> DeviceError:
        """Go down, and give the error; a connection on which an answer may be late is of no use."""
        self._disconnect()
        self._why_down = kind, why
        return kind(why, device=self._device)

    def _disconnect(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None

    def _refusal(self, code: int) -> DeviceFaultError:
        what = _EXCEPTIONS.get(code, "unknown exception")
        hint = f"; is plc.device_id {self._device_id} right?" if code in _UNKNOWN_DEVICE else ""
        kind = NotReadyError if code in _NOT_YET else DeviceFaultError
        return kind(
            f"the PLC at {self._at} answers Modbus exception {code}, {what}{hint}",
            device=self._device,
            code=code,
        )

    def _whole(self, values: Sequence[T], count: int, *, rounded_to: int = 1) -> list[T]:
        if len(values) != -(-count // rounded_to) * rounded_to:
            what = f"asked for {count} values, got {len(values)}"
            with self._lock:
                self._fail(NotConnectedError, f"the PLC at {self._at}: {what}")
            raise self._nonsense(what)
        return list(values[:count])

    def _nonsense(self, what: str) -> ProtocolError:
        return ProtocolError(
            f"PLC at {self._at}: {what}",
            device=self._device,
            sent=self._sent,
            received=self._received,
        )
