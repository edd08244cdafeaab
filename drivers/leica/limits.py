"""What may be asked of a tracker; anything else is refused, never clipped."""

from typing import Final

from tronlab.errors import LimitError

SHORTEST_WINDOW_S: Final = 0.1
LONGEST_WINDOW_S: Final = 100.0
"""Averaging times of stationary measurements."""
SHORTEST_INTERVAL_S: Final = 0.001
LONGEST_INTERVAL_S: Final = 100.0
"""Times between the poses of a stream; how fast a tracker really is, it says itself."""
MOST_POSES: Final = 2**31 - 1
"""Of a stream: the largest number its command can carry."""


def check_window(window_s: float, call: str, *, device: str) -> None:
    """Return if a stationary measurement may average so long.

    Raises:
        LimitError: It may not.
    """
    if not SHORTEST_WINDOW_S <= window_s <= LONGEST_WINDOW_S:
        raise LimitError(
            f"{call}: window is {window_s:g} s, allowed {SHORTEST_WINDOW_S:g} to"
            f" {LONGEST_WINDOW_S:g} s",
            device=device,
        )


def check_stream(interval_s: float, n: int, call: str, *, device: str) -> None:
    """Return if there may be such a stream of poses.

    Raises:
        LimitError: There may not.
    """
    is_in_range = SHORTEST_INTERVAL_S <= interval_s <= LONGEST_INTERVAL_S
    if not (is_in_range and abs(interval_s * 1e3 - round(interval_s * 1e3)) < 1e-6):
        raise LimitError(
            f"{call}: interval is {interval_s:g} s, allowed {SHORTEST_INTERVAL_S:g} to"
            f" {LONGEST_INTERVAL_S:g} s in whole milliseconds",
            device=device,
        )
    if not 0 <= n <= MOST_POSES:
        raise LimitError(
            f"{call}: {n} poses, allowed are 0 (no end) to {MOST_POSES}", device=device
        )
