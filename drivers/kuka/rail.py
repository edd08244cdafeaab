"""The rail: what the controller counts on E1, its range, and coming to a target from below only.

The rack of such a rail has play of about 0.2 mm; seen always from the same side it does no harm.
"""

from drivers.kuka.options import KukaOptions
from tronlab.errors import LimitError

_SAME_M = 1e-7
"""Two places on the rail nearer than this are one: the controller is told no more digits."""


class Rail:
    """Plans how E1 comes to its targets."""

    def __init__(self, options: KukaOptions, *, device: str) -> None:
        self._options = options
        self._device = device
        self._seated_m: float | None = None

    def rail_m(self, e1_m: float) -> float:
        """Give the place on the rail of what the controller counts."""
        return self._options.rail_sign * (e1_m - self._options.rail_zero_mm * 1e-3)

    def e1_m(self, rail_m: float) -> float:
        """Give what the controller counts at a place on the rail."""
        return self._options.rail_zero_mm * 1e-3 + self._options.rail_sign * rail_m

    def check(self, rail_m: float, *, call: str) -> None:
        """Return if the rail can come to a place, from wherever it stands.

        Raises:
            LimitError: It cannot; the message has the range.
        """
        low, high = self._options.rail_range_m
        low += self._options.rail_approach_m
        if not low - _SAME_M <= rail_m <= high + _SAME_M:
            raise LimitError(
                f"{call}: rail position is {rail_m:.4f} m, allowed {low:.4f} to {high:.4f} m"
                f" (rail_range_m, of which the first {self._options.rail_approach_m:g} m are for"
                " the approach from below)",
                device=self._device,
            )

    def detour_m(self, target_m: float, *, now_m: float) -> float | None:
        """Give the place below the target to go to first; None where the way is from below anyway.

        A rail that was brought to where it stands from below may go on by any step; of one that
        was not, only a way as long as the approach is known to take up the play.
        """
        if self._options.rail_approach_m == 0.0:
            return None
        if self._seated_m is not None:
            is_from_below = target_m >= self._seated_m - _SAME_M
        else:
            is_from_below = target_m - now_m >= self._options.rail_approach_m - _SAME_M
        return None if is_from_below else target_m - self._options.rail_approach_m

    def leave(self) -> None:
        """Take note that the rail may move, and so may come to stand anywhere."""
        self._seated_m = None

    def arrive(self, rail_m: float) -> None:
        """Take note that the rail stands at a target, come from below."""
        self._seated_m = rail_m
