"""A GigE Vision camera as a server: two UDP sockets, three threads."""

import logging
import selectors
import socket
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Final

from drivers.gige.simulator.acquisition import Acquisition
from drivers.gige.simulator.bootstrap import (
    FIRE_TEST_PACKET,
    LATCH_TIMESTAMP,
    RESET_TIMESTAMP,
    Bootstrap,
)
from drivers.gige.simulator.clock import DeviceClock
from drivers.gige.simulator.control import ControlChannel, Sender
from drivers.gige.simulator.endpoints import Endpoints, is_loopback
from drivers.gige.simulator.features import ADDRESSES, Model
from drivers.gige.simulator.gvcp import (
    Command,
    IgnoredError,
    RefusedError,
    Request,
    Status,
    acknowledge,
    ask_for_patience,
    is_acknowledgement,
    parse_request,
)
from drivers.gige.simulator.registers import Registers
from drivers.gige.simulator.scene import Scene
from drivers.gige.simulator.transmission import Statistics, Transmitter
from tronlab.errors import DeviceError, DeviceTimeoutError, TronlabError
from tronlab.twin.state import Faults

_LOG: Final = logging.getLogger(__name__)
_MAX_DATAGRAM: Final = 2048
_POLL_S: Final = 0.05
_SLOW_S: Final = 1.0
_SLOW_PROMISE_MS: Final = 2000
_MOST_AT_ONCE: Final = 64
_WRITES: Final = frozenset({Command.WRITE_REGISTERS, Command.WRITE_MEMORY})


