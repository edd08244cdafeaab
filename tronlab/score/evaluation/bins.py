"""Statistics of a core in parts of the range, the light, or what is seen of the terrain."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from types import MappingProxyType

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tronlab.errors import ScoreError
from tronlab.geometry.poses import FloatArray
from tronlab.score.evaluation.statistics import Estimates, estimates, solved_sample

BINNED_BY = MappingProxyType(
    {
        "range_los_m": "range [m]",
        "phase_deg": "phase angle [deg]",
        "usable_fraction": "usable fraction",
    }
)
"""Columns that shots are parted by, and what people call them."""
N_BINS = 4
"""Without given edges: as many parts, each of as many shots."""
_ALIKE = 0.01
"""Values within this part of the largest are not parted."""


@dataclass(frozen=True, slots=True)
class Bin:
    """A part of the shots: those from ``low`` to below ``high``."""

    low: float
    """NaN: the shots whose value is not known; likewise ``high``."""
    high: float
    has_high: bool = False
    """Whether ``high`` itself belongs to it."""

    @property
    def text(self) -> str:
        """Get it as people read it."""
        if np.isnan(self.low):
            return "not known"
        if np.isinf(self.low):
            return f"below {self.high:.3g}"
        if np.isinf(self.high):
            return f"{self.low:.3g} and more"
        if f"{self.low:.3g}" == f"{self.high:.3g}":
            return f"{self.low:.3g}"
        return f"{self.low:.3g} to {self.high:.3g}"

    def holds(self, values: FloatArray) -> NDArray[np.bool_]:
        """Tell which of some values belong to it, shape (n,)."""
        if np.isnan(self.low):
            return ~np.isfinite(values)
        return (values >= self.low) & (
            (values < self.high) | (self.has_high & (values == self.high))
        )


@dataclass(frozen=True, slots=True)
class BinScore:
    """What a core made of the shots of one bin."""

    bin: Bin
    n_shots: int
    n_answers: int
    n_ok: int
    estimates: Estimates


def parse_edges(text: str) -> tuple[str, tuple[float, ...]]:
    """Read ``range_los_m=1,2,4``.

    Returns:
        The column, and the edges between its bins.

    Raises:
        ScoreError: An unknown column, or no numbers that rise.
    """
    column, equals, numbers = text.partition("=")
    if not equals or column not in BINNED_BY:
        raise ScoreError(
            f"bins '{text}': must be COLUMN=EDGE,EDGE,..., as range_los_m=1,2,4; columns:"
            f" {', '.join(BINNED_BY)}"
        )
    try:
        edges = tuple(float(number) for number in numbers.split(","))
    except ValueError:
        edges = ()
    if not edges or not np.isfinite(edges).all() or not (np.diff(edges) > 0.0).all():
        raise ScoreError(f"bins '{text}': the edges must be numbers that rise, as {column}=1,2,4")
    return column, edges


def make_bins(
    scores: pd.DataFrame, column: str, edges: Sequence[float] | None = None
) -> tuple[Bin, ...]:
    """Part the shots of a table; all cores share the bins.

    Args:
        scores: Rows of ``scores.csv``.
        column: One of ``BINNED_BY``.
        edges: Between the bins, ascending; shots beyond the outer ones get bins of their own. By
            default quantiles of the shots, so that each bin holds about as many; fewer bins than
            ``N_BINS`` if many shots share a value, one if all are much alike.

    Returns:
        The bins that hold a shot, in order, with that of shots whose value is not known last.
    """
    of_shots = scores.drop_duplicates("shot_id")[column].to_numpy(np.float64)
    known = of_shots[np.isfinite(of_shots)]
    bins = _quantile_bins(known) if edges is None else _bins([-np.inf, *edges, np.inf])
    return tuple(bin_ for bin_ in (*bins, Bin(np.nan, np.nan)) if bin_.holds(of_shots).any())


def score_bins(rows: pd.DataFrame, column: str, bins: Sequence[Bin], metric: str) -> list[BinScore]:
    """Give the statistics of one core's rows in each bin; shots without a pose are counted."""
    values = rows[column].to_numpy(np.float64)
    found: list[BinScore] = []
    for bin_ in bins:
        held = rows[bin_.holds(values)]
        found.append(
            BinScore(
                bin=bin_,
                n_shots=int(held["shot_id"].nunique()),
                n_answers=len(held),
                n_ok=int((held["status"] == "ok").sum()),
                estimates=estimates(solved_sample(held, metric)),
            )
        )
    return found


def _quantile_bins(known: FloatArray) -> list[Bin]:
    if not known.size:
        return []
    low, high = float(known.min()), float(known.max())
    if high - low <= _ALIKE * abs(high):
        return [Bin(low, high, has_high=True)]
    limits = np.unique(np.quantile(known, np.linspace(0.0, 1.0, N_BINS + 1))).tolist()
    bins = _bins(limits)
    return [*bins[:-1], replace(bins[-1], has_high=True)]


def _bins(limits: Sequence[float]) -> list[Bin]:
    return [Bin(low, high) for low, high in pairwise(limits)]
