import pytest

from tronlab.errors import DeviceFaultError, DeviceTimeoutError, TrackingLostError
from tronlab.twin.config import FaultSpec
from tronlab.twin.faults import FaultScript


def script_of(*faults: FaultSpec, moves: list[object] | None = None) -> FaultScript:
    """Make a script that notes where the tracker is moved."""
    return FaultScript(faults, move_tracker=([] if moves is None else moves).append)


def strikes(script: FaultScript, device: str, call: str, *, n: int) -> list[int]:
    """Call n times and give the numbers of the calls that failed."""
    failed = []
    for i in range(1, n + 1):
        try:
            script.count(device, call, name=device)
        except (DeviceFaultError, DeviceTimeoutError, TrackingLostError):
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
    ("error", "type_", "message"),
    [
        ("tracking_lost", TrackingLostError, r"AT901: measure_pose: the beam is broken"),
        ("timeout", DeviceTimeoutError, r"AT901: measure_pose: no answer \(scripted, call 1\)"),
        ("fault", DeviceFaultError, r"reports a fault \(scripted, call 1\) \(code 900\)"),
    ],
)
def test_error_is_the_one_asked_for(error: str, type_: type[Exception], message: str):
    fault = FaultSpec.model_validate(
        {"device": "tracker", "call": "measure_pose", "at": 1, "error": error}
    )
    with pytest.raises(type_, match=message):
        script_of(fault).count("tracker", "measure_pose", name="AT901")


def test_a_tracker_is_moved_and_measures_all_the_same():
    fault = FaultSpec(
        device="tracker", call="measure_pose", at=2, times=2, error="moved", moved_m=(0, 1e-3, 0)
    )
    moves: list[object] = []
    assert strikes(script_of(fault, moves=moves), "tracker", "measure_pose", n=4) == []
    assert moves == [(0, 1e-3, 0)] * 2
