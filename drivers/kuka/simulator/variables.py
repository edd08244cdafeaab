"""The controller's variables by name: system variables, and the globals of the robot program."""

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from drivers.kuka.simulator import krl
from drivers.kuka.simulator.cell import Cell, Mode
from drivers.kuka.simulator.command import FREE, CartesianPosition, Command
from drivers.kuka.simulator.controller import Controller, ControllerState
from drivers.kuka.simulator.machine import Machine, position_of

_NO_FRAME = (0.0,) * 6
_INT_RANGE: Final = range(-(2**31), 2**31)
_OVERRIDES: Final = range(101)


def _program_state(cell: Cell) -> str:
    return "#P_ACTIVE" if cell.is_program_active else "#P_STOP"


_CELL: Final[Mapping[str, Callable[[Cell], str]]] = {
    "$STOPMESS": lambda cell: krl.boolean(cell.has_stop_message),
    "$PERI_RDY": lambda cell: krl.boolean(cell.are_drives_on),
    "$ALARM_STOP": lambda cell: krl.boolean(cell.is_estop_released),
    "$ALARM_STOP_INTERN": lambda cell: krl.boolean(cell.is_estop_released),
    "$USER_SAF": lambda cell: krl.boolean(cell.is_guard_closed),
    "$DRIVES_ENABLE": lambda cell: krl.boolean(cell.are_drives_on),
    "$MOVE_ENABLE": lambda _cell: krl.boolean(True),
    "$COULD_START_MOTION": lambda cell: krl.boolean(cell.is_program_active),
    "$MODE_OP": lambda cell: f"#{cell.mode.name}",
    "$T1": lambda cell: krl.boolean(cell.mode is Mode.T1),
    "$T2": lambda cell: krl.boolean(cell.mode is Mode.T2),
    "$AUT": lambda cell: krl.boolean(cell.mode is Mode.AUT),
    "$EXT": lambda cell: krl.boolean(cell.mode is Mode.EX),
    "$PRO_ACT": lambda cell: krl.boolean(cell.is_program_active),
    "$PRO_STATE": _program_state,
    "$PRO_STATE0": lambda _cell: "#P_ACTIVE",
    "$PRO_STATE1": _program_state,
}

_STATE: Final[Mapping[str, Callable[[ControllerState], str]]] = {
    "$AXIS_ACT": lambda state: krl.e6axis(state.commanded),
    "$AXIS_ACT_MEAS": lambda state: krl.e6axis(state.measured),
    "$POS_ACT": lambda state: krl.e6pos(position_of(state.commanded)),
    "$POS_ACT_MES": lambda state: krl.e6pos(position_of(state.measured)),
    "$PRO_MOVE": lambda state: krl.boolean(state.is_moving),
    "$OV_PRO": lambda state: str(state.override_pct),
    "LAB_SEQ": lambda state: str(state.sequence),
    "LAB_ACK": lambda state: str(state.acknowledged),
    "LAB_DONE": lambda state: str(state.done),
    "LAB_ERR": lambda state: str(int(state.refusal)),
}

_FIXED: Final[Mapping[str, str]] = {
    "$ACCU_STATE": "#CHARGE_OK",
    "$ACT_BASE": "0",
    "$ACT_TOOL": "0",
    "$ADVANCE": "0",
    "$BASE": krl.frame(_NO_FRAME),
    "$TOOL": krl.frame(_NO_FRAME),
    "$ROBROOT": krl.frame(_NO_FRAME),
    "$NULLFRAME": krl.frame(_NO_FRAME),
    "PING": "PONG",
}

_STRUCTURES: Final[Mapping[str, tuple[str, tuple[str, ...]]]] = {
    "LAB_AXIS": ("E6AXIS", krl.AXIS_MEMBERS),
    "LAB_POS": ("E6POS", krl.POSITION_MEMBERS),
}
_NUMBERS: Final[Mapping[str, type[int] | type[float]]] = {
    "LAB_CMD": int,
    "LAB_VEL": float,
    "LAB_ACC": float,
    "LAB_TOOL": int,
    "LAB_BASE": int,
}


