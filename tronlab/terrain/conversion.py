"""A height map from a file made fit for another file: holes, size, relief and spacing."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tronlab.geometry.poses import FloatArray
from tronlab.terrain.formats.model import Announce, Raster
from tronlab.terrain.heightmap import HeightMap, HeightStatistics, TerrainError
from tronlab.terrain.holes import fill_holes
from tronlab.terrain.resampling import cut_to_shape, resample, resample_to_spacing
from tronlab.terrain.statistics import known_heights

_SAME_SPACING = 1e-6
"""Spacings along X and Y that differ by less than this share are taken for one."""


@dataclass(frozen=True, slots=True)
class Conversion:
    """What shall become of a height map; what is None or 0 stays as it is."""

    fill_holes_px: int = 0
    """Widest hole to fill, in samples."""
    size_m: tuple[float, float] | None = None
    """Extent along X and Y to lay the map on; what does not fit its shape is cut off."""
    relief_m: float | None = None
    """Difference between the highest and the lowest sample, the lowest at 0."""
    spacing_m: float | None = None
    """Distance of the samples."""


def convert(
    raster: Raster,
    wanted: Conversion,
    *,
    announce: Announce,
    on_progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> tuple[Raster, int]:
    """Fill holes, lay the map on a size, scale its heights and resample it, in this order.

    A map whose unit and spacing are known keeps its proportions: laid on another size, its heights
    are scaled as much as its lengths, unless ``relief_m`` says otherwise.

    Args:
        raster: The map.
        wanted: What shall become of it.
        announce: Is told what was done, and what was lost by it.
        on_progress: Is told rows done and rows in all of the resampling.

    Returns:
        The map, and how many of its samples were holes that are filled now.

    Raises:
        TerrainError: A number is not positive, a hole is too wide or has to be filled first, or the
            map does not say what would be needed.
    """
    _check_positive(wanted)
    raster, n_filled = _filled(raster, wanted.fill_holes_px, announce)
    if wanted.size_m is not None:
        raster = _laid_on(raster, wanted.size_m, announce, keeps_shape=wanted.relief_m is None)
    if wanted.relief_m is not None:
        raster = _with_relief(raster, wanted.relief_m)
    if wanted.spacing_m is not None:
        raster = _resampled(raster, wanted, wanted.spacing_m, announce, on_progress)
        if wanted.relief_m is not None:  # of which smoothing takes a little
            raster = _with_relief(raster, wanted.relief_m)
    return raster, n_filled


def with_unit(raster: Raster, unit_m: float) -> Raster:
    """Say what a file leaves open: the height of 1 in its numbers.

    Raises:
        TerrainError: The file says it itself, or the unit is not positive.
    """
    if not unit_m > 0:
        raise TerrainError(f"the unit of height is {unit_m} m, must be positive")
    if raster.has_unit:
        raise TerrainError("the file gives its heights in metres and needs no unit of height")
    return replace(
        raster, height_m=raster.height_m * raster.height_m.dtype.type(unit_m), has_unit=True
    )


def heightmap_of(raster: Raster, origin_trs_m: FloatArray, *, announce: Announce) -> HeightMap:
    """Make a terrain model of a map: float32 above an origin, equally spaced.

    Heights in double precision are laid above their lowest one first, as single precision would
    round those far from 0.

    Raises:
        TerrainError: The map has holes, no unit, no spacing or two different ones.
    """
    spacing_m = _one_spacing(raster)
    heights, origin_trs_m = raster.height_m, np.array(origin_trs_m, dtype=np.float64)
    if heights.dtype == np.float64:
        lowest_m = _known(raster).lowest_m
        heights = (heights - lowest_m).astype(np.float32)
        origin_trs_m[2] += lowest_m
        rounding_m = float(np.spacing(heights.max())) / 2
        announce(
            f"heights rounded to single precision above the lowest: {rounding_m:.1g} m at most"
        )
    return HeightMap(np.ascontiguousarray(heights, np.float32), spacing_m, origin_trs_m)


def _check_positive(wanted: Conversion) -> None:
    sizes = wanted.size_m or ()
    for name, values in (
        ("size", sizes),
        ("relief", () if wanted.relief_m is None else (wanted.relief_m,)),
        ("spacing", () if wanted.spacing_m is None else (wanted.spacing_m,)),
    ):
        for value in values:
            if not (value > 0 and np.isfinite(value)):
                raise TerrainError(f"the {name} is {value} m, must be positive")
    if wanted.fill_holes_px < 0:
        raise TerrainError(f"the widest hole is {wanted.fill_holes_px} samples, must be 0 or more")


def _filled(raster: Raster, widest_px: int, announce: Announce) -> tuple[Raster, int]:
    if widest_px == 0:
        return raster, 0
    heights, n_filled = fill_holes(raster.height_m, widest_px=widest_px)
    announce(f"{n_filled} samples were holes and are filled" if n_filled else "there are no holes")
    return replace(raster, height_m=heights), n_filled


def _laid_on(
    raster: Raster, size_m: tuple[float, float], announce: Announce, *, keeps_shape: bool
) -> Raster:
    n_rows, n_columns = raster.height_m.shape
    along_x_m, along_y_m = raster.spacing_m or (1.0, 1.0)
    aspect = along_x_m / along_y_m
    sample_m = max(size_m[0] / ((n_rows - 1) * aspect), size_m[1] / (n_columns - 1))
    heights = cut_to_shape(raster.height_m, size_m, aspect=aspect, announce=announce)
    if keeps_shape and raster.has_unit and raster.spacing_m is not None:
        scale = sample_m / along_y_m
        heights = heights * heights.dtype.type(scale)
        announce(f"heights are scaled as the lengths are, by {scale:.6g}")
    # Where the sample is and in which coordinates says nothing about a model any more.
    return Raster(heights, (sample_m * aspect, sample_m), raster.has_unit)


def _with_relief(raster: Raster, relief_m: float) -> Raster:
    known = _known(raster)
    if known.highest_m == known.lowest_m:
        raise TerrainError(f"all heights are {known.lowest_m:g}: there is no relief to scale")
    dtype = raster.height_m.dtype.type
    factor = relief_m / (known.highest_m - known.lowest_m)
    heights = (raster.height_m - dtype(known.lowest_m)) * dtype(factor)
    return replace(raster, height_m=heights, has_unit=True)


def _resampled(
    raster: Raster,
    wanted: Conversion,
    spacing_m: float,
    announce: Announce,
    on_progress: Callable[[int, int], None],
) -> Raster:
    if raster.spacing_m is None or not raster.has_unit:
        raise TerrainError(
            "resampling needs to know how far apart the samples are and the unit of their heights,"
            " which the file does not say; give --size-m and --relief-m"
        )
    _check_no_holes(raster)
    if wanted.size_m is None:
        heights, loss = resample_to_spacing(
            raster.height_m, raster.spacing_m, spacing_m, on_progress=on_progress
        )
    else:
        rows, columns = (round(length / spacing_m) + 1 for length in wanted.size_m)
        heights, loss = resample(
            raster.height_m, raster.spacing_m, (rows, columns), on_progress=on_progress
        )
    announce(str(loss))
    return replace(raster, height_m=heights, spacing_m=(spacing_m, spacing_m))


def _one_spacing(raster: Raster) -> float:
    """Give the spacing of a map that can be a terrain model."""
    if not raster.has_unit:
        raise TerrainError(
            "the file does not say the unit of its heights: tronlab terrain convert with --relief-m"
            " or --height-unit-m does"
        )
    if raster.spacing_m is None:
        raise TerrainError(
            "the file does not say how far apart its samples are: tronlab terrain convert with"
            " --size-m does"
        )
    along_x, along_y = raster.spacing_m
    if abs(along_x - along_y) > _SAME_SPACING * along_y:
        raise TerrainError(
            f"samples are {along_x:g} m apart along X and {along_y:g} m along Y, a model needs one"
            " distance: tronlab terrain convert with --spacing-m makes it one"
        )
    _check_no_holes(raster)
    return along_y


def _check_no_holes(raster: Raster) -> None:
    for i, row in enumerate(raster.height_m):
        is_hole = ~np.isfinite(row)
        if is_hole.any():
            raise TerrainError(
                f"{raster.n_holes} samples are holes, the first at row {i}, column"
                f" {int(np.argmax(is_hole))}; fill them (--fill-holes), or use a part without any"
                " (--crop)"
            )


def _known(raster: Raster) -> HeightStatistics:
    known = known_heights(raster.height_m)
    if known is None:
        raise TerrainError("there are nothing but holes")
    return known
