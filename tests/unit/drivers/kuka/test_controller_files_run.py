"""The robot's programs run: their KRL is translated to Python and carried out cycle by cycle.

The translation knows the part of KRL that these programs use and refuses everything else. As on a
controller, a variable that was never set cannot be read, an interrupt answers to a change only, and
RESUME leaves everything below the routine that declared it.
"""

import copy
import re
import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import drivers.kuka
from drivers.kuka.simulator.command import CartesianPosition, Command
from drivers.kuka.simulator.controller import Controller
from drivers.kuka.simulator.machine import Machine
from drivers.kuka.simulator.scene import EmptyScene
from tronlab.twin.state import ArmedFaults

FOLDER = Path(drivers.kuka.__file__).parent / "controller"
N_MOTION_CYCLES = 6
SOFT_N = (-185.0, -155.0, -130.0, -350.0, -130.0, -350.0, -100.0)
SOFT_P = (185.0, 35.0, 154.0, 350.0, 130.0, 350.0, 5000.0)
RAIL_MM = (0.0, 4000.0)
AXES = ("A1", "A2", "A3", "A4", "A5", "A6", "E1")
HOME = dict(zip(AXES, (0.0, -90.0, 90.0, 0.0, 90.0, 0.0, 0.0), strict=True))
HOME_POS = {"X": 930.0, "Y": 0.0, "Z": 1162.0, "A": 180.0, "B": 0.0, "C": 180.0}
TOKEN = re.compile(r'"[^"]*"|[$#]?[A-Z_]\w*|\d+\.?\d*|<>|<=|>=|==|[-+*/().,<>\[\]]')
WORDS = {"AND": "and", "OR": "or", "NOT": "not", "TRUE": "True", "FALSE": "False", "<>": "!="}


class Resume(Exception):  # noqa: N818  # KRL calls it so
    """Leaves everything below the routine that declared the interrupt."""


class Names(dict):
    """Variables, or the members of a structure, by name."""

    def __missing__(self, name: str) -> Any:
        raise AssertionError(f"{name} is read before it is set")


def statements(path: Path) -> list[str]:
    lines = [re.sub(r";.*", "", line).strip() for line in path.read_text("ascii").splitlines()]
    return [line for line in lines if line and not line.startswith("&")]


def is_global(name: str) -> bool:
    return name.startswith(("$", "LAB_", "LOAD_DATA"))


