"""Which error of tronlab stands for which of genicam."""

import pytest

pytest.importorskip("genicam", reason="needs the extra 'lab'")

from genicam import genapi, gentl

from drivers.gige.faults import named_errors
from tronlab.errors import (
    DeviceError,
    DeviceFaultError,
    LimitError,
    NotConnectedError,
    NotReadyError,
)


def text_of(message: str, number: int) -> str:
    """Write as genicam does."""
    return f"GenTL exception: It went wrong. (Message from the source: {message}) (ID: {number})"


ANSWERED = "WRITEREG 0x00020120: the camera answers status 0x"


@pytest.mark.parametrize(
    ("error", "named", "message"),
    [
        (
            gentl.TimeoutException(text_of("no answer", -1011)),
            NotConnectedError,
            r"^here: grab: the camera does not answer \(no answer\);.*connect again",
        ),
        (
            gentl.IoException(text_of("the camera was lost", -1010)),
            NotConnectedError,
            r"^here: grab: the camera does not answer \(the camera was lost\)",
        ),
        (
            gentl.AccessDeniedException(text_of(f"{ANSWERED}8006", -1005)),
            NotConnectedError,
            r"^here: grab: the camera no longer obeys.*0x8006",
        ),
        (
            genapi.OutOfRangeException("Value 77 must be at most 33.\nthrown in node"),
            LimitError,
            r"^here: grab: Value 77 must be at most 33\.$",
        ),
        (
            genapi.AccessException("Node is not writable."),
            DeviceError,
            r"^here: grab: Node is not writable\.$",
        ),
    ],
)
def test_error_is_named_with_device_and_call(error: Exception, named: type, message: str):
    with pytest.raises(named, match=message), named_errors("here", "grab"):
        raise error


@pytest.mark.parametrize(
    ("error", "named", "code"),
    [
        (gentl.IoException(text_of(f"{ANSWERED}8008", -1010)), DeviceFaultError, 0x8008),
        (gentl.AccessDeniedException(text_of(f"{ANSWERED}8004", -1005)), DeviceFaultError, 0x8004),
        (gentl.IoException(text_of(f"{ANSWERED}9abc", -1010)), DeviceFaultError, 0x9ABC),
        (gentl.BusyException(text_of(f"{ANSWERED}8007", -1022)), NotReadyError, 0x8007),
        (gentl.ErrorException(text_of("a vendor's own", -10042)), DeviceFaultError, -10042),
        (gentl.ErrorException("unheard of"), DeviceFaultError, -1001),
    ],
)
def test_number_of_a_fault_is_carried_through(error: Exception, named: type, code: int):
    with pytest.raises(named) as caught, named_errors("here", "grab"):
        raise error
    assert caught.value.code == code


def test_other_errors_pass():
    with pytest.raises(ZeroDivisionError), named_errors("here", "grab"):
        raise ZeroDivisionError
