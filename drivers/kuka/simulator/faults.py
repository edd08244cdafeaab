"""Faults the simulated robot can be told to have."""

from collections.abc import Mapping
from typing import Final

SILENT: Final = "robot.silent"
DISCONNECT: Final = "robot.disconnect"
EMERGENCY_STOP: Final = "robot.emergency_stop"
GUARD_OPEN: Final = "robot.guard_open"
DRIVES_OFF: Final = "robot.drives_off"
WRONG_MODE: Final = "robot.wrong_mode"
STOP_MESSAGE: Final = "robot.stop_message"
STUCK: Final = "robot.stuck"
NOT_STILL: Final = "robot.not_still"
WRONG_ACK: Final = "robot.wrong_ack"
LOSES_POSITION: Final = "robot.loses_position"
SPLIT: Final = "robot.split"

FAULTS: Final[Mapping[str, str]] = {
    SILENT: "no state messages and no replies, though connections stay open",
    DISCONNECT: "once: every connection is closed",
    EMERGENCY_STOP: "an emergency stop is pressed: motion stops, drives are off",
    GUARD_OPEN: "the guard is open: motion stops, drives are off",
    DRIVES_OFF: "the drives are off",
    WRONG_MODE: "the key switch stands at T1",
    STOP_MESSAGE: "a stop message is pending",
    STUCK: "commands are accepted, and nothing moves",
    NOT_STILL: "the robot creeps on after it says it is done",
    WRONG_ACK: "another command is acknowledged than was sent",
    LOSES_POSITION: "once: a move ends 2 mm and 0.1 deg off, without an error",
    SPLIT: "messages arrive in small pieces",
}
"""Each by name, and what happens then. Those that happen once take one strike a time."""
