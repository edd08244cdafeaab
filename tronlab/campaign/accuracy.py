"""How sure the ground truth of a dataset is, in a line for people."""

from pathlib import Path

import numpy as np

from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import Truth
from tronlab.dataset.schema import TRUTH
from tronlab.geometry.poses import FloatArray


def describe_accuracy(dataset_path: Path) -> str:
    """Give one sigma of truth at the nearest and the farthest shot."""
    with Dataset(dataset_path) as dataset:
        ranges_m = dataset.rows(f"{TRUTH}/range_los_m")
        ends = (dataset.truth(int(i)) for i in (ranges_m.argmin(), ranges_m.argmax()))
        nearest, farthest = map(_sigmas, ends)
    return f"truth, one sigma: {nearest} in the nearest shot, {farthest} in the farthest"


def sigmas_of(covariance: FloatArray) -> tuple[float, float]:
    """Give one sigma of rotation and position: the root mean square of the error's length.

    Args:
        covariance: Of (rotation vector, translation), shape (6, 6), rad and m.

    Returns:
        In radians and metres.
    """
    variances = np.diag(covariance)
    return float(np.sqrt(variances[:3].sum())), float(np.sqrt(variances[3:].sum()))


def _sigmas(truth: Truth) -> str:
    sigma_rad, sigma_m = sigmas_of(truth.covariance)
    return (
        f"{sigma_m * 1e3:.3f} mm and {np.degrees(sigma_rad):.4f} deg at {truth.range_los_m:.2f} m"
    )
