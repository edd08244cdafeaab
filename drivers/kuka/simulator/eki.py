"""EthernetKRL on the wire: one TCP server for commands, one that tells the state 20 times a second.

Each serves one client. A message that lacks an element shifts that element's queue against the
others, so that numbers of different messages would be read together: the program stops with a
message, and reads no more until the PC connects anew, which empties the queues.
"""

import select
import socket
import sys
import time
from collections.abc import Mapping
from typing import Final

import numpy as np

from drivers.kuka.simulator import faults as f
from drivers.kuka.simulator.command import CartesianPosition, Command
from drivers.kuka.simulator.controller import Controller, ControllerState
from drivers.kuka.simulator.machine import position_of
from drivers.kuka.simulator.tags import DocumentReader, MalformedError, document
from drivers.kuka.simulator.tcp import Server, send
from tronlab.errors import TronlabError
from tronlab.twin.state import Faults

STATE_PERIOD_S: Final = 0.05

AXIS_NAMES: Final = ("A1", "A2", "A3", "A4", "A5", "A6", "E1")

INT_TAGS: Final = (
    "RobotCommand/@Id",
    "RobotCommand/@Type",
    "RobotCommand/Cart/@S",
    "RobotCommand/Cart/@T",
    "RobotCommand/Tool/@No",
    "RobotCommand/Base/@No",
)
REAL_TAGS: Final = (
    "RobotCommand/@Vel",
    "RobotCommand/@Acc",
    *(f"RobotCommand/Axis/@{name}" for name in AXIS_NAMES),
    *(f"RobotCommand/Cart/@{name}" for name in ("X", "Y", "Z", "A", "B", "C", "E1")),
)


class EkiServer:
    """The two channels of a controller; runs until closed.

    Args:
        controller: The robot.
        faults: What is armed.
        host: Address to listen at.
        command_port: Port of the commands; 0 for any free one.
        state_port: Port of the state; likewise.
    """

    def __init__(
        self,
        controller: Controller,
        faults: Faults,
        *,
        host: str = "127.0.0.1",
        command_port: int = 0,
        state_port: int = 0,
    ) -> None:
        self._controller = controller
        self._faults = faults
        self._n_sent = 0
        self._commands = Server(host, command_port, self._read_commands, max_clients=1)
        try:
            self._states = Server(host, state_port, self._tell_state, max_clients=1)
        except TronlabError:
            self._commands.close()
            raise

    @property
    def command_address(self) -> tuple[str, int]:
        """Get host and port of the commands."""
        return self._commands.address

    @property
    def state_address(self) -> tuple[str, int]:
        """Get host and port of the state."""
        return self._states.address

    def close(self) -> None:
        """Close both channels; the robot goes on."""
        self._commands.close()
        self._states.close()

    def _read_commands(self, connection: socket.socket) -> None:
        self._controller.confirm()
        reader, is_in_step = DocumentReader(), True
        try:
            while data := connection.recv(4096):
                for values in reader.feed(data):
                    is_in_step = is_in_step and self._take(values)
        except MalformedError as error:
            print(f"robot: EKI command channel closed: {error}", file=sys.stderr, flush=True)

    def _take(self, values: Mapping[str, str]) -> bool:
        """Pass a command on; False if the queues of its elements are out of step from now on."""
        numbers, missing = _numbers(values)
        if missing:
            self._controller.stop_program(f"EKI command without a valid {', '.join(missing)}")
        if "RobotCommand/@Id" in numbers:
            self._controller.write(_command(numbers, is_complete=not missing))
        return not missing

    def _tell_state(self, connection: socket.socket) -> None:
        try:
            while not _is_gone_within(connection, STATE_PERIOD_S):
                if self._faults.strike(f.DISCONNECT):
                    self._commands.drop_clients()
                    return
                if not self._faults.is_armed(f.SILENT):
                    self._send_state(connection)
        except TronlabError as error:  # the laboratory around it is gone
            print(f"robot: EKI state channel closed: {error}", file=sys.stderr, flush=True)

    def _send_state(self, connection: socket.socket) -> None:
        self._n_sent += 1
        data = state_document(self._controller.state, self._n_sent)
        send(connection, data, in_pieces=self._faults.is_armed(f.SPLIT))


def state_document(state: ControllerState, number: int) -> bytes:
    """Write a state as the channel sends it."""
    cell, position = state.cell, position_of(state.measured)
    return document(
        "RobotState",
        {
            "Seq": str(number),
            "Ack": str(state.acknowledged),
            "Done": str(state.done),
            "Err": str(int(state.refusal)),
        },
        Axis={n: _real(v) for n, v in zip(AXIS_NAMES, state.measured, strict=True)},
        Pos={
            "X": _real(position.x_mm),
            "Y": _real(position.y_mm),
            "Z": _real(position.z_mm),
            "A": _real(position.a_deg),
            "B": _real(position.b_deg),
            "C": _real(position.c_deg),
            "S": str(position.status),
            "T": str(position.turn),
            "E1": _real(position.e1_mm),
        },
        Flags={
            "Move": _flag(state.is_moving),
            "Stop": _flag(cell.has_stop_message),
            "Peri": _flag(cell.are_drives_on),
            "Estop": _flag(cell.is_estop_released),
            "Safe": _flag(cell.is_guard_closed),
            "Mode": str(int(cell.mode)),
            "Ov": str(state.override_pct),
            "Pro": _flag(cell.is_program_active),
        },
    )


def _numbers(values: Mapping[str, str]) -> tuple[dict[str, float], list[str]]:
    """Read the elements that the channel is configured for; give also those that are missing."""
    numbers: dict[str, float] = {}
    missing: list[str] = []
    for tags, kind in ((INT_TAGS, int), (REAL_TAGS, float)):
        for tag in tags:
            try:
                numbers[tag] = kind(values[tag])
            except (KeyError, ValueError):
                missing.append(tag)
    return numbers, missing


def _command(numbers: Mapping[str, float], *, is_complete: bool) -> Command:
    def real(tag: str) -> float:
        return numbers.get(f"RobotCommand/{tag}", float("nan"))

    def integer(tag: str) -> int:
        return int(numbers.get(f"RobotCommand/{tag}", -1))

    return Command(
        number=integer("@Id"),
        type=integer("@Type"),
        velocity_pct=real("@Vel"),
        acceleration_pct=real("@Acc"),
        axes=np.array([real(f"Axis/@{name}") for name in AXIS_NAMES]),
        position=CartesianPosition(
            *(real(f"Cart/@{name}") for name in ("X", "Y", "Z", "A", "B", "C")),
            status=integer("Cart/@S"),
            turn=integer("Cart/@T"),
            e1_mm=real("Cart/@E1"),
        ),
        tool=integer("Tool/@No"),
        base=integer("Base/@No"),
        is_complete=is_complete,
    )


def _is_gone_within(connection: socket.socket, duration_s: float) -> bool:
    """Wait, but no longer than until the client closes; what it says on this channel is ignored."""
    end_s = time.monotonic() + duration_s
    while (left_s := end_s - time.monotonic()) > 0:
        readable, _, _ = select.select([connection], [], [], left_s)
        if readable and not connection.recv(4096):
            return True
    return False


def _real(value: float) -> str:
    return f"{value:.9g}"


def _flag(is_set: bool) -> str:
    return str(int(is_set))
