"""A serial line: bytes out and in, every failure a named error."""

import errno
import time
from typing import Any, Final

from drivers.room.options import SerialOptions
from tronlab.errors import (
    AccessDeniedError,
    DeviceError,
    DeviceTimeoutError,
    NotConnectedError,
    TronlabError,
)

_PARITY: Final = {"none": "N", "even": "E", "odd": "O"}
_POLL_S: Final = 0.02
_MAX_LINE_BYTES: Final = 4096


class SerialLine:
    """A serial port, or a URL that pyserial knows; nobody else can open it meanwhile.

    Once it failed it stays down until it is opened again, and every use raises the error it failed
    with: an answer that comes late would be taken for the answer to the next question.

    Args:
        options: Port and its settings.
        what: What hangs on it, as errors call it.
        device: Name of the device whose part this is.
    """

    def __init__(self, options: SerialOptions, *, what: str, device: str) -> None:
        self._options = options
        self._where = f"{what} at {options.path}"
        self._device = device
        self._port: Any = None
        self._pending = bytearray()
        self._why_down: tuple[type[NotConnectedError | DeviceTimeoutError], str] | None = None

    def open(self) -> None:
        """Open the port.

        Raises:
            NotConnectedError: There is no such port, or it cannot be set like this.
            AccessDeniedError: Another program has it open.
            TronlabError: pyserial is not installed.
        """
        try:
            import serial
        except ImportError:
            raise TronlabError(
                f"{self._device}: pyserial is not installed: pip install 'tronlab[lab]'"
            ) from None
        options = self._options
        self.close()
        try:
            self._port = serial.serial_for_url(
                options.path,
                baudrate=options.baud,
                bytesize=options.data_bits,
                parity=_PARITY[options.parity],
                stopbits=options.stop_bits,
                timeout=_POLL_S,
                write_timeout=options.timeout_s,
                exclusive=True,
            )
        except port_errors() as error:
            raise self._not_opened(error) from error

    def close(self) -> None:
        """Close the port; may be called twice."""
        self._why_down = None
        self._shut()

    def write(self, data: bytes) -> None:
        """Send bytes; when this returns the port has taken them.

        Raises:
            NotConnectedError: The port is not open, or was unplugged.
            DeviceTimeoutError: The other side does not let them through.
        """
        from serial import SerialTimeoutException

        port = self._opened()
        try:
            port.write(data)
        except SerialTimeoutException as error:
            raise self._no_answer() from error
        except port_errors() as error:
            raise self._lost() from error

    def read(self, *, until_s: float) -> bytes:
        """Give what has arrived, waiting for the first byte.

        Args:
            until_s: Monotonic time to wait until.

        Raises:
            DeviceTimeoutError: Nothing has arrived.
            NotConnectedError: As ``write``.
        """
        if self._pending:
            data = bytes(self._pending)
            self._pending.clear()
            return data
        while not (data := self._arrived()):
            if time.monotonic() >= until_s:
                raise self._no_answer()
        return data

    def read_line(self, *, until_s: float) -> bytes:
        """Give the next line without its end (LF or CR LF).

        Raises:
            DeviceTimeoutError: No line has ended.
            NotConnectedError: As ``write``.
        """
        while b"\n" not in self._pending:
            arrived = self._arrived()
            self._pending += arrived
            is_late = not arrived and time.monotonic() >= until_s
            if is_late or len(self._pending) > _MAX_LINE_BYTES:
                raise self._no_answer()
        line, _, rest = bytes(self._pending).partition(b"\n")
        self._pending[:] = rest
        return line.rstrip(b"\r")

    def discard(self) -> None:
        """Forget what has arrived: it answers nothing that is still of interest."""
        port = self._opened()
        self._pending.clear()
        try:
            port.reset_input_buffer()
        except port_errors() as error:
            raise self._lost() from error

    def deadline_s(self) -> float:
        """Give until when an answer to a request sent now must be there, monotonic seconds."""
        return time.monotonic() + self._options.timeout_s

    def _no_answer(self) -> DeviceError:
        received = f" (only {bytes(self._pending[:40])!r})" if self._pending else ""
        return self._fail(
            DeviceTimeoutError,
            f"no answer from the {self._where} in {self._options.timeout_s:g} s{received}",
        )

    def _arrived(self) -> bytes:
        port = self._opened()
        try:
            return bytes(port.read(max(1, port.in_waiting)))
        except port_errors() as error:
            raise self._lost() from error

    def _opened(self) -> Any:
        if self._port is None:
            kind, why = self._why_down or (NotConnectedError, f"{self._where}: not connected")
            raise kind(f"{why}; call connect() again", device=self._device)
        return self._port

    def _lost(self) -> DeviceError:
        return self._fail(NotConnectedError, f"lost the {self._where}; is it plugged in?")

    def _fail(self, kind: type[NotConnectedError | DeviceTimeoutError], why: str) -> DeviceError:
        self._shut()
        self._why_down = kind, why
        return kind(why, device=self._device)

    def _shut(self) -> None:
        port, self._port = self._port, None
        self._pending.clear()
        if port is not None:
            port.close()

    def _not_opened(self, error: Exception) -> DeviceError:
        number = getattr(error, "errno", None)
        if number in {errno.EAGAIN, errno.EACCES, errno.EBUSY}:
            return AccessDeniedError(
                f"cannot open the {self._where}: another program has it, or you may not use it",
                device=self._device,
            )
        return NotConnectedError(
            f"cannot open the {self._where}: {error}; check path, baud, data_bits, parity and"
            " stop_bits",
            device=self._device,
        )


def port_errors() -> tuple[type[Exception], ...]:
    """Give what pyserial raises; it lets the errors of POSIX terminals through."""
    try:
        from termios import error
    except ImportError:  # Windows
        return OSError, ValueError
    return OSError, ValueError, error
