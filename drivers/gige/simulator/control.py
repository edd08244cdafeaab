"""The control channel: does commands of applications, and keeps account of who is in control."""

import math
import struct
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from ipaddress import IPv4Address
from typing import Final, TypeAlias

from drivers.gige.simulator.bootstrap import (
    CONTROL_EXCLUSIVE,
    CONTROL_SHARED,
    DISCOVERY_BYTES,
    Bootstrap,
    mac_of,
)
from drivers.gige.simulator.gvcp import (
    MAX_MEMORY_BYTES,
    Command,
    IgnoredError,
    RefusedError,
    Request,
    Status,
)
from drivers.gige.simulator.memory import WORD
from drivers.gige.simulator.registers import Registers

Sender: TypeAlias = tuple[str, int]
Resend: TypeAlias = Callable[[int, int, int], None]

_UNHEARD: Final = ("192.0.2.1", 3956)  # RFC 5737: an address for examples, that nobody has
_PACKET_ID_BITS: Final = 0xFFFFFF
_FORCE_IP: Final = struct.Struct(">2x6s12x4s12x4s12x4s")
_RESEND: Final = struct.Struct(">HHII")
_MEMORY_HEADER: Final = struct.Struct(">I2xH")


@dataclass
class _Holder:
    """The application in control."""

    sender: Sender
    is_exclusive: bool
    heard_s: float


