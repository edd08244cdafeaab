"""What a run waits for, and how long."""

from dataclasses import dataclass
from typing import Literal, TypeAlias

from tronlab.campaign.config import SuspendConfig

Condition: TypeAlias = Literal["unsafe", "beam", "lamp", "disk"]
"""A door is open or an emergency stop pressed; the tracker has no beam; the light has changed;
there is little room on the disk."""

_GROWTH = 1.5
_MAX_PAUSE_S = 5.0


@dataclass(frozen=True, slots=True)
class Suspension:
    """A run waits, and goes on by itself."""

    task: str
    """Before which shot or drift check."""
    condition: Condition
    why: str

    def __str__(self) -> str:
        """Say what a person should know."""
        return f"waiting before {self.task}: {self.why}; the run goes on by itself"


class Patience:
    """Pauses between looks, which grow, for as long as the campaign wants to wait."""

    def __init__(self, config: SuspendConfig, now_s: float) -> None:
        self._give_up_s = now_s + config.timeout_s
        self._pause_s = config.look_s
        self._longest_s = max(config.look_s, _MAX_PAUSE_S)

    def next_pause_s(self, now_s: float) -> float | None:
        """Give how long to wait until the next look; None: long enough."""
        left_s = self._give_up_s - now_s
        if left_s <= 0.0:
            return None
        pause_s = min(self._pause_s, left_s)
        self._pause_s = min(_GROWTH * self._pause_s, self._longest_s)
        return pause_s
