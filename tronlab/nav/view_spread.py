"""Poses spread over a terrain model: views for a database that serves every approach."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.errors import ConfigError
from tronlab.geometry.poses import FloatArray, pose_along_boresight

_N_DIMENSIONS = 6
"""Two of the point looked at, and range, tilt, azimuth and roll."""


@dataclass(frozen=True, slots=True)
class Spread:
    """Which views are asked for."""

    n_views: int
    range_m: tuple[float, float]
    """Least and greatest distance from the camera to the point it looks at."""
    max_tilt_rad: float
    """Largest angle between the optical axis and the model's normal."""
    seed: int


def spread_poses(
    spread: Spread, *, corner_trs_m: FloatArray, size_m: tuple[float, float], clearance_m: float
) -> tuple[RigidTransform, ...]:
    """Spread poses ``trs_from_cam`` evenly over places, ranges and directions.

    The points looked at are even over the model, ranges even in their logarithm, directions even
    over the solid angle up to the tilt, and the camera is turned about its axis by any angle. A
    Halton sequence (Halton, Numerische Mathematik 2, 1960), scrambled by the seed, gives the six
    numbers of each view: any first part of it is even, too.

    Args:
        spread: Which views.
        corner_trs_m: Corner of the model with the least X and Y, at its mean height, shape (3,).
        size_m: Extent of the model along X and Y.
        clearance_m: How far above its mean height the model reaches.

    Raises:
        ConfigError: Ranges or tilt are not possible, or put the camera into the model.
    """
    from scipy.stats.qmc import Halton  # slow to import, and only a spread needs it

    _check(spread, clearance_m)
    shares = Halton(_N_DIMENSIONS, scramble=True, rng=spread.seed).random(spread.n_views)
    nearest_m, farthest_m = spread.range_m
    looked_at_m = corner_trs_m + np.column_stack([shares[:, :2] * size_m, np.zeros(len(shares))])
    range_m = nearest_m * (farthest_m / nearest_m) ** shares[:, 2]
    tilt = np.arccos(1 - shares[:, 3] * (1 - np.cos(spread.max_tilt_rad)))
    azimuth, roll = 2 * np.pi * shares[:, 4:].T
    boresight = np.column_stack(
        [np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), -np.cos(tilt)]
    )
    right = np.column_stack([np.cos(roll), np.sin(roll), np.zeros(len(roll))])
    right -= (right * boresight).sum(axis=1, keepdims=True) * boresight
    return tuple(
        pose_along_boresight(p_m, boresight=axis, right=across)
        for p_m, axis, across in zip(
            looked_at_m - range_m[:, None] * boresight, boresight, right, strict=True
        )
    )


def _check(spread: Spread, clearance_m: float) -> None:
    nearest_m, farthest_m = spread.range_m
    if not 0 < nearest_m <= farthest_m < np.inf:
        raise ConfigError(
            f"--range {nearest_m:g}:{farthest_m:g}: must be NEAREST:FARTHEST in metres, both"
            " positive, the nearest first"
        )
    if not 0 <= spread.max_tilt_rad <= np.radians(80):
        raise ConfigError(f"--tilt {np.degrees(spread.max_tilt_rad):g}: must be 0 to 80 degrees")
    lowest_m = nearest_m * np.cos(spread.max_tilt_rad)
    if lowest_m <= clearance_m:
        raise ConfigError(
            f"--range {nearest_m:g}:{farthest_m:g}: with a tilt of"
            f" {np.degrees(spread.max_tilt_rad):.0f} degrees a camera may be {lowest_m:.2f} m above"
            f" the model's mean height, which the terrain reaches, too ({clearance_m:.2f} m); take"
            " a greater nearest range"
        )
