"""What a laser scanner would make of a terrain model: the height map that the database knows.

The surface is blurred by the scanner's spot, moved by the error of its registration in the
laboratory's frame, sampled, and given noise; what the scanner does not see is filled from its rim.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.poses import FloatArray
from tronlab.terrain.config import MAX_SAMPLES_IN_MEMORY, ScanConfig
from tronlab.terrain.heightmap import HeightMap, TerrainError
from tronlab.terrain.holes import fill_holes
from tronlab.terrain.kernels import compiled, n_cores, run_interleaved
from tronlab.terrain.registration import draw_registration_error

SCAN_VERSION = 1
"""Another number, other heights from the same settings."""

_N_STEPS = 6
_ABOVE_SURFACE_M = 1e-5


@dataclass(frozen=True, slots=True)
class Scan:
    """A measured terrain model, and what only the simulator knows of it."""

    heightmap: HeightMap
    scan_from_true: RigidTransform
    """Registration error: takes a point of the true surface to where the scan has it, in F_TRS."""
    n_holes_filled: int
    """Samples that the scanner saw from nowhere."""
    n_outside: int
    """Samples where, for its registration error, the scan knows no surface: they repeat the
    nearest height of the model's border."""


def scan(heightmap: HeightMap, config: ScanConfig) -> Scan:
    """Measure a terrain model.

    Args:
        heightmap: The true terrain.
        config: How well it is measured.

    Raises:
        TerrainError: The terrain is too large for memory, the scan too coarse, or a hole too wide.
    """
    _check_size(heightmap, config)
    motion_rng, white_rng, shared_rng = np.random.default_rng(config.seed).spawn(3)
    scan_from_true = draw_registration_error(motion_rng, heightmap, config.registration)
    spacing_m = config.spacing_m or heightmap.spacing_m
    blurred = _blurred(heightmap, config.spot_diameter_m)
    height_m, rows, columns = _moved(blurred, scan_from_true, spacing_m)
    n_outside = int(np.count_nonzero(_is_outside(rows, columns, heightmap.height_m.shape)))
    height_m += _white_noise(white_rng, height_m.shape, config)
    height_m += _shared_noise(shared_rng, height_m.shape, spacing_m, config)
    is_hidden = _is_hidden(heightmap, config, rows, columns)
    _check_seen(is_hidden, heightmap, config)
    n_holes = int(np.count_nonzero(is_hidden))
    if n_holes:
        height_m[is_hidden] = np.nan
        height_m, _ = fill_holes(height_m, widest_px=round(config.widest_hole_m / spacing_m))
    scanned = HeightMap(height_m.astype(np.float32), spacing_m, heightmap.origin_trs_m)
    return Scan(scanned, scan_from_true, n_holes, n_outside)


def _check_size(heightmap: HeightMap, config: ScanConfig) -> None:
    rows, columns = heightmap.height_m.shape
    if rows * columns > MAX_SAMPLES_IN_MEMORY:
        raise TerrainError(
            f"scan: the terrain has {rows} x {columns} samples (at most {MAX_SAMPLES_IN_MEMORY});"
            " scan a part of it"
        )
    shape = _scan_shape(heightmap, config.spacing_m or heightmap.spacing_m)
    if min(shape) < 8 or shape[0] * shape[1] > MAX_SAMPLES_IN_MEMORY:
        raise TerrainError(
            f"scan: spacing_m {config.spacing_m} gives {shape[0]} x {shape[1]} samples, must give"
            f" 8 x 8 to {MAX_SAMPLES_IN_MEMORY}"
        )


def _scan_shape(heightmap: HeightMap, spacing_m: float) -> tuple[int, int]:
    rows, columns = (int(length / spacing_m + 1e-6) + 1 for length in heightmap.size_m)
    return rows, columns


def _blurred(heightmap: HeightMap, spot_diameter_m: float) -> HeightMap:
    """Give the mean height under the spot, a Gauss curve of four standard deviations' width."""
    if spot_diameter_m == 0.0:
        return heightmap
    from scipy.ndimage import gaussian_filter

    sigma_px = spot_diameter_m / 4 / heightmap.spacing_m
    height_m: Any = gaussian_filter(heightmap.height_m, sigma_px, mode="nearest")
    return HeightMap(height_m, heightmap.spacing_m, heightmap.origin_trs_m)


