"""What a campaign does about an error of a device."""

import pytest

from tronlab.campaign.policy import MAX_ATTEMPTS, PAUSES_S, Remedy, Setbacks, remedy_for
from tronlab.errors import (
    AccessDeniedError,
    DatasetError,
    DeviceError,
    DeviceFaultError,
    DeviceTimeoutError,
    IncompleteFrameError,
    LimitError,
    NotConnectedError,
    NotReadyError,
    NotSettledError,
    ProtocolError,
    SafetyError,
    TrackingLostError,
)


@pytest.mark.parametrize(
    ("error", "remedy"),
    [
        (SafetyError("door", device="room"), Remedy.WAIT),
        (SafetyError("emergency stop", device="robot"), Remedy.WAIT),
        (TrackingLostError("beam", device="tracker"), Remedy.RETRY),
        (NotSettledError("moves", device="tracker"), Remedy.RETRY),
        (IncompleteFrameError("packets", device="camera"), Remedy.RETRY),
        (NotReadyError("warming up", device="tracker", code=1), Remedy.RETRY),
        (NotReadyError("busy", device="robot", code=1), Remedy.RETRY),
        (NotConnectedError("lost", device="camera"), Remedy.RECONNECT),
        (DeviceTimeoutError("silent", device="room"), Remedy.RECONNECT),
        (NotConnectedError("lost", device="robot"), Remedy.STOP),
        (DeviceTimeoutError("silent", device="robot"), Remedy.STOP),
        (AccessDeniedError("held", device="camera"), Remedy.STOP),
        (DeviceFaultError("broken", device="tracker", code=7), Remedy.STOP),
        (LimitError("too far", device="robot"), Remedy.STOP),
        (ProtocolError("nonsense", device="room", sent=b"", received=b"?"), Remedy.STOP),
        (DeviceError("odd", device="camera"), Remedy.STOP),
        (DatasetError("disk full"), Remedy.STOP),
        (ZeroDivisionError(), Remedy.STOP),
        (None, Remedy.STOP),
    ],
)
def test_every_error_has_its_remedy(error: BaseException | None, remedy: Remedy):
    assert remedy_for(error) is remedy


def test_there_is_a_pause_before_every_retry():
    assert len(PAUSES_S) == MAX_ATTEMPTS - 1


def test_every_setback_begins_another_attempt():
    assert Setbacks().attempt == 1
    assert Setbacks(failures=2, suspensions=3).attempt == 6
