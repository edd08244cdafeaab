"""What the paper published, to stand beside our own numbers.

Source: V. Magalhaes Oliveira, H. Krueger, S. Theil, "Feature-based Optical Navigation for Lunar
Landings" (DLR): sections 3.4 (datasets), 4.1 ("an average below 1% and a maximum error below 3%"),
Table 1 (nominal trajectory) and Table 2 (perturbed trajectories).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

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


@dataclass(frozen=True, slots=True)
class PublishedDataset:
    """One of the paper's sets of images."""

    title: str
    n_shots: int
    fov_deg: float
    """Field of view of the lens."""
    is_perturbed: bool
    figures: Mapping[str, int]
    """Detector to the number of the figure with its histograms."""


@dataclass(frozen=True, slots=True)
class PublishedErrors:
    """A cell pair of Table 1 or 2: norm of the position error, percent of the range."""

    mean_pct_los: float
    max_pct_los: float


DATASETS: Mapping[str, PublishedDataset] = MappingProxyType(
    {
        "dataset_0": PublishedDataset(
            "dataset 0, straight line", 61, 67.0, False, {"AKAZE": 8, "BRISK": 9}
        ),
        "dataset_1_nominal": PublishedDataset(
            "dataset 1, nominal", 12, 67.0, False, {"AKAZE": 10, "BRISK": 11}
        ),
        "dataset_1_perturbed": PublishedDataset(
            "dataset 1, perturbed", 239, 67.0, True, {"AKAZE": 14, "BRISK": 15}
        ),
        "dataset_2_nominal": PublishedDataset(
            "dataset 2, nominal", 11, 35.0, False, {"AKAZE": 12, "BRISK": 13}
        ),
        "dataset_2_perturbed": PublishedDataset(
            "dataset 2, perturbed", 50, 35.0, True, {"AKAZE": 16, "BRISK": 17}
        ),
    }
)
"""By the names the datasets have in a study."""

TABLE_1: Mapping[tuple[str, str], PublishedErrors] = MappingProxyType(
    {
        ("dataset_1_nominal", "AKAZE"): PublishedErrors(2.2, 6.1),
        ("dataset_2_nominal", "AKAZE"): PublishedErrors(2.4, 4.3),
        ("dataset_1_nominal", "BRISK"): PublishedErrors(3.5, 13.8),
        ("dataset_2_nominal", "BRISK"): PublishedErrors(2.1, 2.8),
    }
)
"""Nominal trajectory; by dataset and detector."""

TABLE_2: Mapping[tuple[str, str], PublishedErrors] = MappingProxyType(
    {
        ("dataset_1_perturbed", "AKAZE"): PublishedErrors(2.0, 26.2),
        ("dataset_2_perturbed", "AKAZE"): PublishedErrors(3.8, 9.2),
        ("dataset_1_perturbed", "BRISK"): PublishedErrors(2.5, 29.0),
        ("dataset_2_perturbed", "BRISK"): PublishedErrors(4.1, 16.6),
    }
)
"""Perturbed trajectories; by dataset and detector."""


def detector_of(core: str) -> str:
    """Give the paper's name of the detector that a core uses, whichever its estimator; or ''."""
    return PAPER_CORES.get(core.removesuffix("-refined"), "")


def is_refined(core: str) -> bool:
    """Tell whether a core is one of ours that refine the pose of one of the paper's detectors."""
    return core not in PAPER_CORES and bool(detector_of(core))
