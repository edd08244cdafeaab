import pytest
from pydantic import ValidationError

from tronlab.errors import (
    DeviceError,
    DeviceFaultError,
    DeviceTimeoutError,
    IncompleteFrameError,
    NotConnectedError,
    NotReadyError,
    SafetyError,
    TrackingLostError,
)
from tronlab.twin.config import FaultSpec
from tronlab.twin.faults import FaultScript


class Laboratory:
    """Notes what happens to it."""

    def __init__(self) -> None:
        self.happened: list[object] = []

    def move_tracker(self, shift_m: object) -> None:
        self.happened.append(shift_m)

    def open_door(self, *, is_open: bool) -> None:
        self.happened.append("open" if is_open else "closed")

    def dim_lamp(self, level: float) -> None:
        self.happened.append(level)


def script_of(*faults: FaultSpec, laboratory: Laboratory | None = None) -> FaultScript:
    return FaultScript(faults, laboratory=laboratory or Laboratory())


def strikes(script: FaultScript, device: str, call: str, *, n: int) -> list[int]:
    """Call n times and give the numbers of the calls that failed."""
    failed = []
    for i in range(1, n + 1):
        try:
            script.count(device, call, name=device)
        except DeviceError:
            failed.append(i)
    return failed


def test_fault_strikes_once_at_its_call():
    fault = FaultSpec(device="tracker", call="measure_pose", at=3, error="tracking_lost")
    script = script_of(fault)
    assert strikes(script, "tracker", "measure_point", n=5) == []
    assert strikes(script, "tracker", "measure_pose", n=10) == [3]


def test_fault_strikes_several_times_in_a_row():
    fault = FaultSpec(device="camera", call="grab", at=2, times=3, error="timeout")
    assert strikes(script_of(fault), "camera", "grab", n=8) == [2, 3, 4]


@pytest.mark.parametrize(
    ("error", "device", "call", "type_", "message"),
    [
        ("tracking_lost", "tracker", "measure_pose", TrackingLostError, "the beam is broken"),
        ("timeout", "tracker", "measure_pose", DeviceTimeoutError, "no answer"),
        ("lost", "camera", "grab", NotConnectedError, "the connection is lost"),
        ("fault", "room", "read", DeviceFaultError, "the device reports a fault"),
        ("not_ready", "robot", "move", NotReadyError, "the device is busy"),
        ("unsafe", "robot", "move", SafetyError, "an emergency stop is pressed"),
        ("incomplete_frame", "camera", "grab", IncompleteFrameError, "parts of the image are"),
    ],
)
def test_error_is_the_one_asked_for(
    error: str, device: str, call: str, type_: type[DeviceError], message: str
):
    fault = FaultSpec.model_validate({"device": device, "call": call, "at": 1, "error": error})
    with pytest.raises(type_, match=rf"X1: {call}: {message}.* \(scripted, call 1\)") as caught:
        script_of(fault).count(device, call, name="X1")
    assert type(caught.value) is type_


def test_a_tracker_is_moved_and_measures_all_the_same():
    fault = FaultSpec(
        device="tracker", call="measure_pose", at=2, times=2, error="moved", moved_m=(0, 1e-3, 0)
    )
    laboratory = Laboratory()
    script = script_of(fault, laboratory=laboratory)
    assert strikes(script, "tracker", "measure_pose", n=4) == []
    assert laboratory.happened == [(0, 1e-3, 0)] * 2


def test_door_and_lamp_are_as_before_after_so_many_calls():
    door = FaultSpec(device="room", call="read", at=2, times=2, error="door_open")
    lamp = FaultSpec(device="camera", call="grab", at=1, times=3, error="dimmed", lamp_level=0.7)
    laboratory = Laboratory()
    script = script_of(door, lamp, laboratory=laboratory)
    seen: list[object] = []
    for _ in range(4):
        assert strikes(script, "room", "read", n=1) == []
        seen.append(laboratory.happened[-1] if laboratory.happened else None)
    assert seen == [None, "open", "open", "closed"]
    assert strikes(script, "camera", "grab", n=4) == []
    assert laboratory.happened[2:] == [0.7, 1.0]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"call": "connect", "error": "incomplete_frame"}, "incomplete_frame strikes grab only"),
        ({"call": "grab", "error": "dimmed"}, "lamp_level: says how much for error: dimmed"),
        ({"call": "grab", "error": "fault", "lamp_level": 0.5}, "lamp_level: says how much"),
        ({"call": "grab", "error": "dimmed", "lamp_level": 1.0}, "less than 1"),
    ],
)
def test_a_script_that_makes_no_sense_is_refused(values: dict[str, object], message: str):
    with pytest.raises(ValidationError, match=message):
        FaultSpec.model_validate({"device": "camera", "at": 1} | values)
