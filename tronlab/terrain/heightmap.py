"""The height map of a terrain model, placed in F_TRS."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tronlab.errors import TronlabError
from tronlab.geometry.poses import FloatArray


class TerrainError(TronlabError):
    """A height map cannot be read or makes no sense."""


@dataclass(frozen=True, slots=True)
class HeightMap:
    """Heights on a regular grid whose axes are those of F_TRS.

    Sample (i, j) is the node at ``origin_trs_m + (i * spacing_m, j * spacing_m, height_m[i, j])``:
    rows run down the model (+X_TRS), columns to the right (+Y_TRS), heights towards the camera
    (+Z_TRS). Between nodes the surface is defined by the renderer.
    """

    height_m: NDArray[np.float32]
    """Shape (rows, columns), C-contiguous, finite."""
    spacing_m: float
    origin_trs_m: FloatArray
    """Where node (0, 0) would lie at height 0, shape (3,)."""
    mean_height_trs_m: float = field(init=False, repr=False, compare=False)
    """Z_TRS of the mean height: where the flat outline of the model is taken to lie."""

    def __post_init__(self) -> None:
        if self.height_m.ndim != 2 or min(self.height_m.shape) < 2:
            raise TerrainError(f"height map: shape is {self.height_m.shape}, expected (>= 2, >= 2)")
        n_bad = int(np.count_nonzero(~np.isfinite(self.height_m)))
        if n_bad:
            raise TerrainError(f"height map: {n_bad} samples are not finite; fill the holes first")
        if not self.spacing_m > 0:
            raise TerrainError(f"height map: spacing is {self.spacing_m} m, must be positive")
        mean_m = self.height_m.mean(dtype=np.float64)  # once: every mask of a run needs it
        object.__setattr__(self, "mean_height_trs_m", float(self.origin_trs_m[2] + mean_m))

    @property
    def size_m(self) -> tuple[float, float]:
        """Get the extent along X_TRS and Y_TRS."""
        rows, columns = self.height_m.shape
        return (rows - 1) * self.spacing_m, (columns - 1) * self.spacing_m

    @property
    def relief_m(self) -> float:
        """Get the difference between the highest and the lowest sample."""
        return float(self.height_m.max() - self.height_m.min())
