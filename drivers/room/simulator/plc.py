"""The simulated PLC on the wire: a Modbus TCP server around its program."""

import asyncio
import logging
import threading
import time
from concurrent.futures import Future
from contextlib import suppress
from typing import Final, cast

from pymodbus import ModbusDeviceIdentification
from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from drivers.room.simulator.program import (
    CYCLE_S,
    N_COILS,
    N_DISCRETE_INPUTS,
    N_HOLDING_REGISTERS,
    N_INPUT_REGISTERS,
    PlcProgram,
    SilenceError,
)
from tronlab.errors import NotConnectedError
from tronlab.twin.state import Faults

_READ_COILS, _READ_DISCRETE_INPUTS, _READ_HOLDING, _READ_INPUT = 1, 2, 3, 4
_WRITE_COILS: Final = (5, 15)
_WRITE_HOLDING: Final = (6, 16, 22, 23)
_STATE_REGISTER: Final = 2
_BITS_PER_WORD: Final = 16


# Without any handler, Python would print pymodbus's log of broken connections to stderr.
logging.getLogger("pymodbus").addHandler(logging.NullHandler())


class PlcServer:
    """A Modbus TCP server in a thread of its own, until closed.

    Args:
        program: What it serves.
        faults: ``room.silent`` and ``room.disconnect`` are faults of the wire.
        host: Where to listen.
        port: 0: any free one.
        device_id: Requests to others are refused.
        serial: Shown in the name of its application.

    Raises:
        NotConnectedError: It cannot listen there.
    """

    def __init__(
        self,
        program: PlcProgram,
        faults: Faults,
        *,
        host: str,
        port: int,
        device_id: int = 1,
        serial: str = "",
    ) -> None:
        self._program = program
        self._faults = faults
        self._wanted = host, port
        self._device_id = device_id
        self._serial = serial
        self._is_mute = False
        self._loop = asyncio.new_event_loop()
        self._stopped = asyncio.Event()
        self._listening: Future[tuple[str, int]] = Future()
        self._thread = threading.Thread(target=self._run, name="simulated PLC", daemon=True)
        self._thread.start()
        try:
            self._address = self._listening.result()
        except NotConnectedError:
            self._thread.join()
            raise

    @property
    def address(self) -> tuple[str, int]:
        """Get host and port."""
        return self._address

    def close(self) -> None:
        """Serve no more; may be called twice."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._stopped.set)
            self._thread.join()

    def _run(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            runner.run(self._serve())

    async def _serve(self) -> None:
        server = ModbusTcpServer(
            self._device(),
            identity=self._identity(),
            address=self._wanted,
            trace_packet=self._trace_packet,
        )
        self._server = server
        try:
            await server.serve_forever(background=True)
        except (RuntimeError, OverflowError) as error:
            self._listening.set_exception(self._not_listening(error))
            return
        host, port = cast("asyncio.Server", server.transport).sockets[0].getsockname()[:2]
        self._listening.set_result((str(host), int(port)))
        while not self._stopped.is_set():
            with suppress(NotConnectedError):  # whoever serves the laboratory is busy, or has ended
                self._program.cycle(time.monotonic())
            with suppress(TimeoutError):
                await asyncio.wait_for(self._stopped.wait(), CYCLE_S)
        await server.shutdown()
        await asyncio.sleep(0)  # the transports close at the loop's next turn

    def _not_listening(self, error: Exception) -> NotConnectedError:
        host, port = self._wanted
        not_listening = NotConnectedError(
            f"cannot listen at {host}:{port}; is another program there? choose another with --port",
            device="simulated PLC",
        )
        not_listening.__cause__ = error
        return not_listening

    def _device(self) -> SimDevice:
        def bits(count: int) -> list[SimData]:
            whole = -(-count // _BITS_PER_WORD) * _BITS_PER_WORD
            return [SimData(0, values=[False] * whole, datatype=DataType.BITS)]

        def words(count: int) -> list[SimData]:
            return [SimData(0, values=[0] * count, datatype=DataType.REGISTERS)]

        tables = (
            bits(N_COILS),
            bits(N_DISCRETE_INPUTS),
            words(N_HOLDING_REGISTERS),
            words(N_INPUT_REGISTERS),
        )
        return SimDevice(self._device_id, simdata=tables, action=self._act)

    def _identity(self) -> ModbusDeviceIdentification:
        return ModbusDeviceIdentification(
            info_name={
                "VendorName": "tronlab",
                "ProductCode": "ROOM",
                "MajorMinorRevision": "sim-1",
                "ProductName": "simulated room PLC",
                "UserApplicationName": self._serial,
            }
        )

    async def _act(  # noqa: PLR0917  # pymodbus calls it like this
        self,
        function: int,
        first_of_table: int,
        address: int,
        count: int,
        registers: list[int],
        values: list[int] | list[bool] | None,
    ) -> ExcCodes | None:
        """Answer one request: pymodbus calls this before it reads or changes ``registers``."""
        now_s = time.monotonic()
        if self._faults.strike("room.disconnect"):
            self._drop_connections()
        try:
            if values is not None and not self._write(function, address, values, now_s):
                return ExcCodes.ILLEGAL_VALUE
            if function == _READ_INPUT and address <= _STATE_REGISTER < address + count:
                self._program.begin_read()
        except SilenceError:
            self._is_mute = True
        table = self._table(function, now_s)
        registers[: len(table)] = table
        return None

    def _write(
        self, function: int, address: int, values: list[int] | list[bool], now_s: float
    ) -> bool:
        if function in _WRITE_COILS:
            self._program.write_coils(address, [bool(value) for value in values], now_s)
            return True
        return self._program.write_holding_registers(address, values, now_s)

    def _table(self, function: int, now_s: float) -> list[int]:
        if function == _READ_DISCRETE_INPUTS:
            return _packed(self._program.discrete_inputs())
        if function == _READ_COILS or function in _WRITE_COILS:
            return _packed(self._program.coils)
        if function == _READ_HOLDING or function in _WRITE_HOLDING:
            return self._program.holding_registers
        return self._program.input_registers(now_s)

    def _trace_packet(self, is_sent: bool, data: bytes) -> bytes:
        """Swallow the answers of a PLC that is silent."""
        if not is_sent:
            return data
        is_mute, self._is_mute = self._is_mute, False
        return b"" if is_mute or self._faults.is_armed("room.silent") else data

    def _drop_connections(self) -> None:
        for connection in list(self._server.active_connections.values()):
            connection.close()


def _packed(bits: list[bool]) -> list[int]:
    """Put bits into words, the first into the lowest place."""
    return [
        sum(bit << i for i, bit in enumerate(bits[start : start + _BITS_PER_WORD]))
        for start in range(0, len(bits), _BITS_PER_WORD)
    ]
