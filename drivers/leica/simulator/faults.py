"""Faults that the simulated tracker can be told to have.

Those that last hold while armed; all others hit once for each time they are armed, so that one
armed for ever lasts too.
"""

from typing import Final

BEAM_BROKEN: Final = "tracker.beam_broken"
BEAM_BREAKS: Final = "tracker.beam_breaks"
WARMING_UP: Final = "tracker.warming_up"
BUSY: Final = "tracker.busy"
POSE_INVALID: Final = "tracker.pose_invalid"
PROBE_MISSING: Final = "tracker.probe_missing"
SILENT: Final = "tracker.silent"
DISCONNECT: Final = "tracker.disconnect"
REFUSE_CLIENT: Final = "tracker.refuse_client"
SPLIT: Final = "tracker.split"
EVENTS: Final = "tracker.events"
WRONG_REFLECTOR: Final = "tracker.wrong_reflector"
UNKNOWN_CODE: Final = "tracker.unknown_code"
ERROR_PACKET: Final = "tracker.error_packet"

FAULTS: Final[dict[str, str]] = {
    BEAM_BROKEN: "lasts: nothing reaches the tracker; error 64/701 at once when it was locked",
    BEAM_BREAKS: "the beam breaks during a measurement: error 64/701 and no result",
    WARMING_UP: "status 10012 to what moves or measures; the laser says it is heating",
    BUSY: "status 1 to what moves or measures",
    POSE_INVALID: "event 99; a 6-D measurement ends with error 93, or its rotation status says so",
    PROBE_MISSING: "no T-MAC is recognised: status 75 in 6-D modes",
    SILENT: "no answer and no result",
    DISCONNECT: "closes the connection at the next command",
    REFUSE_CLIENT: "a new client gets error 10011 and is closed",
    SPLIT: "lasts: packets arrive in pieces of 1 to 7 bytes",
    EVENTS: "lasts: events and live positions arrive between a request and its reply",
    WRONG_REFLECTOR: "SetReflector answers 0 and changes nothing",
    UNKNOWN_CODE: "the next command is answered with status 31999",
    ERROR_PACKET: "a measurement ends with error packet 49/10009 in place of its result",
}
"""Every fault by name, and what happens then."""
