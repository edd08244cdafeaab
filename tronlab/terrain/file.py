"""A terrain model from a file: read, cut, resample."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.ndimage import gaussian_filter

from tronlab.terrain.config import FileTerrain
from tronlab.terrain.heightmap import TerrainError
from tronlab.terrain.procedural import rough_surface, scaled_to_relief

READER_VERSION = 3
"""To be raised with every change of the heights made from the same file and settings."""

_ROWS_AT_ONCE = 256
_NPY_TYPES = ("float32", "float64", "int16", "uint16")


def read_terrain(
    config: FileTerrain, path: Path, *, announce: Callable[[str], None]
) -> NDArray[np.float32]:
    """Read the file and make the heights, shape ``config.shape``, from 0 to ``relief_m``.

    Raises:
        TerrainError: The file cannot be read, has the wrong form or depth, holds values that are
            not finite or all equal, or the crop lies outside.
    """
    samples = _read_samples(path)
    if config.crop_px is not None:
        samples = _cropped(samples, config.crop_px, path)
    samples = _cut_to_shape(samples, config.size_m, path, announce)
    if samples.max() == samples.min():
        raise TerrainError(f"{path}: all heights are {samples.max()}: there is no relief to scale")
    height_m = scaled_to_relief(_resampled(samples, config.shape), config.relief_m)
    if config.roughness_slope > 0.0:
        height_m += _fine_roughness(config, samples.shape[1])
        scaled_to_relief(height_m, config.relief_m)
    return height_m


def _read_samples(path: Path) -> NDArray[np.float64]:
    if path.suffix.lower() == ".npy":
        samples = _read_npy(path)
    elif path.suffix.lower() == ".png":
        samples = _read_png(path)
    else:
        raise TerrainError(f"{path}: is not a height map (allowed: .png of 16 bit, .npy)")
    bad = np.argwhere(~np.isfinite(samples))
    if len(bad):
        row, column = bad[0]
        raise TerrainError(
            f"{path}: {len(bad)} of {samples.size} samples are not finite, the first one at"
            f" row {row}, column {column}; fill the holes, or set crop_px to a part without any"
        )
    return samples


def _read_npy(path: Path) -> NDArray[np.float64]:
    try:
        samples = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise TerrainError(f"{path}: cannot be read as a NumPy array: {error}") from error
    if samples.dtype.name not in _NPY_TYPES:
        allowed = ", ".join(_NPY_TYPES)
        raise TerrainError(f"{path}: samples are {samples.dtype.name} (allowed: {allowed})")
    if samples.ndim != 2 or min(samples.shape) < 8:
        raise TerrainError(f"{path}: shape is {samples.shape}, expected at least (8, 8)")
    return samples.astype(np.float64)


def _read_png(path: Path) -> NDArray[np.float64]:
    import cv2

    image: Any = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise TerrainError(f"{path}: cannot be read as a PNG image; the file may be damaged")
    if image.ndim != 2:
        raise TerrainError(
            f"{path}: has {image.shape[2]} colour channels, a height map has one;"
            " save it as 16-bit grey"
        )
    if image.dtype != np.uint16:
        raise TerrainError(
            f"{path}: has {8 * image.dtype.itemsize} bit a sample, a height map needs 16:"
            " 256 levels would make terraces; export it as 16-bit grey"
        )
    if min(image.shape) < 8:
        raise TerrainError(f"{path}: shape is {image.shape}, expected at least (8, 8)")
    return image.astype(np.float64)


def _cropped(
    samples: NDArray[np.float64], crop_px: tuple[int, int, int, int], path: Path
) -> NDArray[np.float64]:
    row, column, rows, columns = crop_px
    if row + rows > samples.shape[0] or column + columns > samples.shape[1]:
        raise TerrainError(
            f"{path}: crop_px {list(crop_px)} (row, column, rows, columns) reaches to row"
            f" {row + rows} and column {column + columns}, the file has {samples.shape[0]} x"
            f" {samples.shape[1]}"
        )
    return samples[row : row + rows, column : column + columns]


def _cut_to_shape(
    samples: NDArray[np.float64],
    size_m: tuple[float, float],
    path: Path,
    announce: Callable[[str], None],
) -> NDArray[np.float64]:
    """Cut the middle out so that samples are as far apart along rows as along columns."""
    rows, columns = samples.shape
    sample_m = max(size_m[0] / (rows - 1), size_m[1] / (columns - 1))
    kept_rows = min(rows, round(size_m[0] / sample_m) + 1)
    kept_columns = min(columns, round(size_m[1] / sample_m) + 1)
    if (kept_rows, kept_columns) == (rows, columns):
        return samples
    if min(kept_rows, kept_columns) < 8:
        raise TerrainError(
            f"{path}: {rows} x {columns} samples cut to the shape of size_m {list(size_m)} leave"
            f" {kept_rows} x {kept_columns}, needed are at least 8 x 8"
        )
    top, left = (rows - kept_rows) // 2, (columns - kept_columns) // 2
    announce(
        f"{path.name}: {rows} x {columns} samples do not have the shape of"
        f" {size_m[0]} x {size_m[1]} m: using the middle, {kept_rows} x {kept_columns}"
        f" from row {top}, column {left}"
    )
    return samples[top : top + kept_rows, left : left + kept_columns]


def _resampled(samples: NDArray[np.float64], shape: tuple[int, int]) -> NDArray[np.float32]:
    """Evaluate the bicubic spline through the samples on a grid with the same four corners."""
    samples = _smoothed_for(samples, shape)
    rows, columns = samples.shape
    tall = make_interp_spline(np.arange(rows), samples, k=3, axis=0)
    result = np.empty(shape, dtype=np.float32)
    x = np.linspace(0, rows - 1, shape[0])
    y = np.linspace(0, columns - 1, shape[1])
    for first in range(0, shape[0], _ROWS_AT_ONCE):
        block = slice(first, first + _ROWS_AT_ONCE)
        wide = make_interp_spline(np.arange(columns), tall(x[block]), k=3, axis=1)
        result[block] = wide(y)
    return result


def _smoothed_for(samples: NDArray[np.float64], shape: tuple[int, int]) -> NDArray[np.float64]:
    """Take away waves that the new grid is too coarse for."""
    steps = [(old - 1) / (new - 1) for old, new in zip(samples.shape, shape, strict=True)]
    if max(steps) <= 1.0:
        return samples
    return gaussian_filter(samples, [0.5 * step if step > 1.0 else 0.0 for step in steps])


def _fine_roughness(config: FileTerrain, n_file_columns: int) -> NDArray[np.float32]:
    """Make the roughness that the file is too coarse to hold: waves up to 4 of its samples."""
    return rough_surface(
        np.random.default_rng(config.seed),
        config.shape,
        spacing_m=config.spacing_m,
        hurst_exponent=config.hurst_exponent,
        slope=config.roughness_slope,
        longest_wave_m=4 * config.size_m[1] / (n_file_columns - 1),
    )
