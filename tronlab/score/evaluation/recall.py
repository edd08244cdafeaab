"""Recall: the share of shots that a core solves within a position and a rotation threshold."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tronlab.errors import ScoreError
from tronlab.score.evaluation.resampling import CONFIDENCE, Interval


@dataclass(frozen=True, slots=True)
class Threshold:
    """What counts as solved: both errors at most this."""

    position_pct_los: float
    rotation_deg: float

    @property
    def text(self) -> str:
        """Get it as people read it."""
        return f"{self.position_pct_los:g} % LOS, {self.rotation_deg:g} deg"


THRESHOLDS = tuple(Threshold(t, t) for t in (0.1, 0.3, 1.0, 3.0))


@dataclass(frozen=True, slots=True)
class Share:
    """A share of shots, and where that of all possible shots lies."""

    n_hits: int
    n: int
    """Answers that were looked at."""
    interval: Interval

    @property
    def value(self) -> float:
        """Get the share, 0 to 1; NaN of none."""
        return self.n_hits / self.n if self.n else float("nan")


def parse_threshold(text: str) -> Threshold:
    """Read ``0.1,0.05``: percent of the line of sight, degrees.

    Raises:
        ScoreError: It is something else.
    """
    try:
        position, rotation = (float(part) for part in text.split(","))
    except ValueError:
        position = rotation = np.nan
    if not (position > 0.0 and rotation > 0.0 and np.isfinite([position, rotation]).all()):
        raise ScoreError(
            f"recall threshold '{text}': must be two numbers above 0 with a comma between: position"
            " in percent of the line of sight and rotation in degrees, as 0.1,0.05"
        )
    return Threshold(position, rotation)


def recall(rows: pd.DataFrame, thresholds: Sequence[Threshold] = THRESHOLDS) -> list[Share]:
    """Give the share of all answers of one core within each threshold.

    An answer without a pose is within none.
    """
    is_solved = (rows["status"] == "ok").to_numpy(dtype=np.bool_)
    position = rows["position_error_pct_los"].to_numpy(dtype=np.float64)
    rotation = rows["rotation_error_deg"].to_numpy(dtype=np.float64)
    n_shots = int(rows["shot_id"].nunique())
    return [
        share_of(
            is_solved & (position <= t.position_pct_los) & (rotation <= t.rotation_deg), n_shots
        )
        for t in thresholds
    ]


def share_of(is_hit: NDArray[np.bool_], n_shots: int) -> Share:
    """Give the share of hits among answers of some shots.

    Repeats of a shot are taken as if they told nothing new: the interval is as wide as the shots
    alone would make it.

    Args:
        is_hit: Shape (n_answers,).
        n_shots: How many different shots the answers are of.
    """
    share = float(is_hit.mean()) if is_hit.size else 0.0
    return Share(int(is_hit.sum()), int(is_hit.size), wilson_interval(share, n_shots))


def wilson_interval(share: float, n: int) -> Interval:
    """Give the score interval of a probability.

    E. B. Wilson, Probable inference, JASA 22 (1927) 209. It holds also for shares of 0 and 1, and
    on average, which the exact one of Clopper and Pearson, always too wide, does not.

    Args:
        share: Of hits, 0 to 1.
        n: Number of trials; without any, the interval is from 0 to 1.
    """
    from scipy.special import ndtri

    if not n:
        return Interval(0.0, 1.0)
    z = float(ndtri((1.0 + CONFIDENCE) / 2.0))
    centre = (share + z**2 / (2 * n)) / (1.0 + z**2 / n)
    half = z / (1.0 + z**2 / n) * np.sqrt(share * (1.0 - share) / n + z**2 / (4 * n**2))
    # Rounding must not leave a share of 0 or 1 outside its interval.
    low, high = min(share, centre - half), max(share, centre + half)
    return Interval(max(0.0, float(low)), min(1.0, float(high)))
