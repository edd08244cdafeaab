"""Into the controller through KUKA.EthernetKRL: one channel for commands, one for states."""

import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from scipy.spatial.transform import RigidTransform

from drivers.kuka.backend import MAKER, Command, ControllerState, next_id
from drivers.kuka.connection import is_closed_by_peer, open_connection, shut
from drivers.kuka.eki import (
    STATE_ROOT,
    DocumentReader,
    decode_position,
    decode_state,
    encode_command,
)
from drivers.kuka.kvp import KvpClient
from drivers.kuka.kvp_backend import read_identity
from drivers.kuka.options import EkiOptions
from tronlab.devices.readings import DeviceIdentity
from tronlab.errors import (
    AccessDeniedError,
    DeviceError,
    DeviceTimeoutError,
    NotConnectedError,
    ProtocolError,
)

_MODEL = "KR 16"
_RETRY_S = 0.1
_CLOSED_AT_ONCE = "the controller closes the connection at once: another client holds it"


class EkiBackend:
    """Commands go out on one channel; the states that come in on the other are always read."""

    def __init__(self, host: str, options: EkiOptions, *, timeout_s: float, device: str) -> None:
        self._host = host
        self._options = options
        self._timeout_s = timeout_s
        self._device = device
        self._lock = threading.Lock()
        self._commands: socket.socket | None = None
        self._states: _StateReceiver | None = None
        self._last_id = 0

    def connect(self) -> None:
        """Open both channels and wait for the first state.

        The controller needs a moment to open a channel anew after its last client has gone: until
        the time allowed is over, this tries again.

        Raises:
            AccessDeniedError: Another client holds a channel: EthernetKRL serves one.
            NotConnectedError: Nobody answers.
        """
        self.close()
        give_up_s = time.monotonic() + self._timeout_s
        while True:
            try:
                self._connect_once()
            except NotConnectedError:
                if time.monotonic() > give_up_s:
                    raise
                time.sleep(_RETRY_S)
            else:
                return

    def _connect_once(self) -> None:
        try:
            self._commands = self._open(self._options.command_port)
            states = self._open(self._options.state_port)
            self._states = _StateReceiver(states, self._timeout_s, device=self._device)
            state = self._states.next(call="connect").state
            if is_closed_by_peer(self._commands):
                raise AccessDeniedError(f"connect: {_CLOSED_AT_ONCE}", device=self._device)
        except DeviceError:
            self.close()
            raise
        self._last_id = max(state.accepted_id, state.done_id)

    def close(self) -> None:
        """Close both channels and end the thread that reads states."""
        if self._states is not None:
            self._states.close()
            self._states = None
        if self._commands is not None:
            shut(self._commands)
            self._commands = None

    def identify(self, *, call: str) -> DeviceIdentity:
        """Give maker and model; the channels do not tell, a KUKAVARPROXY beside them does."""
        self._receiver(call)
        if self._options.kvp_port is None:
            return DeviceIdentity(maker=MAKER, model=_MODEL, serial="", firmware="")
        variables = KvpClient(
            self._host, self._options.kvp_port, timeout_s=self._timeout_s, device=self._device
        )
        try:
            variables.connect(call=call)
            return read_identity(variables, call=call)
        finally:
            variables.close()

    def state(self, *, call: str) -> ControllerState:
        """Wait for the next state."""
        return self._receiver(call).next(call=call).state

    def position(self, *, call: str) -> RigidTransform:
        """Wait for the next state and give its position."""
        document = self._receiver(call).next(call=call).document
        return decode_position(document, device=self._device)

    def send(self, command: Command, *, call: str) -> int:
        """Send a command."""
        with self._lock:
            connection = self._commands
            if connection is None:
                raise _not_connected(call, self._device)
            command_id = next_id(self._last_id)
            self._last_id = command_id  # used up, even if it is lost on the way
            try:
                if is_closed_by_peer(connection):
                    raise ConnectionResetError("closed by the controller")
                connection.sendall(encode_command(command, command_id))
            except OSError as error:
                raise NotConnectedError(
                    f"{call}: the command channel is lost ({error})", device=self._device
                ) from error
        return command_id

    def _open(self, port: int) -> socket.socket:
        return open_connection(
            self._host, port, timeout_s=self._timeout_s, device=self._device, call="connect"
        )

    def _receiver(self, call: str) -> "_StateReceiver":
        if self._states is None:
            raise _not_connected(call, self._device)
        return self._states


@dataclass(frozen=True, slots=True)
class _Arrival:
    state: ControllerState
    document: bytes


class _StateReceiver:
    """Reads states in a thread, so that the controller never waits to send one."""

    def __init__(self, connection: socket.socket, timeout_s: float, *, device: str) -> None:
        self._connection = connection
        self._timeout_s = timeout_s
        self._device = device
        self._arrival = threading.Condition()
        self._latest: _Arrival | None = None
        self._n_arrived = 0
        self._failure: Callable[[str], DeviceError] | None = None
        connection.settimeout(None)
        self._thread = threading.Thread(target=self._run, name=f"{device} states", daemon=True)
        self._thread.start()

    def next(self, *, call: str) -> _Arrival:
        """Wait for a state that arrives after this call began."""
        with self._arrival:
            n_before = self._n_arrived
            self._arrival.wait_for(
                lambda: self._n_arrived > n_before or self._failure is not None, self._timeout_s
            )
            if self._failure is not None:
                raise self._failure(call)
            if self._n_arrived == n_before or self._latest is None:
                raise DeviceTimeoutError(
                    f"{call}: no state from the controller in {self._timeout_s:g} s",
                    device=self._device,
                )
            return self._latest

    def close(self) -> None:
        shut(self._connection)
        self._thread.join()

    def _run(self) -> None:
        documents = DocumentReader(STATE_ROOT, device=self._device)
        try:
            while received := self._connection.recv(65_536):
                for document in documents.feed(received):
                    self._take(_Arrival(decode_state(document, device=self._device), document))
            raise ConnectionResetError("closed by the controller")
        except OSError as error:
            reason = str(error)
            self._fail(lambda call: self._lost(call, reason))
        except ProtocolError as error:
            unreadable = error
            self._fail(lambda _call: unreadable)

    def _lost(self, call: str, reason: str) -> NotConnectedError:
        if self._n_arrived == 0:
            return AccessDeniedError(f"{call}: {_CLOSED_AT_ONCE}", device=self._device)
        return NotConnectedError(
            f"{call}: the state channel is lost ({reason})", device=self._device
        )

    def _take(self, arrival: _Arrival) -> None:
        with self._arrival:
            self._latest = arrival
            self._n_arrived += 1
            self._arrival.notify_all()

    def _fail(self, failure: Callable[[str], DeviceError]) -> None:
        shut(self._connection)
        with self._arrival:
            self._failure = failure
            self._arrival.notify_all()


def _not_connected(call: str, device: str) -> NotConnectedError:
    return NotConnectedError(f"{call}: not connected; call connect() first", device=device)
