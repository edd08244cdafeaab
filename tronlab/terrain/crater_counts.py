"""How many craters of which size: counts and the law, as crater counting presents them.

Crater Analysis Techniques Working Group, Standard techniques for presentation and analysis of
crater size-frequency data (Icarus 37, 1979): cumulative densities at diameters that grow by the
square root of 2, each with the standard error of a Poisson count.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tronlab.geometry.poses import FloatArray
from tronlab.terrain.config import ProceduralTerrain
from tronlab.terrain.craters import Craters
from tronlab.terrain.procedural import config_craters

_BINS_PER_DOUBLING = 2


@dataclass(frozen=True, slots=True)
class CraterCounts:
    """Craters at least so wide on an area; arrays of shape (n,), smallest diameter first."""

    diameter_m: FloatArray
    n_craters: NDArray[np.int64]
    area_m2: float

    @property
    def density_per_m2(self) -> FloatArray:
        """Get the cumulative density N(>= D) per square metre, shape (n,)."""
        return self.n_craters / self.area_m2

    @property
    def standard_error_per_m2(self) -> FloatArray:
        """Get the standard error of the density, sqrt(N) over the area, shape (n,)."""
        return np.sqrt(self.n_craters) / self.area_m2


def craters_of(config: ProceduralTerrain) -> Craters:
    """Draw the craters of a terrain once more: those that its heights are made with."""
    _, crater_rng, _ = np.random.default_rng(config.seed).spawn(3)
    return config_craters(crater_rng, config)


def count_craters(craters: Craters, size_m: tuple[float, float], smallest_m: float) -> CraterCounts:
    """Count the craters whose centre lies on a model.

    Args:
        craters: Those drawn, also beyond the borders.
        size_m: Extent of the model along X and Y.
        smallest_m: First diameter; the others follow by the square root of 2 up to the widest
            crater.
    """
    x_m, y_m = craters.x_m, craters.y_m
    is_inside = (x_m >= 0) & (x_m <= size_m[0]) & (y_m >= 0) & (y_m <= size_m[1])
    diameters = np.sort(craters.diameter_m[is_inside])
    widest_m = float(diameters[-1]) if diameters.size else smallest_m
    n_bins = 1 + int(_BINS_PER_DOUBLING * np.log2(max(widest_m / smallest_m, 1.0)) + 1e-9)
    edges = smallest_m * 2.0 ** (np.arange(n_bins) / _BINS_PER_DOUBLING)
    n_craters = diameters.size - np.searchsorted(diameters, edges, side="left")
    return CraterCounts(edges, n_craters.astype(np.int64), size_m[0] * size_m[1])


def law_per_m2(config: ProceduralTerrain, diameter_m: FloatArray) -> FloatArray:
    """Give the density N(>= D) per square metre that a terrain asks for, shape as ``diameter_m``.

    The law is cut off at its largest diameter: wider craters are missing at all diameters.
    """
    within = np.clip(diameter_m, config.crater_smallest_m, config.crater_largest_m)
    b = config.crater_exponent
    return config.crater_density_per_m2 * (within**-b - config.crater_largest_m**-b)


def n_expected(config: ProceduralTerrain, counts: CraterCounts) -> float:
    """Give how many craters of all diameters are to be expected on the area of the counts."""
    return float(law_per_m2(config, counts.diameter_m[:1])[0]) * counts.area_m2