class ReadOnlyError(Exception):
    """A variable that is not there, or that only the controller writes."""


class Variables:
    """What a variable server can read and write; names are the same in upper and lower case."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._fixed = {**_FIXED, **_machine_variables(controller.machine)}
        self._structures: dict[str, dict[str, float]] = {name: {} for name in _STRUCTURES}
        self._numbers: dict[str, float] = {name: kind() for name, kind in _NUMBERS.items()}
        self._jog_override_pct = 10

    def read(self, name: str) -> str:
        """Give the text of a variable; it is empty if there is none of that name."""
        key, _, member = name.strip().upper().partition(".")
        text = self._read(key)
        if not member or not text:
            return text
        return _member(text, member)

    def write(self, name: str, text: str) -> None:
        """Write a variable; LAB_SEQ is what the program looks at.

        Raises:
            ReadOnlyError: There is none of that name, or it cannot be written.
            ValueError: The text is no value of its type.
        """
        key = name.strip().upper()
        if key in _STRUCTURES:
            kind, members = _STRUCTURES[key]
            self._structures[key] = krl.read_structure(text, kind, members)
        elif key in _NUMBERS:
            self._numbers[key] = _NUMBERS[key](text)
        elif key == "LAB_SEQ":
            self._controller.write(self._command(_in_range(text, _INT_RANGE)))
        elif key == "$OV_PRO":
            self._controller.set_override(_in_range(text, _OVERRIDES))
        elif key == "$OV_JOG":
            self._jog_override_pct = _in_range(text, _OVERRIDES)
        else:
            raise ReadOnlyError(name)

    def _read(self, key: str) -> str:
        state = self._controller.state
        if key in _STATE:
            return _STATE[key](state)
        if key in _CELL:
            return _CELL[key](state.cell)
        if key in _STRUCTURES:
            return krl.write_structure(_STRUCTURES[key][0], self._structures[key])
        if key in _NUMBERS:
            value = self._numbers[key]
            return str(value) if _NUMBERS[key] is int else krl.real(value)
        return str(self._jog_override_pct) if key == "$OV_JOG" else self._fixed.get(key, "")

    def _command(self, number: int) -> Command:
        axes, position = self._structures["LAB_AXIS"], self._structures["LAB_POS"]
        return Command(
            number=number,
            type=int(self._numbers["LAB_CMD"]),
            velocity_pct=self._numbers["LAB_VEL"],
            acceleration_pct=self._numbers["LAB_ACC"],
            axes=np.array([axes.get(name, krl.NAN) for name in krl.AXIS_MEMBERS[:7]]),
            position=CartesianPosition(
                *(position.get(name, krl.NAN) for name in krl.POSITION_MEMBERS[:6]),
                status=int(position.get("S", FREE)),
                turn=int(position.get("T", FREE)),
                e1_mm=position.get("E1", krl.NAN),
            ),
            tool=int(self._numbers["LAB_TOOL"]),
            base=int(self._numbers["LAB_BASE"]),
        )


def _machine_variables(machine: Machine) -> dict[str, str]:
    limits = [
        (f"$SOFT{side}_END[{i}]", krl.real(float(limit)))
        for side, values in (("N", machine.lowest), ("P", machine.highest))
        for i, limit in enumerate(values, start=1)
    ]
    return {
        "$MODEL_NAME[]": f'"{machine.model}"',
        "$ROBTRAFO[]": f'"{machine.model}"',
        "$KR_SERIALNO": machine.serial,
        **dict(limits),
    }


def _member(structure: str, member: str) -> str:
    """Give one member of a structure's text; empty if it has no such."""
    _, _, listed = structure.strip("{}").partition(":")
    members = dict(item.split() for item in listed.split(",") if item.strip())
    return members.get(member, "")


def _in_range(text: str, allowed: range) -> int:
    value = int(text)
    if value not in allowed:
        raise ValueError(f"{value} is outside {allowed[0]} to {allowed[-1]}")
    return value