def _moved(
    heightmap: HeightMap, scan_from_true: RigidTransform, spacing_m: float
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Sample the moved surface on the grid of the scan.

    For each sample the point of the true surface is sought that was moved to it. Each of the steps
    brings it nearer by the turn's angle times the surface's slope, so that at 1 degree and slope 1
    the six leave less than 1e-9 of the motion.

    Returns:
        Heights over the origin, and row and column of the true points; each shape of the scan.
    """
    shape = _scan_shape(heightmap, spacing_m)
    height_m, rows, columns = (np.empty(shape, np.float32) for _ in range(3))
    origin = np.asarray(heightmap.origin_trs_m, np.float64)
    rotation = scan_from_true.rotation.as_matrix()
    # In the model's own frame, whose origin is that of the height map.
    shift_m = scan_from_true.apply(origin) - origin
    run_interleaved(
        _sample_moved,
        heightmap.height_m,
        heightmap.spacing_m,
        rotation,
        shift_m,
        spacing_m,
        (height_m, rows, columns),
        n_threads=n_cores(),
    )
    return height_m, rows, columns


def _is_outside(
    rows: NDArray[np.float32], columns: NDArray[np.float32], shape: tuple[int, ...]
) -> NDArray[np.bool_]:
    slack = 1e-3  # of a cell: rounding at the border is no motion
    return (
        (rows < -slack)
        | (columns < -slack)
        | (rows > shape[0] - 1 + slack)
        | (columns > shape[1] - 1 + slack)
    )


def _white_noise(
    rng: np.random.Generator, shape: tuple[int, ...], config: ScanConfig
) -> NDArray[np.float32]:
    return rng.standard_normal(shape, dtype=np.float32) * np.float32(config.noise_sigma_m)


def _shared_noise(
    rng: np.random.Generator, shape: tuple[int, ...], spacing_m: float, config: ScanConfig
) -> NDArray[np.float32] | np.float32:
    """Make noise of covariance sigma^2 exp(-(d / L)^2), shape ``shape``.

    White noise convolved with a Gauss curve of standard deviation s has a covariance like that of
    sqrt(2) s, so s = L / 2; the sum of the curve's squares is 1 / (4 pi s^2).
    """
    if config.correlated_sigma_m == 0.0:
        return np.float32(0.0)
    sigma_px = config.correlation_length_m / spacing_m / 2
    margin = int(np.ceil(6 * sigma_px))
    padded = [int(fft.next_fast_len(n + margin, real=True)) for n in shape]  # pyright: ignore
    spectrum: Any = fft.rfft2(rng.standard_normal(padded, dtype=np.float32), workers=n_cores())
    for k, axis in ((fft.fftfreq(padded[0])[:, None], 0), (fft.rfftfreq(padded[1]), 1)):
        curve = np.exp(-2 * (np.pi * sigma_px * k) ** 2)
        # As a sum over the samples, not an integral: right for a length of few samples too.
        whole = np.exp(-2 * (np.pi * sigma_px * fft.fftfreq(padded[axis])) ** 2)
        spectrum *= (curve / np.sqrt(np.mean(whole**2))).astype(np.float32)
    noise: Any = fft.irfft2(spectrum, s=padded, workers=n_cores(), overwrite_x=True)
    return noise[: shape[0], : shape[1]] * np.float32(config.correlated_sigma_m)


def _is_hidden(
    heightmap: HeightMap,
    config: ScanConfig,
    rows: NDArray[np.float32],
    columns: NDArray[np.float32],
) -> NDArray[np.bool_]:
    """Mark the samples whose true point no scanner sees."""
    if not config.scanners_trs_m:
        return np.zeros(rows.shape, np.bool_)
    is_hidden = np.ones(rows.shape, np.bool_)
    for p_trs_m in config.scanners_trs_m:
        scanner_m: FloatArray = np.array(p_trs_m) - heightmap.origin_trs_m
        run_interleaved(
            _mark_seen,
            heightmap.height_m,
            heightmap.spacing_m,
            heightmap.statistics.highest_m,
            scanner_m,
            (rows, columns),
            is_hidden,
            n_threads=n_cores(),
        )
    return is_hidden


def _check_seen(is_hidden: NDArray[np.bool_], heightmap: HeightMap, config: ScanConfig) -> None:
    if is_hidden.all():
        places = ", ".join(map(str, config.scanners_trs_m))
        top_m = heightmap.origin_trs_m[2] + heightmap.statistics.highest_m
        raise TerrainError(
            f"scan: nothing of the terrain is seen from {places} (metres in trs); a scanner stands"
            f" above it, the highest point lies at Z = {top_m:.4g} m"
        )


@compiled
def _height_at(height, r, c):
    """Give the height at (row, column), clamped to the map: on the triangles of the renderer.

    A cell's diagonal runs from node (i, j) to node (i + 1, j + 1).
    """
    r = min(max(r, 0.0), height.shape[0] - 1.0)
    c = min(max(c, 0.0), height.shape[1] - 1.0)
    i, j = min(int(r), height.shape[0] - 2), min(int(c), height.shape[1] - 2)
    x, y = r - i, c - j
    low, high = float(height[i, j]), float(height[i + 1, j + 1])
    if y >= x:
        side = float(height[i, j + 1])
        return low + y * (side - low) + x * (high - side)
    side = float(height[i + 1, j])
    return low + x * (side - low) + y * (high - side)


@compiled
def _sample_moved(height, true_spacing, rotation, shift, spacing, out, part, n_parts):  # noqa: PLR0917
    """Fill every n_parts-th row of the scan; see ``_moved``."""
    heights, rows, columns = out
    for i in range(part, heights.shape[0], n_parts):
        for j in range(heights.shape[1]):
            x, y = i * spacing, j * spacing
            true_x, true_y = x - shift[0], y - shift[1]
            z = 0.0
            for _ in range(_N_STEPS):
                true_z = _height_at(height, true_x / true_spacing, true_y / true_spacing)
                new_x = rotation[0, 0] * true_x + rotation[0, 1] * true_y + rotation[0, 2] * true_z
                new_y = rotation[1, 0] * true_x + rotation[1, 1] * true_y + rotation[1, 2] * true_z
                z = rotation[2, 0] * true_x + rotation[2, 1] * true_y + rotation[2, 2] * true_z
                off_x, off_y = new_x + shift[0] - x, new_y + shift[1] - y
                if off_x == 0.0 and off_y == 0.0:
                    break
                true_x -= off_x
                true_y -= off_y
            heights[i, j] = z + shift[2]
            rows[i, j] = true_x / true_spacing
            columns[i, j] = true_y / true_spacing


@compiled
def _mark_seen(height, spacing, highest, scanner, place, is_hidden, part, n_parts):  # noqa: PLR0917
    """Clear the mark of what a scanner sees, in every n_parts-th row: one look a cell crossed."""
    rows, columns = place
    for i in range(part, rows.shape[0], n_parts):
        for j in range(rows.shape[1]):
            r = min(max(float(rows[i, j]), 0.0), height.shape[0] - 1.0)
            c = min(max(float(columns[i, j]), 0.0), height.shape[1] - 1.0)
            z = _height_at(height, r, c) + _ABOVE_SURFACE_M
            dr, dc, dz = scanner[0] / spacing - r, scanner[1] / spacing - c, scanner[2] - z
            if not is_hidden[i, j] or dz <= 0.0:
                continue
            n_cells = max(abs(dr), abs(dc))
            is_free = True
            n = 1.0
            while is_free and n < n_cells:
                share = n / n_cells
                above = z + share * dz
                at_r, at_c = r + share * dr, c + share * dc
                is_over_model = (
                    0.0 <= at_r <= height.shape[0] - 1 and 0.0 <= at_c <= height.shape[1] - 1
                )
                if above > highest or not is_over_model:
                    break
                is_free = above >= _height_at(height, at_r, at_c)
                n += 1.0
            is_hidden[i, j] = not is_free
