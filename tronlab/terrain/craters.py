# pyright: basic
"""Craters: how many, of which shape, stamped into a height map.

Diameters follow N(> D) = a (D / 1 m)^-b per unit area. A fresh crater is a parabolic bowl of depth
0.2 D with a raised rim and a blanket of ejecta that falls off with the cube of the distance (Pike
1977; Fassett and Thomson 2014); downslope creep then wears it down, which is a diffusion of its
profile. Profiles of several states of wear are tabulated once and scaled to each crater.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from tronlab.geometry.poses import FloatArray
from tronlab.terrain.kernels import compiled, n_cores, run_interleaved

REACH = 3.0
"""How far a crater's ejecta reach, in crater radii."""
FRESH_DEPTH = 0.2
"""Depth of a fresh crater's floor below the plain, in diameters."""
FRESH_RIM = 0.035
"""Height of a fresh crater's rim above the plain, in diameters."""

_N_STATES = 12
_N_RADII = 192
_MOST_WORN = 0.2
"""Diffusion of the most worn crater, kappa t / R^2: half of its depth is filled at 0.12."""


@dataclass(frozen=True, slots=True)
class Craters:
    """Craters on the plane, widest first; arrays of shape (n,)."""

    diameter_m: FloatArray
    x_m: FloatArray
    """Centre along X_TRS from the map's first row; may lie outside the map."""
    y_m: FloatArray
    wear: FloatArray
    """0 (fresh) to 1 (most worn)."""


def draw_craters(
    rng: np.random.Generator,
    size_m: tuple[float, float],
    *,
    exponent: float,
    density_per_m2: float,
    smallest_m: float,
    largest_m: float,
) -> Craters:
    """Draw the craters that touch a rectangle.

    Args:
        rng: Source of chance.
        size_m: Extent of the rectangle along x and y.
        exponent: b of the size-frequency law.
        density_per_m2: a of the size-frequency law.
        smallest_m: Smallest diameter.
        largest_m: Largest diameter; above it the law is cut off.
    """
    margin = REACH * largest_m / 2
    width, height = size_m[0] + 2 * margin, size_m[1] + 2 * margin
    above_smallest, above_largest = smallest_m**-exponent, largest_m**-exponent
    n = rng.poisson(density_per_m2 * (above_smallest - above_largest) * width * height)
    share = rng.random(n)
    diameter = (above_smallest - share * (above_smallest - above_largest)) ** (-1 / exponent)
    x = rng.random(n) * width - margin
    y = rng.random(n) * height - margin
    wear = rng.random(n)
    reach = REACH * diameter / 2
    touches = (np.abs(x - size_m[0] / 2) < size_m[0] / 2 + reach) & (
        np.abs(y - size_m[1] / 2) < size_m[1] / 2 + reach
    )
    order = np.flatnonzero(touches)[np.argsort(-diameter[touches], kind="stable")]
    return Craters(diameter[order], x[order], y[order], wear[order])


@cache  # thousands of steps of diffusion, for every tile of a large terrain the same
def crater_profiles() -> NDArray[np.float32]:
    """Tabulate the height over the plain in diameters, shape (states of wear, radii).

    The first column is the centre, the last ``REACH`` crater radii from it, where the height is 0.
    """
    r = np.linspace(0.0, REACH, _N_RADII)
    profile = np.where(
        r < 1.0,
        -FRESH_DEPTH + (FRESH_DEPTH + FRESH_RIM) * r**2,
        FRESH_RIM * np.maximum(r, 1.0) ** -3.0,
    )
    profile *= np.clip((REACH - r) / 1.0, 0.0, 1.0)
    step = r[1]
    n_steps = int(np.ceil(_MOST_WORN / (0.2 * step**2)))
    states = [profile]
    for i in range(1, n_steps + 1):
        profile = _diffused(profile, r, (_MOST_WORN / n_steps) / step**2)
        if i * (_N_STATES - 1) // n_steps > len(states) - 1:
            states.append(profile)
    return np.stack(states).astype(np.float32)


def _diffused(profile: FloatArray, r: FloatArray, number: float) -> FloatArray:
    """Give the radial profile after one explicit step; the edge stays at 0."""
    half = (r[1:] + r[:-1]) / 2
    flow = half * np.diff(profile)
    result = profile.copy()
    result[1:-1] += number * np.diff(flow) / r[1:-1]
    result[0] += number * 4.0 * (profile[1] - profile[0])
    return result


def stamp_craters(height_m: NDArray[np.float32], spacing_m: float, craters: Craters) -> None:
    """Add craters to a height map in place.

    Every sample adds its craters in the same order, so the sums do not depend on the threads.
    """
    run_interleaved(
        _stamp_rows,
        height_m,
        spacing_m,
        craters.diameter_m,
        craters.x_m,
        craters.y_m,
        craters.wear,
        crater_profiles(),
        n_threads=n_cores(),
    )


@compiled
def _stamp_rows(height, spacing, diameters, xs, ys, wears, profiles, part, n_parts):  # noqa: PLR0917
    """Stamp all craters into the part-th of n_parts strips of rows."""
    n_rows, n_columns = height.shape
    begin = n_rows * part // n_parts
    end = n_rows * (part + 1) // n_parts
    n_states, n_radii = profiles.shape
    for k in range(diameters.size):
        reach = 0.5 * REACH * diameters[k]
        first_row = max(begin, int(np.ceil((xs[k] - reach) / spacing)))
        last_row = min(end - 1, int(np.floor((xs[k] + reach) / spacing)))
        state = min(int(wears[k] * n_states), n_states - 1)
        samples_per_m = (n_radii - 1) / reach
        for i in range(first_row, last_row + 1):
            dx = i * spacing - xs[k]
            half_chord = np.sqrt(max(reach * reach - dx * dx, 0.0))
            first = max(0, int(np.ceil((ys[k] - half_chord) / spacing)))
            last = min(n_columns - 1, int(np.floor((ys[k] + half_chord) / spacing)))
            for j in range(first, last + 1):
                dy = j * spacing - ys[k]
                place = np.sqrt(dx * dx + dy * dy) * samples_per_m
                n = min(int(place), n_radii - 2)
                share = np.float32(place - n)
                low = profiles[state, n]
                rise = low + share * (profiles[state, n + 1] - low)
                height[i, j] += np.float32(diameters[k]) * rise
