"""A terrain model from a file: read, fill, cut, resample, scale to a relief."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tronlab.terrain.config import FileTerrain
from tronlab.terrain.formats.model import Announce, Heights, Raster
from tronlab.terrain.heightmap import TerrainError
from tronlab.terrain.holes import fill_holes
from tronlab.terrain.procedural import rough_surface, scaled_to_relief
from tronlab.terrain.raster import read_raster
from tronlab.terrain.resampling import cut_to_shape, resample

READER_VERSION = 3
"""To be raised with every change of the heights made from the same file and settings."""

_FAR_IN_RELIEFS = 1000.0
"""Heights this far from zero would lose digits as float32: radii of a planet."""


def read_terrain(config: FileTerrain, path: Path, *, announce: Announce) -> NDArray[np.float32]:
    """Read the file and make the heights, shape ``config.shape``, from 0 to ``relief_m``.

    Raises:
        TerrainError: The file cannot be read, has the wrong form or depth, has holes wider than
            ``holes_px``, heights that are all equal, or the crop lies outside.
    """
    raster = read_raster(path, window=config.crop_px, announce=announce)
    samples = _without_holes(raster, config, path, announce)
    along_rows_m, along_columns_m = raster.spacing_m or (1.0, 1.0)
    aspect = along_rows_m / along_columns_m
    try:
        samples = cut_to_shape(
            samples, config.size_m, aspect=aspect, name=f"{path.name}: ", announce=announce
        )
    except TerrainError as error:
        raise TerrainError(f"{path}: {error}") from error
    if samples.max() == samples.min():
        raise TerrainError(f"{path}: all heights are {samples.max()}: there is no relief to scale")
    height_m = scaled_to_relief(_on_grid(samples, config, path, announce), config.relief_m)
    if config.roughness_slope > 0.0:
        height_m += _fine_roughness(config, samples.shape[1])
        scaled_to_relief(height_m, config.relief_m)
    return height_m


def _without_holes(raster: Raster, config: FileTerrain, path: Path, announce: Announce) -> Heights:
    samples, n_holes = raster.height_m, raster.n_holes
    if n_holes == 0:
        return samples
    if config.holes_px == 0:
        row, column = np.argwhere(~np.isfinite(samples))[0]
        raise TerrainError(
            f"{path}: {n_holes} of {samples.size} samples are not finite, the first one at"
            f" row {row}, column {column}; fill the holes (holes_px), or set crop_px to a part"
            " without any"
        )
    try:
        filled, n_filled = fill_holes(samples, widest_px=config.holes_px)
    except TerrainError as error:
        raise TerrainError(f"{path}: {error}") from error
    announce(f"{path.name}: {n_filled} samples without a height filled from their surroundings")
    return filled


def _on_grid(
    samples: Heights, config: FileTerrain, path: Path, announce: Announce
) -> NDArray[np.float32]:
    """Resample to the model's grid and say what that lost, in metres of the model."""
    rows, columns = samples.shape
    spacing_m = (config.size_m[0] / (rows - 1), config.size_m[1] / (columns - 1))
    height, loss = resample(samples, spacing_m, config.shape)
    relief = float(samples.max()) - float(samples.min())
    if samples.shape != config.shape:
        announce(f"{path.name}: {loss.scaled(config.relief_m / relief)}")
    if abs(float(height.mean(dtype=np.float64))) > _FAR_IN_RELIEFS * relief:
        height = height - height.min()
    return height.astype(np.float32, copy=False)


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