class Translator:
    """Makes Python of one module: routines become generators, functions stay functions."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._depth = 0
        self._declares_interrupts = False
        self._patterns: dict[str, Callable[..., None]] = {
            r"(?:GLOBAL )?DEF(FCT \w+)? (\w+)\((.*)\)": self._routine,
            r"DECL E6(?:AXIS|POS) (\w+)": lambda n: self._put(f"{self._name(n)} = Names()"),
            r"DECL \w+ \w+|BAS\(.*\)": lambda: None,
            r"IF (.*) THEN": lambda c: self._enter(f"if {self._value(c)}:"),
            r"ELSE": lambda: self._turn("else:"),
            r"LOOP|REPEAT": lambda: self._enter("while True:"),
            r"WHILE (.*)": lambda c: self._enter(f"while {self._value(c)}:"),
            r"UNTIL (.*)": self._until,
            r"FOR (\w+)=(\d+) TO (\d+)": lambda i, a, b: self._enter(
                f"for {self._name(i)} in range({a}, {b} + 1):"
            ),
            r"SWITCH (.*)": self._switch,
            r"CASE (.*)": lambda e: self._turn(f"elif chosen == {self._value(e)}:"),
            r"DEFAULT": lambda: self._turn("else:"),
            r"END|ENDFCT|ENDIF|ENDLOOP|ENDWHILE|ENDFOR|ENDSWITCH": self._leave,
            r"RETURN(.*)": lambda e: self._put(f"return {self._value(e)}"),
            r"WAIT SEC .*": lambda: self._put("yield from robot.wait()"),
            r"(PTP|LIN) (\w+)": lambda kind, goal: self._put(
                f"yield from robot.move({kind!r}, {self._name(goal)})"
            ),
            r"(?:GLOBAL )?INTERRUPT DECL (\d+) WHEN (.*) DO (\w+)\( \)": self._interrupt,
            r"INTERRUPT (ON|OFF) (\d+)": lambda on, n: self._put(
                f"robot.enable({n}, {on == 'ON'})"
            ),
            r"BRAKE": lambda: self._put("robot.brake()"),
            r"RESUME": lambda: self._put("raise Resume"),
            r"([$\w.\[\]]+)=(.*)": lambda target, value: self._put(
                f"{self._value(target)} = copy({self._value(value)})"
            ),
            r"(\w+)\((.*)\)": self._call,
        }

    def statement(self, text: str) -> None:
        for pattern, handle in self._patterns.items():
            if match := re.fullmatch(pattern, text):
                handle(*match.groups())
                return
        raise AssertionError(f"cannot translate: {text}")

    def _put(self, text: str) -> None:
        self.lines.append("    " * self._depth + text)

    def _enter(self, text: str) -> None:
        self._put(text)
        self._depth += 1
        self._put("pass")

    def _leave(self) -> None:
        self._depth -= 1

    def _turn(self, text: str) -> None:
        self._leave()
        self._enter(text)

    def _until(self, condition: str) -> None:
        self._put(f"if {self._value(condition)}: break")
        self._leave()

    def _switch(self, value: str) -> None:
        self._put(f"chosen = {self._value(value)}")
        self._enter("if False:")

    def _routine(self, function: str | None, name: str, parameters: str) -> None:
        names = [p.split(":")[0].strip() for p in parameters.split(",") if p.strip()]
        self._declares_interrupts = False
        self._enter(f"def {name}({', '.join(names)}):")
        for parameter in names:
            self._put(f"{self._name(parameter)} = {parameter}")
        if function is None:
            self._put("yield from ()")

    def _interrupt(self, number: str, condition: str, routine: str) -> None:
        self._declares_interrupts = True
        self._put(f"robot.declare({number}, lambda: {self._value(condition)}, {routine!r})")

    def _call(self, name: str, arguments: str) -> None:
        call = f"yield from f[{name!r}]({self._value(arguments)})"
        if self._declares_interrupts:  # where RESUME comes back to
            self._put("try:")
            self._put(f"    {call}")
            self._put("except Resume: pass")
        else:
            self._put(call)

    def _name(self, name: str) -> str:
        return f"{'g' if is_global(name) else 'm'}[{name!r}]"

    def _value(self, text: str) -> str:
        """Translate an expression; what a function writes it gets as a function that sets it."""
        if match := re.fullmatch(r"(EKI_GET\w+|INVERSE)\((.*),([\w.]+)\)", text):
            function, given, target = match.groups()
            place, _, key = self._value(target).rpartition("[")
            setter = f"lambda value: {place}.__setitem__({key.removesuffix(']')}, value)"
            return f"f[{function!r}]({self._value(given)}, {setter})"
        tokens = TOKEN.findall(text)
        assert "".join(tokens) == text.replace(" ", ""), text
        pieces: list[str] = []
        for before, token, after in zip(["", *tokens], tokens, [*tokens[1:], ""], strict=False):
            pieces.append(self._piece(before, token, after))
        return "".join(pieces)

    def _piece(self, before: str, text: str, after: str) -> str:
        if text == ".":
            return ""
        if before == ".":
            return f"[{text!r}]"
        if text.startswith("#"):
            return repr(text)
        if text in WORDS:
            return f" {WORDS[text]} "
        if re.match(r"[A-Z_]", text) and after == "(":
            return f"f[{text!r}]"
        return self._name(text) if re.match(r"[$A-Z_]", text) else text


@cache
def translated(path: Path) -> Any:
    translator = Translator()
    for line in statements(path):
        translator.statement(line)
    return compile("\n".join(translator.lines), path.name, "exec")


class Cell:
    """A controller with its programs: both interpreters, and EthernetKRL."""

    def __init__(self) -> None:
        self.g = Names(
            {
                "$AXIS_ACT": Names(HOME),
                "$AXIS_ACT_MEAS": Names(HOME),
                "$POS_ACT_MES": Names({**HOME_POS, "S": 2, "T": 2, "E1": 0.0}),
                "$NULLFRAME": Names(X=0.0),
                "$ROBROOT": Names(X=500.0),
                "LOAD_DATA": {1: "camera and T-MAC"},
                "$SOFTN_END": dict(enumerate(SOFT_N, 1)),
                "$SOFTP_END": dict(enumerate(SOFT_P, 1)),
                "$FLAG": defaultdict(bool),
                "$TIMER": {},
                "$TIMER_STOP": {},
                "$TIMER_FLAG": defaultdict(lambda: True),
                "$PRO_STATE1": "#P_FREE",
                "$PRO_MOVE": False,
                "$STOPMESS": False,
                "$PERI_RDY": True,
                "$ALARM_STOP": True,
                "$USER_SAF": True,
                "$MODE_OP": "#AUT",
                "$OV_PRO": 30,
                **{f"${name}": {} for name in ("VEL_AXIS", "ACC_AXIS", "VEL_EXTAX", "ACC_EXTAX")},
                **{f"${name}": Names() for name in ("VEL", "ACC")},
            }
        )
        self.functions: dict[str, Any] = {
            "INVERSE": self._inverse,
            **{f"EKI_{name}": getattr(self, f"_eki_{name.lower()}") for name in EKI},
        }
        self.channels: dict[str, str] = {}
        self.queues: dict[str, deque[Any]] = defaultdict(deque)
        self.set_values: dict[str, Any] = {}
        self.told: list[dict[str, Any]] = []
        self.motions: list[tuple[str, dict[str, float]]] = []
        self.arrived: list[dict[str, float]] = []
        self.unreachable = False
        self._interrupts: dict[int, list[Any]] = {}
        self._program: Iterator[None] | None = None
        self._load()
        self.g.update(LAB_RAIL_LOW=RAIL_MM[0], LAB_RAIL_HIGH=RAIL_MM[1])
        self.submit("LAB_WATCH_INIT")
        self.submit("LAB_EKI_INIT")

    def _load(self) -> None:
        self._read_data(FOLDER / "lab_globals.dat", self.g)
        for path in sorted(FOLDER.glob("*.src")):
            module = Names()
            if path.with_suffix(".dat").exists():
                self._read_data(path.with_suffix(".dat"), module)
            scope = {"g": self.g, "m": module, "f": self.functions, "robot": self}
            scope |= {"copy": copy.copy, "Names": Names, "Resume": Resume}
            known = set(scope)
            exec(translated(path), scope)  # noqa: S102
            self.functions.update({name: scope[name] for name in set(scope) - known})

    def _read_data(self, path: Path, names: Names) -> None:
        for line in statements(path):
            match = re.fullmatch(r"DECL (?:GLOBAL )?(\w+) (\w+)(?:=(.*))?", line)
            if match is None:
                assert re.match(r"DEFDAT|ENDDAT|EXT ", line), line
                continue
            kind, name, value = match.groups()
            if kind.startswith("E6"):
                members = [item.split() for item in (value or "").strip("{}").split(",") if item]
                names[name] = Names({member: float(number) for member, number in members})
            elif value is not None:
                names[name] = value == "TRUE" if kind == "BOOL" else float(value)

    # What the robot's interpreter does.

    def wait(self) -> Iterator[None]:
        yield
        yield from self._interrupt()

    def move(self, kind: str, goal: dict[str, float]) -> Iterator[None]:
        self.motions.append((kind, dict(goal)))
        self.g["$PRO_MOVE"] = True
        for _ in range(N_MOTION_CYCLES):
            yield
            yield from self._interrupt()
        self.g["$PRO_MOVE"] = False
        self.arrived.append(dict(goal))

    def brake(self) -> None:
        self.g["$PRO_MOVE"] = False

    def declare(self, number: int, condition: Callable[[], bool], routine: str) -> None:
        self._interrupts[number] = [condition, self.functions.get(routine), False, False]

    def enable(self, number: int, is_on: bool) -> None:
        interrupt = self._interrupts[number]
        interrupt[2], interrupt[3] = is_on, interrupt[0]()

    def _interrupt(self) -> Iterator[None]:
        for number in sorted(self._interrupts):
            interrupt = self._interrupts[number]
            condition, routine, is_on, before = interrupt
            interrupt[3] = condition()
            if is_on and interrupt[3] and not before and routine is not None:
                yield from routine()

    def _inverse(self, position: Names, near: Names, set_check: Callable[[int], None]) -> Names:
        assert near == self.g["$AXIS_ACT"]
        set_check(3 if self.unreachable else 0)
        self.asked = dict(position)
        return Names({name: float(position["X"]) / 100 for name in AXES[:6]})

    # What EthernetKRL does.

    def _eki_init(self, channel: str) -> Names:
        assert channel not in self.channels
        self.channels[channel] = "ready"
        return Names(MSG_NO=0, BUFF=0)

    def _eki_open(self, channel: str) -> Names:
        assert self.channels[channel] == "ready"
        self.channels[channel] = "open"
        return Names(MSG_NO=0, BUFF=0)

    def _eki_clear(self, channel: str) -> Names:
        del self.channels[channel]
        if channel == "LabCommand":
            self.queues.clear()
        return Names(MSG_NO=0, BUFF=0)

    def _eki_checkbuffer(self, channel: str, tag: str) -> Names:
        return Names(MSG_NO=0, BUFF=len(self.queues[tag]))

    def _eki_getint(self, channel: str, tag: str, put: Callable[[Any], None]) -> Names:
        if not self.queues[tag]:
            return Names(MSG_NO=9, BUFF=0)
        put(self.queues[tag].popleft())
        return Names(MSG_NO=0, BUFF=len(self.queues[tag]))

    _eki_getreal = _eki_getint

    def _eki_setint(self, channel: str, tag: str, value: Any) -> Names:
        assert not isinstance(value, bool)
        self.set_values[tag] = value
        return Names(MSG_NO=0)

    _eki_setreal = _eki_setint

    def _eki_send(self, channel: str, root: str) -> Names:
        self.told.append(dict(self.set_values))
        return Names(MSG_NO=0)

    # What the test does.

    def submit(self, name: str) -> None:
        for _ in self.functions[name]():
            raise AssertionError("the submit interpreter must not wait")

    def start_program(self) -> None:
        self._program = self.functions["LAB_MOTION"]()
        self.g["$PRO_STATE1"] = "#P_ACTIVE"

    def cycle(self, n: int = 1) -> None:
        for _ in range(n):
            self.submit("LAB_EKI_CYCLE")
            self.submit("LAB_WATCH_CYCLE")
            if self.g["$PRO_STATE1"] == "#P_ACTIVE" and not self.g["$STOPMESS"]:
                assert self._program is not None
                next(self._program)

    def set_stop(self, is_stopped: bool) -> None:
        self.g.update({"$STOPMESS": is_stopped, "$PERI_RDY": not is_stopped})
        self.g["$PRO_STATE1"] = "#P_STOP" if is_stopped else "#P_ACTIVE"
        if is_stopped:
            self.g["$PRO_MOVE"] = False

    def write(self, number: int, kind: int, **members: float) -> None:
        """Write a command as a client of the variable server does."""
        if kind != 9:
            self.g["LAB_AXIS"].update({k: v for k, v in members.items() if k in AXES})
            self.g["LAB_POS"].update(
                {k: v for k, v in members.items() if k in (*HOME_POS, "S", "T")}
            )
            self.g["LAB_POS"]["E1"] = members.get("E1", 0.0)
            self.g["LAB_VEL"], self.g["LAB_ACC"] = members.get("Vel", 50), members.get("Acc", 50)
            self.g["LAB_TOOL"] = members.get("Tool", 0)
        self.g["LAB_CMD"] = kind
        self.g["LAB_SEQ"] = number

    @property
    def answer(self) -> tuple[int, int, int]:
        return self.g["LAB_ACK"], self.g["LAB_DONE"], self.g["LAB_ERR"]

    def settle(self) -> tuple[int, int, int]:
        self.cycle(4 * N_MOTION_CYCLES)
        assert not self.g["$PRO_MOVE"]
        return self.answer


EKI = ("INIT", "OPEN", "CLEAR", "CHECKBUFFER", "GETINT", "GETREAL", "SETINT", "SETREAL", "SEND")


@pytest.fixture
def cell():
    cell = Cell()
    cell.start_program()
    cell.cycle(2 * N_MOTION_CYCLES)
    assert cell.g["LAB_READY"]
    assert cell.motions == [("PTP", HOME)]  # block coincidence
    return cell


def test_ptp_is_accepted_then_done(cell):
    cell.write(1, 1, A1=5.0, E1=100.0, Vel=40, Acc=60)
    cell.cycle(2)
    assert cell.answer == (1, 0, 0)
    assert cell.g["$PRO_MOVE"]
    assert cell.settle() == (1, 1, 0)
    kind, goal = cell.motions[-1]
    assert (kind, goal["A1"], goal["E1"]) == ("PTP", 5.0, 100.0)
    assert cell.g["$VEL_AXIS"] == dict.fromkeys(range(1, 7), 40)
    assert cell.g["$ACC_EXTAX"] == {1: 60}
    assert cell.g["$VEL"]["CP"] == pytest.approx(0.8)


def test_what_was_sent_before_the_program_ran_is_not_carried_out():
    cell = Cell()
    cell.write(7, 1, A1=5.0)
    cell.cycle()
    assert cell.answer == (7, 7, 4)
    cell.g["LAB_SEQ"] = 8
    cell.start_program()
    assert cell.settle()[:2] == (8, 8)
    assert cell.motions == [("PTP", HOME)]


@pytest.mark.parametrize("n_cycles", range(2 * N_MOTION_CYCLES))
def test_command_sent_while_the_program_starts_is_refused_or_carried_out(n_cycles):
    cell = Cell()
    cell.start_program()
    cell.cycle(n_cycles)
    cell.write(7, 1, A1=5.0)
    acknowledged, done, error = cell.settle()
    assert (acknowledged, done) == (7, 7)
    assert error == (0 if cell.arrived[-1]["A1"] == 5.0 else 4)


def test_command_sent_in_the_instant_before_the_program_is_ready_is_refused():
    cell = Cell()
    cell.write(7, 1, A1=5.0)
    cell.start_program()
    while not cell.g["LAB_READY"]:
        next(cell._program)  # the submit interpreter has no turn
    assert cell.settle() == (7, 7, 4)
    assert cell.arrived == [HOME]


def test_motion_is_of_the_flange_with_its_load_and_without_advance(cell):
    settings = ("$ADVANCE", "$LOAD", "$IPO_MODE", "$ORI_TYPE")
    assert [cell.g[name] for name in settings] == [0, "camera and T-MAC", "#BASE", "#VAR"]
    assert cell.g["$TOOL"] == cell.g["$NULLFRAME"]
    assert cell.g["$BASE"] == cell.g["$ROBROOT"]


REFUSED = {
    "unknown": ({"kind": 5}, 1),
    **{f"{a} below": ({"kind": 1, a: SOFT_N[i] - 0.1}, 2) for i, a in enumerate(AXES[:6])},
    **{f"{a} above": ({"kind": 1, a: SOFT_P[i] + 0.1}, 2) for i, a in enumerate(AXES[:6])},
    "rail below": ({"kind": 1, "E1": -0.1}, 3),
    "rail above": ({"kind": 1, "E1": 4000.1}, 3),
    "speed": ({"kind": 1, "Vel": 0.5}, 6),
    "speed to a position": ({"kind": 2, "Vel": 101}, 6),
    "acceleration": ({"kind": 3, "Acc": 101}, 6),
    "tool": ({"kind": 1, "Tool": 1}, 6),
    "position on the rail": ({"kind": 3, "X": 930.0, "E1": 4100.0}, 3),
    "axes of a position": ({"kind": 2, "X": 13500.0}, 2),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_is_refused_and_nothing_moves(cell, name):
    members, error = REFUSED[name]
    cell.write(1, **members)
    assert cell.settle() == (1, 1, error)
    assert len(cell.motions) == 1


@pytest.mark.parametrize("kind", [2, 3])
def test_position_out_of_reach_fails_and_nothing_moves(cell, kind):
    cell.unreachable = True
    cell.write(1, kind, X=930.0)
    assert cell.settle() == (1, 1, 6)
    assert len(cell.motions) == 1


@pytest.mark.parametrize(
    ("kind", "status", "asks_for_a_branch"), [(2, 2, True), (2, -1, False), (3, 2, False)]
)
def test_status_and_turn_count_only_where_they_are_given(cell, kind, status, asks_for_a_branch):
    cell.write(1, kind, **HOME_POS, S=status, T=3, E1=50.0)
    assert cell.settle() == (1, 1, 0)
    assert ("S" in cell.asked) is asks_for_a_branch
    made, goal = cell.motions[-1]
    assert made == ("PTP" if kind == 2 else "LIN")
    assert "S" not in goal
    assert goal["E1"] == 50.0
    if made == "LIN":
        assert {name: goal[name] for name in HOME_POS} == HOME_POS


def test_error_of_one_command_is_not_that_of_the_next(cell):
    cell.write(1, 1, A2=90.0)
    assert cell.settle() == (1, 1, 2)
    cell.write(2, 1, A1=5.0, A2=-90.0)
    cell.cycle(3)
    assert cell.answer == (2, 1, 0)
    cell.cycle()
    assert cell.g["$PRO_MOVE"]


def test_hold_between_taking_a_command_and_watching_for_holds_is_not_missed(cell, monkeypatch):
    enable = cell.enable

    def hold_first(number: int, is_on: bool) -> None:
        if is_on and cell.g["LAB_ACK"] == 1:
            cell.write(2, 9)
            cell.submit("LAB_WATCH_CYCLE")
        enable(number, is_on)

    monkeypatch.setattr(cell, "enable", hold_first)
    cell.write(1, 1, A1=5.0)
    assert cell.settle() == (2, 2, 5)
    assert cell.motions == [("PTP", HOME)]


def test_hold_at_rest_and_ping_are_answered(cell):
    cell.write(1, 9)
    assert cell.settle() == (1, 1, 0)
    cell.write(2, 0)
    assert cell.settle() == (2, 2, 0)
    assert len(cell.motions) == 1


@pytest.mark.parametrize("n_cycles", range(2 * N_MOTION_CYCLES))
def test_hold_is_answered_and_nothing_moves_afterwards_whenever_it_comes(cell, n_cycles):
    cell.write(1, 1, A1=5.0)
    cell.cycle(n_cycles)
    was_moving = cell.g["$PRO_MOVE"]
    cell.write(2, 9)
    acknowledged, done, error = cell.settle()
    assert (acknowledged, done) == (2, 2)
    has_arrived = cell.arrived[-1].get("A1") == 5.0
    if was_moving and not has_arrived:
        assert error == 5
    if n_cycles < N_MOTION_CYCLES:
        assert not has_arrived
    cell.write(3, 1, A1=7.0)
    assert cell.settle() == (3, 3, 0)
    assert cell.arrived[-1]["A1"] == 7.0


@pytest.mark.parametrize("n_cycles", range(1, N_MOTION_CYCLES))
def test_stop_of_the_cell_fails_the_motion_and_it_is_not_finished_later(cell, n_cycles):
    cell.write(1, 1, A1=5.0)
    cell.cycle(n_cycles)
    cell.set_stop(True)
    assert cell.settle() == (1, 1, 4)
    cell.write(2, 1, A1=6.0)
    assert cell.settle() == (2, 2, 4)
    cell.write(3, 0)
    assert cell.settle() == (3, 3, 0)
    cell.set_stop(False)
    assert cell.settle() == (3, 3, 0)
    assert all(goal.get("A1") == 0.0 for goal in cell.arrived)
    cell.write(4, 1, A1=7.0)
    assert cell.settle() == (4, 4, 0)
    assert cell.arrived[-1]["A1"] == 7.0


def test_program_that_was_reset_is_not_ready(cell):
    cell.g["$PRO_STATE1"] = "#P_RESET"
    cell.write(1, 1, A1=5.0)
    assert cell.settle() == (1, 1, 4)
    cell.g["$PRO_STATE1"] = "#P_ACTIVE"
    cell._program = iter(lambda: None, 0)  # another program runs
    cell.write(2, 1, A1=5.0)
    assert cell.settle() == (2, 2, 4)


def message(number: int, kind: int = 0, **changes: float) -> dict[str, float]:
    values = {
        "@Id": number,
        "@Type": kind,
        "@Vel": 50.0,
        "@Acc": 50.0,
        "Tool/@No": 0,
        "Base/@No": 0,
    }
    values |= {f"Axis/@{name}": HOME[name] for name in AXES}
    values |= {f"Cart/@{name}": HOME_POS[name] for name in HOME_POS}
    values |= {"Cart/@S": -1, "Cart/@T": -1, "Cart/@E1": 0.0}
    return values | {key.replace("_", "/@"): value for key, value in changes.items()}


class Pc:
    """The other end of both channels."""

    def __init__(self, cell: Cell) -> None:
        self.cell = cell
        self.connect()

    def connect(self) -> None:
        assert self.cell.channels == {"LabCommand": "open", "LabState": "open"}
        self.cell.g["$FLAG"].update({901: True, 903: True})
        self.cell.cycle()

    def leave(self) -> None:
        self.cell.channels.update(LabCommand="lost", LabState="lost")
        self.cell.g["$FLAG"].update({901: False, 903: False})
        self.cell.cycle()

    def send(self, values: dict[str, float]) -> None:
        for tag, value in values.items():
            self.cell.queues[f"RobotCommand/{tag}"].append(value)
        self.cell.g["$FLAG"][902] = True

    def state(self) -> dict[str, float]:
        told = self.cell.told[-1]
        return {tag.removeprefix("RobotState/"): value for tag, value in told.items()}


@pytest.fixture
def pc(cell):
    return Pc(cell)


def test_message_moves_the_robot_and_the_state_tells(cell, pc):
    pc.send(message(11, 1, Axis_A1=5.0, Axis_E1=20.0))
    assert cell.settle() == (11, 11, 0)
    assert cell.arrived[-1]["A1"] == 5.0
    state = pc.state()
    assert (state["@Ack"], state["@Done"], state["@Err"]) == (11, 11, 0)
    assert [told["RobotState/@Seq"] for told in cell.told] == list(range(1, len(cell.told) + 1))
    flags = {tag: value for tag, value in state.items() if tag.startswith("Flags/")}
    assert list(flags.values()) == [0, 0, 1, 1, 1, 3, 30, 1]
    assert any(told["RobotState/Flags/@Move"] for told in cell.told)


def test_message_moves_along_a_line_as_it_says(cell, pc):
    position = {f"Cart_{name}": value + 1.0 for name, value in HOME_POS.items()}
    pc.send(message(1, 3, Cart_E1=30.0, **position) | {"@Vel": 20.0, "@Acc": 30.0})
    assert cell.settle() == (1, 1, 0)
    kind, goal = cell.motions[-1]
    assert kind == "LIN"
    assert goal == {**{name: value + 1.0 for name, value in HOME_POS.items()}, "E1": 30.0}
    assert (cell.g["$VEL_EXTAX"], cell.g["$ACC_EXTAX"]) == ({1: 20.0}, {1: 30.0})


@pytest.mark.parametrize("frame", ["Tool_No", "Base_No"])
def test_message_for_another_tool_or_base_is_refused(cell, pc, frame):
    pc.send(message(1, 1, Axis_A1=5.0, **{frame: 1}))
    assert cell.settle() == (1, 1, 6)


@pytest.mark.parametrize(("mode", "number"), [("#T1", 1), ("#T2", 2), ("#AUT", 3), ("#EX", 4)])
def test_state_tells_the_mode_by_number(cell, pc, mode, number):
    cell.g["$MODE_OP"] = mode
    cell.cycle()
    assert pc.state()["Flags/@Mode"] == number


def test_two_messages_in_one_cycle_are_both_read(cell, pc):
    pc.send(message(1, 0))
    pc.send(message(2, 1, Axis_A1=5.0))
    assert cell.settle() == (2, 2, 0)
    assert not any(cell.queues.values())


def test_hold_message_breaks_the_motion_off(cell, pc):
    pc.send(message(1, 1, Axis_A1=5.0))
    cell.cycle(4)
    pc.send(message(2, 9))
    assert cell.settle() == (2, 2, 5)
    assert cell.arrived == [HOME]


def test_state_goes_on_while_the_cell_is_stopped(cell, pc):
    cell.set_stop(True)
    n_before = len(cell.told)
    cell.cycle(5)
    assert len(cell.told) == n_before + 5
    state = pc.state()
    assert (state["Flags/@Stop"], state["Flags/@Peri"], state["Flags/@Pro"]) == (1, 0, 0)


@pytest.mark.parametrize("tag", ["@Type", "Axis/@A3", "Cart/@T", "Base/@No"])
def test_missing_element_stops_everything_until_the_pc_connects_anew(cell, pc, tag):
    broken = message(1, 1, Axis_A1=5.0)
    del broken[tag]
    pc.send(broken)
    assert cell.settle() == (1, 1, 6)
    assert pc.state()["Flags/@Stop"] == 1
    pc.send(message(2, 1, Axis_A1=6.0))
    assert cell.settle() == (1, 1, 6)
    assert len(cell.motions) == 1
    pc.leave()
    pc.connect()
    assert pc.state()["Flags/@Stop"] == 0
    pc.send(message(2, 1, Axis_A1=7.0))
    assert cell.settle() == (2, 2, 0)
    assert cell.arrived[-1]["A1"] == 7.0


COMPARED = [
    *({"kind": 1, "A1": a1, "E1": e1} for a1 in (5.0, 200.0) for e1 in (100.0, -1.0, 4500.0)),
    {"kind": 0},
    {"kind": 4},
    {"kind": 9},
    {"kind": 1, "Vel": 0.0},
    {"kind": 1, "Acc": 200.0},
    {"kind": 1, "Tool": 2},
]


@pytest.mark.parametrize("members", COMPARED, ids=str)
def test_simulator_answers_as_the_program_does(cell, members):
    cell.write(1, **members)
    nowhere = CartesianPosition(0, 0, 0, 0, 0, 0, -1, -1, 0)
    what = Command(
        number=1,
        type=int(members["kind"]),
        velocity_pct=members.get("Vel", 50),
        acceleration_pct=members.get("Acc", 50),
        axes=np.array([members.get(name, HOME[name]) for name in AXES]),
        position=nowhere,
        tool=int(members.get("Tool", 0)),
    )
    machine = Machine(rail_range_mm=RAIL_MM, rail_acceleration_mm_per_s2=1e5)
    controller = Controller(EmptyScene(), ArmedFaults(), machine=machine, override_pct=100)
    try:
        controller.write(what)
        end = time.monotonic() + 10.0
        while controller.state.done != 1:
            assert time.monotonic() < end
            time.sleep(0.005)
        state = controller.state
    finally:
        controller.close()
    assert cell.settle() == (state.acknowledged, state.done, int(state.refusal))