class CameraServer:
    """A camera that runs until it is closed."""

    def __init__(
        self,
        scene: Scene,
        faults: Faults,
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        model: Model | None = None,
        on_trigger: Callable[[], None] = lambda: None,
        is_unthrottled: bool = False,
        uses_segmentation_offload: bool = False,
        first_block_id: int = 1,
    ) -> None:
        """Start a camera.

        Args:
            scene: What it sees.
            faults: What goes wrong; names in ``drivers.gige.simulator.faults``.
            host: IPv4 address to listen at; on loopback, broadcast discoveries are answered too.
            port: UDP port of the control channel; 0: any free one.
            model: What the camera is; by default a GC1380H without read-out time.
            on_trigger: Called at every software trigger. ``DeviceTimeoutError`` leaves it without a
                frame, another ``DeviceError`` makes the camera refuse it.
            is_unthrottled: Send as fast as the computer can, whatever StreamBytesPerSecond says.
            uses_segmentation_offload: Let Linux cut packets; see ``Transmitter``.
            first_block_id: Block id of the first frame after AcquisitionStart.

        Raises:
            NotConnectedError: The address cannot be listened at.
        """
        model = model or Model()
        self._faults = faults
        self._on_trigger = on_trigger
        self._clock = DeviceClock()
        self._has_power = True
        self._closing = threading.Event()
        self._last_write: tuple[Sender, bytes, bytes] | None = None
        self._endpoints = Endpoints.open(host, port)
        self._registers = Registers(
            model,
            host=host,
            source_port=self._endpoints.stream.getsockname()[1],
            is_unthrottled=is_unthrottled,
        )
        self._transmitter = Transmitter(
            self._endpoints.stream,
            route=self._registers.route,
            faults=faults,
            uses_segmentation_offload=uses_segmentation_offload,
        )
        self._acquisition = Acquisition(
            scene,
            settings=self._registers.settings,
            deliver=self._transmitter.send,
            ignores_trigger=self._ignores_trigger,
            clock=self._clock,
            readout_s=model.readout_s,
            first_block_id=first_block_id,
        )
        self._control = ControlChannel(
            self._registers,
            host=host,
            write=self._write,
            resend=self._transmitter.resend,
            on_release=self._close_stream,
        )
        self._effects = self._effects_of_writing()
        self._thread = threading.Thread(target=self._serve, name="camera control", daemon=True)
        self._thread.start()

    @property
    def address(self) -> tuple[str, int]:
        """Get host and port of the control channel."""
        return self._endpoints.address

    @property
    def statistics(self) -> Statistics:
        """Get what was sent so far."""
        return self._transmitter.statistics

    def close(self) -> None:
        """Stop; may be called twice."""
        if not self._closing.is_set():
            self._closing.set()
            self._thread.join()
            self._transmitter.close()
            self._acquisition.close()
            self._endpoints.close()

    def _serve(self) -> None:
        with selectors.DefaultSelector() as selector:
            for listener in (self._endpoints.control, *self._endpoints.broadcasts):
                selector.register(listener, selectors.EVENT_READ)
            while not self._closing.is_set():
                for key, _ in selector.select(_POLL_S):
                    self._read_out(key.fileobj)  # pyright: ignore[reportArgumentType]  # sockets only
                self._control.expire()  # not before what waited, which may be the heartbeat
                with suppress(TronlabError):  # the simulated laboratory has ended
                    self._look_around()

    def _read_out(self, listener: socket.socket) -> None:
        """Do the commands that wait."""
        is_broadcast = listener is not self._endpoints.control
        for _ in range(_MOST_AT_ONCE):
            try:
                datagram, sender = listener.recvfrom(_MAX_DATAGRAM)
            except BlockingIOError:
                return
            if not is_broadcast or is_loopback(sender[0]):
                self._receive(datagram, sender)

    def _receive(self, datagram: bytes, sender: Sender) -> None:
        try:
            answer = self._answer(datagram, sender)
        except IgnoredError:
            return
        except TronlabError as error:  # the simulated laboratory has ended
            _LOG.error("no answer: %s", error)
            return
        if answer is not None:
            self._reply(answer, sender)

    def _answer(self, datagram: bytes, sender: Sender) -> bytes | None:
        request = parse_request(datagram)
        if request is None or is_acknowledgement(request.command) or not self._is_listening():
            return None
        if request.command in _WRITES:
            answer = self._write_once(request, datagram, sender)
        else:
            answer = self._acknowledgement(request, sender)
        return answer if request.wants_acknowledgement else None

    def _write_once(self, request: Request, datagram: bytes, sender: Sender) -> bytes:
        """Do a write, unless a host that missed the answer repeats it."""
        if self._last_write is not None and self._last_write[:2] == (sender, datagram):
            return self._last_write[2]
        self._take_time(request, sender)
        answer = self._acknowledgement(request, sender)
        self._last_write = sender, datagram, answer
        return answer

    def _acknowledgement(self, request: Request, sender: Sender) -> bytes:
        try:
            return acknowledge(request, self._control.do(request, sender))
        except RefusedError as refusal:
            return acknowledge(request, refusal.done, refusal.status)

    def _take_time(self, request: Request, sender: Sender) -> None:
        name = "camera.slow_command"
        if self._faults.is_armed(name) and self._faults.strike(name):
            self._reply(ask_for_patience(request, time_ms=_SLOW_PROMISE_MS), sender)
            time.sleep(_SLOW_S)

    def _reply(self, answer: bytes, sender: Sender) -> None:
        try:
            self._endpoints.control.sendto(answer, sender)
        except OSError as error:
            _LOG.warning("no answer to %s: %s", sender, error)

    def _is_listening(self) -> bool:
        """Look whether commands reach the camera."""
        self._look_around()
        return self._has_power and not self._faults.is_armed("camera.silent")

    def _look_around(self) -> None:
        """Heed the lasting faults of the control channel."""
        is_gone = self._faults.is_armed("camera.gone")
        if is_gone and self._has_power:
            self._lose_power()
        self._has_power = not is_gone
        self._control.hold_for_another(is_held=self._faults.is_armed("camera.held"))

    def _lose_power(self) -> None:
        """Forget everything."""
        self._control.release()
        self._registers.restart()
        self._clock.reset()
        self._last_write = None

    def _effects_of_writing(self) -> Mapping[int, Callable[[int], None]]:
        """Give what follows from writing a value to a register, by address."""
        return {
            ADDRESSES["AcquisitionStart"]: lambda _: self._start(),
            ADDRESSES["AcquisitionStop"]: lambda _: self._acquisition.stop(),
            ADDRESSES["AcquisitionAbort"]: lambda _: self._acquisition.abort(),
            ADDRESSES["TriggerSoftware"]: lambda _: self._trigger(),
            Bootstrap.TIMESTAMP_CONTROL: self._control_timestamp,
            Bootstrap.PACKET_SIZE: self._set_packet_size,
        }

    def _write(self, address: int, value: int) -> None:
        """Write a word for the application in control, and do what follows."""
        self._registers.write(address, value, is_acquiring=self._acquisition.is_running)
        if address in self._effects:
            self._effects[address](value)
        self._acquisition.reconsider()

    def _start(self) -> None:
        if not self._acquisition.is_running:
            self._acquisition.abort()
            self._transmitter.settle()
            self._acquisition.start()

    def _trigger(self) -> None:
        try:
            self._on_trigger()
        except DeviceTimeoutError:
            return
        except DeviceError as error:
            raise RefusedError(Status.LOCAL_PROBLEM) from error
        self._acquisition.trigger()

    def _ignores_trigger(self) -> bool:
        try:
            return self._faults.strike("camera.ignores_trigger")
        except TronlabError:
            return True  # the simulated laboratory has ended, and with it the camera

    def _control_timestamp(self, value: int) -> None:
        if value & LATCH_TIMESTAMP:
            ticks, memory = self._clock.ticks(), self._registers.memory
            memory.set_word(Bootstrap.TIMESTAMP_HIGH, ticks >> 32)
            memory.set_word(Bootstrap.TIMESTAMP_LOW, ticks & 0xFFFFFFFF)
        if value & RESET_TIMESTAMP:
            self._clock.reset()

    def _set_packet_size(self, value: int) -> None:
        if value & FIRE_TEST_PACKET:
            self._registers.memory.set_word(Bootstrap.PACKET_SIZE, value & ~FIRE_TEST_PACKET)
            self._transmitter.fire_test_packet()

    def _close_stream(self) -> None:
        self._acquisition.abort()
        self._transmitter.forget()
        self._registers.memory.set_word(Bootstrap.STREAM_PORT, 0)
