"""Faults the simulated camera can be told to have."""

import threading
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Final

from tronlab.twin.state import FOR_EVER, Faults

_PATIENCE_S: Final = 0.005

FAULTS: Final[Mapping[str, str]] = {
    "camera.lose_packets": "one payload packet of a hundred is not sent at first (lasting)",
    "camera.lose_frame": "a frame is never sent, nor held for resend",
    "camera.incomplete": "a frame lacks packets, and their resend is refused",
    "camera.silent": "no command is done or answered (lasting)",
    "camera.gone": "neither commands nor stream; afterwards as after power-up (lasting)",
    "camera.ignores_trigger": "a software trigger is acknowledged, but no frame is taken",
    "camera.held": "another application holds the camera (lasting)",
    "camera.slow_command": "a write is answered by PENDING_ACK, and a second later by its result",
    "camera.bad_packets": "garbage between the packets of the stream (lasting)",
}
"""By name; those not called lasting strike once each time they are armed for."""


class PromptFaults:
    """Faults of a shared laboratory; to look at one never takes long.

    A driver may hold Python's interpreter lock while it waits for the camera, as GenTL consumers
    do. Where the laboratory is kept in the driver's own process, a camera that waited for it would
    never answer: so after a moment this goes by what it knew before.
    """

    def __init__(self, faults: Faults) -> None:
        self._faults = faults
        self._known: dict[str, bool] = {}
        self._asked: Future[None] | None = None
        self._asker = ThreadPoolExecutor(1, "camera faults")
        self._lock = threading.Lock()

    def is_armed(self, name: str) -> bool:
        """Look whether a fault is armed, or was when this could be found out last.

        Raises:
            NotConnectedError: The laboratory has ended.
        """
        with self._lock:
            if self._asked is None or self._asked.done():
                self._asked = self._asker.submit(self._look, name)
                wait([self._asked], timeout=_PATIENCE_S)
                if self._asked.done():
                    self._asked.result()
            return self._known.get(name, False)

    def strike(self, name: str) -> bool:
        """Use a fault up once; this takes as long as it takes."""
        return self._faults.strike(name)

    def arm(self, name: str, *, times: int = FOR_EVER) -> None:
        """Arm a fault for so many strikes; 0 clears it."""
        self._faults.arm(name, times=times)

    def _look(self, name: str) -> None:
        self._known[name] = self._faults.is_armed(name)
