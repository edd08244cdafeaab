"""From what harvesters and genicam raise to the errors of tronlab."""

import re
from collections.abc import Generator
from contextlib import contextmanager
from typing import Final

from genicam import genapi, gentl

from tronlab.errors import (
    DeviceError,
    DeviceFaultError,
    LimitError,
    NotConnectedError,
    NotReadyError,
)

GENICAM_ERRORS: Final = (gentl.GenericException, genapi.GenericException)
"""Everything genicam raises on purpose."""

_LOST: Final = (
    gentl.TimeoutException,
    gentl.IoException,
    gentl.InvalidHandleException,
    gentl.NotInitializedException,
    gentl.ClosedException,
    gentl.AbortException,
)
_REFUSED: Final = (genapi.OutOfRangeException, genapi.InvalidArgumentException)
_ACCESS_DENIED: Final = 0x8006
_BUSY: Final = 0x8007
_RECONNECT: Final = "check its power and cable, then connect again"


@contextmanager
def named_errors(device: str, call: str) -> Generator[None]:
    """Name device and call in whatever goes wrong inside.

    Raises:
        NotConnectedError: The camera does not answer, or no longer obeys this application.
        LimitError: It refuses a value.
        NotReadyError: It is busy.
        DeviceFaultError: It reports a fault of its own.
    """
    try:
        yield
    except GENICAM_ERRORS as error:
        raise _named(error, device=device, call=call) from error


def _named(error: Exception, *, device: str, call: str) -> DeviceError:
    what, status = first_line(error), _device_status(error)
    if isinstance(error, _REFUSED):
        return LimitError(f"{call}: {what}", device=device)
    if isinstance(error, genapi.GenericException):
        return DeviceError(f"{call}: {what}", device=device)
    if status == _BUSY:
        return NotReadyError(f"{call}: the camera is busy; {what}", device=device, code=status)
    if status is not None and status != _ACCESS_DENIED:
        return DeviceFaultError(f"{call}: {what}", device=device, code=status)
    return _named_by_producer(error, device=device, call=call)


def _named_by_producer(error: Exception, *, device: str, call: str) -> DeviceError:
    what = first_line(error)
    if isinstance(error, gentl.AccessDeniedException):
        return NotConnectedError(
            f"{call}: the camera no longer obeys: it was restarted, or another application "
            f"took it ({what}); {_RECONNECT}",
            device=device,
        )
    if isinstance(error, _LOST):
        return NotConnectedError(
            f"{call}: the camera does not answer ({what}); {_RECONNECT}", device=device
        )
    return DeviceFaultError(f"{call}: {what}", device=device, code=_number(error))


def first_line(error: Exception) -> str:
    """Give what an error of genicam says, without where in genicam it was raised."""
    text = str(error).partition("\n")[0]
    message = re.search(r"\(Message from the source: (.*)\) \(ID:", text)
    return (message[1] if message else text).strip()


def _device_status(error: Exception) -> int | None:
    """Give the status code of GigE Vision a camera answered, where our own producer tells it."""
    status = re.search(r"the camera answers status 0x([0-9a-f]{4})", str(error))
    return int(status[1], 16) if status else None


def _number(error: Exception) -> int:
    """Give the number of a GenTL error (GenTL standard 1.5, GC_ERROR)."""
    number = re.search(r"\(ID: (-?\d+)\)", str(error))
    return int(number[1]) if number else int(gentl.GC_ERROR_LIST.GC_ERR_ERROR)
