"""Stops the robot from wherever the wish comes, a signal handler too."""

import queue
import threading
from collections.abc import Callable
from types import TracebackType

from tronlab.devices.protocols import Robot

_PATIENCE_S = 5.0


class Brake:
    """A thread that waits for nothing but the wish to stop the robot.

    It is there before it is needed: a signal handler must not start threads, nor take locks.
    """

    def __init__(
        self, robot: Robot, *, warn: Callable[[str], None], patience_s: float = _PATIENCE_S
    ) -> None:
        self._robot = robot
        self._warn = warn
        self._patience_s = patience_s
        self._wishes: queue.SimpleQueue[bool] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._stand_by, name="tronlab brake", daemon=True)

    def pull(self) -> None:
        """Have the robot stopped, at once and whatever else goes on; does not wait for it."""
        self._wishes.put(True)

    def __enter__(self) -> "Brake":
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Wait until the robot is stopped, if somebody wished it: then it may be closed."""
        self._wishes.put(False)
        self._thread.join(timeout=self._patience_s)
        if self._thread.is_alive():
            self._warn(
                f"{self._robot.name}: did not answer to stop within {self._patience_s:g} s;"
                " see whether it stands still, and press the emergency stop if not"
            )

    def _stand_by(self) -> None:
        while self._wishes.get():
            try:
                self._robot.stop()
            except Exception as error:  # whatever it is, a person must know
                self._warn(
                    f"{error}; see whether the robot stands still, and press the emergency stop"
                    " if not"
                )
