"""Into the controller through its variables: the robot program watches globals named LAB_....

A command is written member by member, its number LAB_SEQ last: the program looks at nothing else
until that changes.
"""

import itertools
import threading
import time
from collections.abc import Callable
from typing import Final, TypeVar

from scipy.spatial.transform import RigidTransform

from drivers.kuka.backend import (
    FREE,
    MAKER,
    Command,
    CommandKind,
    ControllerState,
    Mode,
    next_id,
)
from drivers.kuka.krl_values import (
    format_axes,
    format_position,
    parse_axes,
    parse_bool,
    parse_enum,
    parse_position,
    parse_text,
)
from drivers.kuka.kvp import KvpClient
from drivers.kuka.options import KvpOptions
from tronlab.devices.readings import DeviceIdentity
from tronlab.errors import DeviceError, ProtocolError

SEQ: Final = "LAB_SEQ"
CMD: Final = "LAB_CMD"
AXIS: Final = "LAB_AXIS"
POS: Final = "LAB_POS"
VEL: Final = "LAB_VEL"
ACC: Final = "LAB_ACC"
ACK: Final = "LAB_ACK"
DONE: Final = "LAB_DONE"
ERR: Final = "LAB_ERR"

_MODES = {"T1": Mode.T1, "T2": Mode.T2, "AUT": Mode.AUT, "EX": Mode.EXT, "EXT": Mode.EXT}
_ACTIVE = "P_ACTIVE"

T = TypeVar("T")


class KvpBackend:
    """Asks for every part of the state, and writes commands, one variable after the other."""

    def __init__(self, host: str, options: KvpOptions, *, timeout_s: float, device: str) -> None:
        self._client = KvpClient(host, options.port, timeout_s=timeout_s, device=device)
        self._device = device
        self._command = threading.Lock()
        self._last_id = 0
        self._readings = itertools.count(1)

    def connect(self) -> None:
        """Open the connection, and go on counting commands where the last client stopped."""
        self._client.connect(call="connect")
        try:
            self._last_id = max(self._get(name, int, call="connect") for name in (SEQ, ACK, DONE))
        except DeviceError:
            self.close()
            raise

    def close(self) -> None:
        """Close the connection."""
        self._client.close()

    def identify(self, *, call: str) -> DeviceIdentity:
        """Read model and serial number."""
        return read_identity(self._client, call=call)

    def state(self, *, call: str) -> ControllerState:
        """Read the state; its parts are of slightly different times.

        What finishes a command is read before what it left behind, so that a command that is done
        is never seen with the error, motion or axes of before.
        """
        return ControllerState(
            reading=next(self._readings),
            accepted_id=self._get(ACK, int, call=call),
            done_id=self._get(DONE, int, call=call),
            error=self._get(ERR, int, call=call),
            is_moving=self._get("$PRO_MOVE", parse_bool, call=call),
            has_stop_message=self._get("$STOPMESS", parse_bool, call=call),
            are_drives_on=self._get("$PERI_RDY", parse_bool, call=call),
            is_emergency_stop_released=self._get("$ALARM_STOP", parse_bool, call=call),
            is_guard_closed=self._get("$USER_SAF", parse_bool, call=call),
            mode=self._get("$MODE_OP", lambda text: _MODES[parse_enum(text)], call=call),
            override_pct=self._get("$OV_PRO", int, call=call),
            is_program_active=self._get("$PRO_STATE1", parse_enum, call=call) == _ACTIVE,
            axes=self._get("$AXIS_ACT_MEAS", parse_axes, call=call),
            time_s=time.time(),
        )

    def position(self, *, call: str) -> RigidTransform:
        """Read the Cartesian position."""
        return self._get("$POS_ACT_MES", parse_position, call=call)

    def send(self, command: Command, *, call: str) -> int:
        """Write a command, its number last."""
        with self._command:
            command_id = next_id(self._last_id)
            self._last_id = command_id  # used up, even if it is lost on the way
            for name, value in self._members(command):
                self._client.write(name, value, call=call)
            self._client.write(SEQ, str(command_id), call=call)
        return command_id

    def _members(self, command: Command) -> list[tuple[str, str]]:
        kind = (CMD, str(int(command.kind)))
        if command.kind is CommandKind.HOLD:
            return [kind]  # the rest still belongs to the motion that is to be held
        position = format_position(command.base_from_flange, command.axes, status=FREE, turn=FREE)
        return [
            (AXIS, format_axes(command.axes)),
            (POS, position),
            (VEL, str(command.velocity_pct)),
            (ACC, str(command.acceleration_pct)),
            kind,
        ]

    def _get(self, name: str, parse: Callable[[str], T], *, call: str) -> T:
        text = self._client.read(name, call=call)
        try:
            return parse(text)
        except (KeyError, ValueError) as error:
            raise ProtocolError(
                f"{call}: {name} cannot be read: {error}",
                device=self._device,
                sent=name.encode(),
                received=text.encode(),
            ) from None


def read_identity(client: KvpClient, *, call: str) -> DeviceIdentity:
    """Read model and serial number of the robot from the controller's variables."""
    return DeviceIdentity(
        maker=MAKER,
        model=parse_text(client.read("$MODEL_NAME[]", call=call)).removeprefix("#"),
        serial=parse_text(client.read("$KR_SERIALNO", call=call)),
        firmware="",
    )
