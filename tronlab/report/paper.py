"""What the paper published, to stand beside our own numbers.

Source: V. Magalhaes Oliveira, H. Krueger, S. Theil, "Feature-based Optical Navigation for Lunar
Landings" (DLR), section 4.1: "The navigation error for both AKAZE and BRISK had an average below 1%
and a maximum error below 3%."
"""

from dataclasses import dataclass

SOURCE = "Magalhães Oliveira, Krüger, Theil: Feature-based Optical Navigation for Lunar Landings"


@dataclass(frozen=True, slots=True)
class PublishedBounds:
    """Bounds of the norm of the position error, percent of the line-of-sight range."""

    dataset: str
    n_shots: int
    mean_below_pct_los: float
    max_below_pct_los: float


DATASET_0 = PublishedBounds(
    dataset="dataset 0, straight line", n_shots=61, mean_below_pct_los=1.0, max_below_pct_los=3.0
)
"""The same bounds hold for both detectors of the paper."""

PAPER_CORES = {"akaze": "AKAZE", "brisk": "BRISK"}
"""Our cores that follow the paper's estimator, and its name for each."""
