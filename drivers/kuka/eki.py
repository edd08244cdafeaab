"""Messages of the two EthernetKRL channels: XML documents without prolog, length or terminator.

Every element that EthernetKRL receives has a memory of its own. A command that lacks one would
shift that memory against the others for good, so a command always has all of them.
"""

import time
from collections.abc import Callable, Iterator
from typing import Final, TypeVar
from xml.etree import ElementTree

from scipy.spatial.transform import RigidTransform

from drivers.kuka.backend import FREE, Command, ControllerState, Mode
from drivers.kuka.position import Axes, pose_from_xyz_mm_abc_deg, xyz_mm_abc_deg
from tronlab.errors import ProtocolError
from tronlab.kinematics.kr16 import AXIS_NAMES

COMMAND_ROOT: Final = "RobotCommand"
COMMAND_TAGS: Final = {
    "": ("Id", "Type", "Vel", "Acc"),
    "Axis": (*AXIS_NAMES, "E1"),
    "Cart": ("X", "Y", "Z", "A", "B", "C", "S", "T", "E1"),
    "Tool": ("No",),
    "Base": ("No",),
}
"""Attributes of the root of a command (``""``) and of each of its children."""

STATE_ROOT: Final = "RobotState"
STATE_TAGS: Final = {
    "": ("Seq", "Ack", "Done", "Err"),
    "Axis": (*AXIS_NAMES, "E1"),
    "Pos": ("X", "Y", "Z", "A", "B", "C", "S", "T", "E1"),
    "Flags": ("Move", "Stop", "Peri", "Estop", "Safe", "Mode", "Ov", "Pro"),
}
"""Attributes of the root of a state (``""``) and of each of its children."""

_MODES = {1: Mode.T1, 2: Mode.T2, 3: Mode.AUT, 4: Mode.EXT}
_LONGEST_STATE = 65_534
"""Bytes: the largest buffer EthernetKRL can be given."""

T = TypeVar("T")


def encode_command(command: Command, command_id: int) -> bytes:
    """Write a command as EthernetKRL reads it; its tool and base are number 0."""
    axes = [_real(a) for a in (*command.axes.arm_deg, command.axes.e1_mm)]
    cartesian = [
        *map(_real, xyz_mm_abc_deg(command.base_from_flange)),
        str(FREE),
        str(FREE),
        _real(command.axes.e1_mm),
    ]
    numbers = [command_id, int(command.kind), command.velocity_pct, command.acceleration_pct]
    values = {
        "": [str(number) for number in numbers],
        "Axis": axes,
        "Cart": cartesian,
        "Tool": ["0"],
        "Base": ["0"],
    }
    children = "".join(
        f"<{child} {_attributes(child, values[child])}></{child}>"
        for child in COMMAND_TAGS
        if child
    )
    return f"<{COMMAND_ROOT} {_attributes('', values[''])}>{children}</{COMMAND_ROOT}>".encode()


def decode_state(document: bytes, *, device: str) -> ControllerState:
    """Read a state.

    Raises:
        ProtocolError: It is no XML, or an attribute is missing or no number.
    """
    return _StateReader(document, device).state()


def decode_position(document: bytes, *, device: str) -> RigidTransform:
    """Read the Cartesian position of a state, metres.

    Raises:
        ProtocolError: As ``decode_state``.
    """
    return _StateReader(document, device).position()


class DocumentReader:
    """Cuts a stream of bytes into documents, however TCP has split or joined them."""

    def __init__(self, root: str, *, device: str) -> None:
        self._start = f"<{root}".encode()
        self._end = f"</{root}>".encode()
        self._device = device
        self._buffer = b""

    def feed(self, received: bytes) -> Iterator[bytes]:
        """Take bytes as they arrive and give every document that is complete.

        Raises:
            ProtocolError: Something else than such documents arrives.
        """
        self._buffer += received
        while True:
            self._buffer = self._buffer.lstrip()
            if not self._buffer.startswith(self._start[: len(self._buffer)]):
                raise self._error(f"expected a document {self._start.decode()}>")
            end = self._buffer.find(self._end)
            if end < 0:
                break
            end += len(self._end)
            document, self._buffer = self._buffer[:end], self._buffer[end:]
            yield document
        if len(self._buffer) > _LONGEST_STATE:
            raise self._error(f"a document does not end within {_LONGEST_STATE} bytes")

    def _error(self, what: str) -> ProtocolError:
        return ProtocolError(
            f"state channel: {what}", device=self._device, sent=b"", received=self._buffer[:80]
        )


class _StateReader:
    def __init__(self, document: bytes, device: str) -> None:
        self._document = document
        self._device = device
        if b"<!" in document:  # no entities: the document is data from a network
            raise self._error("has a declaration or comment, allowed are elements only")
        try:
            self._root = ElementTree.fromstring(document)  # noqa: S314  # checked above
        except ElementTree.ParseError as error:
            raise self._error(f"is no XML: {error}") from None

    def state(self) -> ControllerState:
        arm_deg = [self._real("Axis", name) for name in AXIS_NAMES]
        return ControllerState(
            reading=self._int("", "Seq"),
            accepted_id=self._int("", "Ack"),
            done_id=self._int("", "Done"),
            error=self._int("", "Err"),
            axes=Axes.from_controller(arm_deg, self._real("Axis", "E1")),
            is_moving=self._flag("Move"),
            has_stop_message=self._flag("Stop"),
            are_drives_on=self._flag("Peri"),
            is_emergency_stop_released=self._flag("Estop"),
            is_guard_closed=self._flag("Safe"),
            mode=self._value("Flags", "Mode", lambda text: _MODES[int(text)], "1 to 4"),
            override_pct=self._int("Flags", "Ov"),
            is_program_active=self._flag("Pro"),
            time_s=time.time(),
        )

    def position(self) -> RigidTransform:
        values = [self._real("Pos", name) for name in STATE_TAGS["Pos"][:6]]
        return pose_from_xyz_mm_abc_deg(values)

    def _real(self, child: str, attribute: str) -> float:
        return self._value(child, attribute, _finite, "a number")

    def _int(self, child: str, attribute: str) -> int:
        return self._value(child, attribute, int, "a whole number")

    def _flag(self, attribute: str) -> bool:
        return self._value("Flags", attribute, {"0": False, "1": True}.__getitem__, "0 or 1")

    def _value(self, child: str, attribute: str, read: Callable[[str], T], allowed: str) -> T:
        element = self._root.find(child) if child else self._root
        text = None if element is None else element.get(attribute)
        where = "/".join(filter(None, (STATE_ROOT, child, f"@{attribute}")))
        if text is None:
            raise self._error(f"lacks {where}")
        try:
            return read(text.strip())
        except (KeyError, ValueError):
            raise self._error(f"{where} is '{text}', allowed is {allowed}") from None

    def _error(self, what: str) -> ProtocolError:
        return ProtocolError(
            f"state channel: the state {what}",
            device=self._device,
            sent=b"",
            received=self._document,
        )


def _attributes(child: str, values: list[str]) -> str:
    pairs = zip(COMMAND_TAGS[child], values, strict=True)
    return " ".join(f'{name}="{value}"' for name, value in pairs)


def _real(value: float) -> str:
    """Write a REAL, without an exponent: to a micrometre's thousandth or a microdegree."""
    return f"{round(value, 6) + 0.0:.6f}"  # + 0.0 makes -0.0 into 0.0


def _finite(text: str) -> float:
    value = float(text)
    if value - value != 0.0:
        raise ValueError(text)
    return value
