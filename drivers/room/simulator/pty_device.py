"""A pseudo-terminal at a fixed path, with a simulated serial device at its other end."""

import os
import select
import threading
import tty
from contextlib import suppress
from pathlib import Path
from typing import Final, Protocol

from tronlab.errors import ConfigError, NotConnectedError

_CHUNK_BYTES: Final = 4096
_IDLE_S: Final = 0.1


class SerialDevice(Protocol):
    """What is at the far end of a serial line."""

    def receive(self, data: bytes) -> bytes:
        """Take bytes as they come, in pieces of any size, and give what to send back."""
        ...

    def spontaneous(self) -> bytes:
        """Give what it sends unasked; called some ten times a second."""
        ...


class PtyDevice:
    """A serial device reached by opening a path, until closed.

    The path is a symbolic link to the pseudo-terminal, whose own name differs every time.

    Args:
        path: Where the link is made; a link that is there is replaced, a missing folder is made.
        device: What answers.

    Raises:
        ConfigError: Something else is at the path, or its folder cannot be made.
    """

    def __init__(self, path: Path, device: SerialDevice) -> None:
        self._path = path
        self._device = device
        self._ours, self._theirs = os.openpty()
        # Held open, their end survives that nobody has it open; raw, no byte means anything.
        for end in (self._ours, self._theirs):
            tty.setraw(end)
        self._terminal = os.ttyname(self._theirs)
        self._wake_read, self._wake_write = os.pipe()
        try:
            self._link()
        except ConfigError:
            self._close_files()
            raise
        self._thread = threading.Thread(target=self._run, name=f"pty {path.name}", daemon=True)
        self._thread.start()

    @property
    def address(self) -> tuple[str, str]:
        """Get ``pty`` and the path."""
        return "pty", str(self._path)

    def close(self) -> None:
        """Unplug it and remove the link; may be called twice."""
        if self._wake_write < 0:
            return
        os.write(self._wake_write, b"\0")
        self._thread.join()
        if self._path.is_symlink() and str(self._path.readlink()) == self._terminal:
            self._path.unlink()
        self._close_files()

    def _link(self) -> None:
        if self._path.exists() and not self._path.is_symlink():
            raise ConfigError(
                "exists and is no symbolic link; a simulated serial port is not put over it",
                path=self._path,
            )
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._path.unlink(missing_ok=True)
            self._path.symlink_to(self._terminal)
        except OSError as error:
            raise ConfigError(
                f"a simulated serial port cannot be made here: {error.strerror}", path=self._path
            ) from error

    def _run(self) -> None:
        while True:
            ready, _, _ = select.select([self._ours, self._wake_read], [], [], _IDLE_S)
            if self._wake_read in ready:
                return
            received = os.read(self._ours, _CHUNK_BYTES) if self._ours in ready else b""
            with suppress(NotConnectedError):  # whoever serves the laboratory is busy, or has ended
                answer = self._device.receive(received) if received else b""
                self._send(answer + self._device.spontaneous())

    def _send(self, data: bytes) -> None:
        """Send as much as fits: like on a real line, what nobody reads is lost."""
        _, writable, _ = select.select([], [self._ours], [], 0.0)
        if data and writable:
            os.write(self._ours, data)

    def _close_files(self) -> None:
        for file in (self._ours, self._theirs, self._wake_read, self._wake_write):
            os.close(file)
        self._wake_write = -1
