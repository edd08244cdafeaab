"""What a pose is found from: image positions and the points they show."""

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from tronlab.geometry.poses import FloatArray

MIN_POINTS = 6
"""EPnP is defined from four points on; below six its answer is not worth having."""


class NoPoseError(Exception):
    """The matches do not lead to a pose; it becomes a result with this text as its reason."""


@dataclass(frozen=True, slots=True)
class Correspondences:
    """Image positions and the points they show."""

    uv: FloatArray
    """Shape (n, 2), pixels."""
    rays: FloatArray
    """The rays through ``uv``, shape (n, 2)."""
    p_trs_m: FloatArray
    """Shape (n, 3)."""
    scale: FloatArray
    """How much less certain each position is than the best, shape (n,), 1 or more."""

    def __len__(self) -> int:
        return len(self.uv)

    def take(self, chosen: NDArray[Any] | slice) -> "Correspondences":
        """Give the chosen ones, by index, by a mask or by a slice."""
        return Correspondences(
            self.uv[chosen], self.rays[chosen], self.p_trs_m[chosen], self.scale[chosen]
        )


def need(n: int, n_min: int, what: str) -> None:
    """Refuse too few of something.

    Raises:
        NoPoseError: ``n`` is less than ``n_min``.
    """
    if n < n_min:
        raise NoPoseError(f"{n} {what}, at least {n_min} needed")
