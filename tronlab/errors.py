"""Every error tronlab raises on purpose, as one tree.

A message says what went wrong, where, the offending value and what is allowed; where the user can
do something about it, its last line says what. The command line prints these messages as they
are and keeps tracebacks for our own mistakes.
"""

from collections.abc import Sequence
from pathlib import Path


class TronlabError(Exception):
    """Base of every error that is not a programming mistake."""


class ConfigError(TronlabError):
    """A configuration file says something that cannot be."""

    def __init__(
        self,
        message: str,
        *,
        path: Path | str | None = None,
        line: int | None = None,
        key: str | None = None,
    ) -> None:
        self.path = Path(path) if path is not None else None
        self.line = line
        self.key = key
        self.parts: tuple[ConfigError, ...] = (self,)
        """The single errors, where one stands for several."""
        super().__init__(": ".join([*self._where(), message]))

    def _where(self) -> list[str]:
        where: list[str] = []
        if self.path is not None:
            where.append(f"{self.path}:{self.line}" if self.line is not None else str(self.path))
        if self.key:
            where.append(self.key)
        return where


class DeviceError(TronlabError):
    """A device did not do what it was told; the message names the device and the command."""

    def __init__(self, message: str, *, device: str) -> None:
        self.device = device
        super().__init__(f"{device}: {message}")


class NotConnectedError(DeviceError):
    """The device cannot be reached, was lost, or was used before ``connect``."""


class AccessDeniedError(NotConnectedError):
    """The device answers, but another client holds it."""


class DeviceTimeoutError(DeviceError, TimeoutError):
    """The device did not answer in the time allowed."""


class ProtocolError(DeviceError):
    """The device answered something its protocol does not allow."""

    def __init__(self, message: str, *, device: str, sent: bytes, received: bytes) -> None:
        self.sent = sent
        self.received = received
        super().__init__(
            f"{message} (sent {sent.hex(' ')}; received {received.hex(' ')})", device=device
        )


class DeviceFaultError(DeviceError):
    """The device reports a fault of its own, by number."""

    def __init__(self, message: str, *, device: str, code: int) -> None:
        self.code = code
        super().__init__(f"{message} (code {code})", device=device)


class NotReadyError(DeviceFaultError):
    """The device says it cannot yet: warming up, busy, not initialised. Retryable."""


class SafetyError(DeviceError):
    """The cell is not safe: a door is open, an emergency stop is pressed.

    It is only read, never overridden; a campaign waits until a person has made the cell safe.
    """


class TrackingLostError(DeviceError):
    """The tracker has no target: beam broken, target out of view. Retryable."""


class NotSettledError(DeviceError):
    """The measured pose still moves more than the campaign allows. Retryable."""


class IncompleteFrameError(DeviceError):
    """Parts of an image were lost on the way. Retryable."""


class QualityError(DeviceError):
    """A shot is not as good as the campaign wants, and shall be taken again. Retryable."""


class LimitError(DeviceError):
    """A command lies outside what the device may do. Never retried, never clipped."""


class FrameError(TronlabError):
    """An unknown frame, two frames without a path between them, or a loop that does not close."""


class CalibrationError(TronlabError):
    """A calibration cannot be computed, or must not be used here."""


class DegenerateGeometryError(CalibrationError):
    """The measurements do not determine the answer; the message says which part of it."""


class DatasetError(TronlabError):
    """A dataset cannot be read or written."""


class SchemaVersionError(DatasetError):
    """The dataset was written in a layout this version does not know."""


class IntegrityError(DatasetError):
    """The dataset contradicts itself or is damaged; ``items`` lists every finding."""

    def __init__(self, message: str, *, items: Sequence[str] = ()) -> None:
        self.items = tuple(items)
        super().__init__("\n".join([message, *(f"  - {item}" for item in self.items)]))


class PlanError(TronlabError):
    """The list of shots makes no sense: empty, or one id twice."""


class ChangedError(TronlabError):
    """Plan, rig or calibration are not those that a dataset was begun with."""


class ScoreError(TronlabError):
    """A score cannot be computed: an unknown navigation core, or nothing to score."""