class ControlChannel:
    """Does commands, one after another; to be used by one thread."""

    def __init__(
        self,
        registers: Registers,
        *,
        host: str,
        write: Callable[[int, int], None],
        resend: Resend,
        on_release: Callable[[], None],
    ) -> None:
        """Make it ready.

        Args:
            registers: What is read.
            host: The camera's address.
            write: Writes a word and does what follows; raises RefusedError.
            resend: Sends packets of a block again: block id, first and last packet id.
            on_release: What happens when nobody is in control any more.
        """
        self._registers = registers
        self._host = host
        self._write = write
        self._resend = resend
        self._on_release = on_release
        self._holder: _Holder | None = None
        self._commands: Mapping[int, Callable[[bytes, Sender], bytes]] = {
            Command.DISCOVERY: self._discover,
            Command.FORCE_IP: self._force_ip,
            Command.READ_REGISTERS: self._read_registers,
            Command.WRITE_REGISTERS: self._write_registers,
            Command.READ_MEMORY: self._read_memory,
            Command.WRITE_MEMORY: self._write_memory,
            Command.PACKET_RESEND: self._resend_packets,
        }

    def do(self, request: Request, sender: Sender) -> bytes:
        """Do a command and give what its acknowledgement carries.

        Raises:
            RefusedError: It cannot be done.
        """
        if self._is_holder(sender) and self._holder is not None:
            self._holder.heard_s = time.monotonic()
        command = self._commands.get(request.command)
        if command is None:
            raise RefusedError(Status.NOT_IMPLEMENTED)
        if not request.is_whole:
            raise RefusedError(Status.INVALID_HEADER)
        return command(request.payload, sender)

    def expire(self) -> None:
        """Take the control away from an application that has not been heard for too long."""
        timeout_s = self._registers.memory.word(Bootstrap.HEARTBEAT_MS) / 1000
        if self._holder is not None and time.monotonic() - self._holder.heard_s > timeout_s:
            self.release()

    def release(self) -> None:
        """Leave the camera to nobody."""
        self._holder = None
        self._note_holder(0)
        self._on_release()

    def hold_for_another(self, *, is_held: bool) -> None:
        """Let an application that nobody hears of hold the camera, or let go of it."""
        has_it = self._is_holder(_UNHEARD)
        if is_held and not has_it:
            self.release()
            self._holder = _Holder(_UNHEARD, is_exclusive=False, heard_s=math.inf)
            self._note_holder(CONTROL_SHARED)
        elif has_it and not is_held:
            self.release()

    def _is_holder(self, sender: Sender) -> bool:
        return self._holder is not None and self._holder.sender == sender

    def _discover(self, payload: bytes, sender: Sender) -> bytes:
        return self._registers.memory.head(DISCOVERY_BYTES)

    def _force_ip(self, payload: bytes, sender: Sender) -> bytes:
        """Take another address: a simulated camera can only keep its own."""
        if len(payload) != _FORCE_IP.size:
            raise RefusedError(Status.INVALID_PARAMETER)
        mac, address, _mask, _gateway = _FORCE_IP.unpack(payload)
        if mac != mac_of(self._host):
            raise IgnoredError
        if self._holder is not None:
            raise RefusedError(Status.ACCESS_DENIED)
        if IPv4Address(address) not in {IPv4Address(0), IPv4Address(self._host)}:
            raise RefusedError(Status.INVALID_PARAMETER)
        return b""

    def _read_registers(self, payload: bytes, sender: Sender) -> bytes:
        if not payload or len(payload) % WORD or len(payload) > MAX_MEMORY_BYTES:
            raise RefusedError(Status.INVALID_PARAMETER)
        values = b""
        for (address,) in struct.iter_unpack(">I", payload):
            try:
                values += self._read(address, WORD, sender)
            except RefusedError as refusal:
                raise RefusedError(refusal.status, values) from None
        return values

    def _read_memory(self, payload: bytes, sender: Sender) -> bytes:
        if len(payload) != _MEMORY_HEADER.size:
            raise RefusedError(Status.INVALID_PARAMETER)
        address, n_bytes = _MEMORY_HEADER.unpack(payload)
        if not 0 < n_bytes <= MAX_MEMORY_BYTES:
            raise RefusedError(Status.INVALID_PARAMETER)
        return payload[:WORD] + self._read(address, n_bytes, sender)

    def _read(self, address: int, n_bytes: int, sender: Sender) -> bytes:
        is_shut_out = (
            self._holder is not None
            and self._holder.is_exclusive
            and not self._is_holder(sender)
            and address != Bootstrap.CONTROL_PRIVILEGE
        )
        if is_shut_out:
            raise RefusedError(Status.ACCESS_DENIED)
        return self._registers.memory.read(address, n_bytes)

    def _write_registers(self, payload: bytes, sender: Sender) -> bytes:
        if not payload or len(payload) % (2 * WORD) or len(payload) > MAX_MEMORY_BYTES + WORD:
            raise RefusedError(Status.INVALID_PARAMETER)
        for i, (address, value) in enumerate(struct.iter_unpack(">II", payload)):
            self._write_word(address, value, sender, n_done=i)
        return struct.pack(">HH", 0, len(payload) // (2 * WORD))

    def _write_memory(self, payload: bytes, sender: Sender) -> bytes:
        data = payload[WORD:]
        if not data or len(data) > MAX_MEMORY_BYTES:
            raise RefusedError(Status.INVALID_PARAMETER)
        (address,) = struct.unpack_from(">I", payload)
        if len(data) % WORD:
            raise RefusedError(Status.BAD_ALIGNMENT)
        for i, (value,) in enumerate(struct.iter_unpack(">I", data)):
            self._write_word(address + i * WORD, value, sender, n_done=i * WORD)
        return struct.pack(">HH", 0, len(data))

    def _write_word(self, address: int, value: int, sender: Sender, *, n_done: int) -> None:
        """Write one word; if it is refused, the acknowledgement says how much went before."""
        try:
            if address == Bootstrap.CONTROL_PRIVILEGE:
                self._write_privilege(value, sender)
            elif not self._is_holder(sender):
                raise RefusedError(Status.ACCESS_DENIED)
            else:
                self._write(address, value)
        except RefusedError as refusal:
            raise RefusedError(refusal.status, struct.pack(">HH", 0, n_done)) from None

    def _write_privilege(self, value: int, sender: Sender) -> None:
        if self._holder is not None and not self._is_holder(sender):
            raise RefusedError(Status.ACCESS_DENIED)
        if value & ~(CONTROL_EXCLUSIVE | CONTROL_SHARED):
            raise RefusedError(Status.INVALID_PARAMETER)
        if value == 0:
            if self._holder is not None:
                self.release()
            return
        is_exclusive = bool(value & CONTROL_EXCLUSIVE)
        self._holder = _Holder(sender, is_exclusive, heard_s=time.monotonic())
        self._note_holder(value)

    def _note_holder(self, privilege: int) -> None:
        """Let applications read who is in control."""
        host, port = ("0.0.0.0", 0) if self._holder is None else self._holder.sender  # noqa: S104  # nobody
        memory = self._registers.memory
        memory.set_word(Bootstrap.CONTROL_PRIVILEGE, privilege)
        memory.set_word(Bootstrap.APPLICATION_PORT, port)
        memory.set_word(Bootstrap.APPLICATION_ADDRESS, int(IPv4Address(host)))

    def _resend_packets(self, payload: bytes, sender: Sender) -> bytes:
        """Send packets again; hosts ask from another port than the one in control."""
        if self._holder is None or self._holder.sender[0] != sender[0]:
            raise IgnoredError
        if len(payload) != _RESEND.size:
            raise IgnoredError
        channel, block_id, first_id, last_id = _RESEND.unpack(payload)
        if channel == 0:
            self._resend(block_id, first_id & _PACKET_ID_BITS, last_id & _PACKET_ID_BITS)
        raise IgnoredError  # there is no acknowledgement but the packets
