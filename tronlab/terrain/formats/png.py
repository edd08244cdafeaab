"""Grey PNG images of 16 bit; what the levels mean stands in a text chunk of the file itself."""

import io
import json
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from tronlab.terrain.formats.model import (
    Announce,
    Heights,
    Raster,
    Window,
    WriteReport,
    check_shape,
    corner_of_window,
    from_numbers,
    window_slices,
)
from tronlab.terrain.formats.writing import written_whole
from tronlab.terrain.heightmap import TerrainError
from tronlab.yaml_models import Model

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_HEADER_END = len(_SIGNATURE) + 25  # the header chunk: length, type, 13 bytes, checksum
_KEYWORD = b"tronlab-heights"
_HIGHEST_LEVEL = 65535
_HOLE_LEVEL = 0


class _Levels(Model):
    """What the levels of an image mean: height = offset + step * level."""

    height_step: float = Field(default=1.0, gt=0.0)
    height_offset: float = 0.0
    has_unit: bool = True
    """True: step and offset are metres."""
    hole_level: int | None = None
    spacing_m: tuple[float, float] | None = None
    crs: str | None = None
    corner_m: tuple[float, float] | None = None


def read_png(path: Path, window: Window | None, announce: Announce) -> Raster:
    """Read a 16-bit grey image: metres where tronlab wrote it, else numbers without a unit.

    Raises:
        TerrainError: No PNG image, damaged, colours, or another depth.
    """
    image = _decoded(path)
    levels = _levels_of(path)
    level = image[window_slices(window, image.shape, path)]
    if levels is None:
        return Raster(from_numbers(level), has_unit=False)
    heights = from_numbers(
        level.astype(np.float64),
        scale=levels.height_step,
        offset=levels.height_offset,
        holes=None if levels.hole_level is None else level == levels.hole_level,
    )
    corner_m = corner_of_window(levels.corner_m, levels.spacing_m, window)
    return Raster(heights, levels.spacing_m, levels.has_unit, levels.crs, corner_m)


def write_png(raster: Raster, path: Path) -> WriteReport:
    """Write heights in up to 65536 levels, from the lowest to the highest; level 0 is a hole.

    Whole numbers that fit are kept exactly.

    Raises:
        TerrainError: There is no height at all, or the image is too large for the format.
    """
    levels, is_exact = _levels_for(raster, path)
    _write_image(path, _quantised(raster.height_m, levels), levels)
    return WriteReport(
        path,
        largest_error_m=0.0 if is_exact else levels.height_step / 2,
        height_step_m=levels.height_step,
        height_offset_m=levels.height_offset,
        has_unit=raster.has_unit,
    )


def _decoded(path: Path) -> NDArray[np.uint16]:
    import cv2

    with path.open("rb") as file:
        is_png = file.read(len(_SIGNATURE)) == _SIGNATURE
    try:
        image: Any = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) if is_png else None
    except cv2.error as error:
        raise TerrainError(f"{path}: cannot be read as a PNG image: {error}") from error
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
    check_shape(image.shape, path)
    return image


def _levels_of(path: Path) -> _Levels | None:
    """Read what tronlab wrote beside the image, None for somebody else's image."""
    for kind, data in _chunks(path):
        keyword, _, text = data.partition(b"\0")
        if kind == b"tEXt" and keyword == _KEYWORD:
            try:
                return _Levels.model_validate_json(text)
            except ValidationError as error:
                first = error.errors()[0]
                raise TerrainError(
                    f"{path}: the text chunk {_KEYWORD.decode()} is damaged:"
                    f" {'.'.join(map(str, first['loc']))}: {first['msg']}"
                ) from error
    return None


def _levels_for(raster: Raster, path: Path) -> tuple[_Levels, bool]:
    """Choose what the levels mean, and say whether they hold the heights exactly."""
    heights = raster.height_m
    is_height = np.isfinite(heights)
    if not is_height.any():
        raise TerrainError(f"{path}: all samples are holes: there is no height to write")
    lowest_level = 0 if is_height.all() else _HOLE_LEVEL + 1
    lowest = float(heights.min(initial=np.inf, where=is_height))
    highest = float(heights.max(initial=-np.inf, where=is_height))
    most_steps = _HIGHEST_LEVEL - lowest_level
    are_whole = np.array_equal(heights[is_height], np.rint(heights[is_height]))
    is_exact = lowest == highest or (are_whole and highest - lowest <= most_steps)
    step = 1.0 if is_exact else (highest - lowest) / most_steps
    fits_as_it_is = are_whole and lowest >= lowest_level and highest <= _HIGHEST_LEVEL
    levels = _Levels(
        height_step=step,
        height_offset=0.0 if fits_as_it_is else lowest - step * lowest_level,
        has_unit=raster.has_unit,
        hole_level=_HOLE_LEVEL if lowest_level > _HOLE_LEVEL else None,
        spacing_m=raster.spacing_m,
        crs=raster.crs,
        corner_m=raster.corner_m,
    )
    return levels, is_exact


def _quantised(heights: Heights, levels: _Levels) -> NDArray[np.uint16]:
    image = np.empty(heights.shape, np.uint16)
    for row, height in enumerate(heights):  # row by row: no second array of 64 bit in memory
        level = (height.astype(np.float64) - levels.height_offset) / levels.height_step
        level[~np.isfinite(level)] = _HOLE_LEVEL
        image[row] = np.rint(level)
    return image


def _write_image(path: Path, image: NDArray[np.uint16], levels: _Levels) -> None:
    import cv2

    try:
        is_encoded, encoded = cv2.imencode(".png", image)
    except cv2.error as error:
        raise TerrainError(f"{path}: cannot be made a PNG image: {error}") from error
    if not is_encoded:
        raise TerrainError(f"{path}: cannot be made a PNG image")
    text = json.dumps(levels.model_dump(mode="json", exclude_none=True)).encode("ascii")
    data = encoded.ravel().data
    with written_whole(path) as draft, draft.open("wb") as file:
        file.write(data[:_HEADER_END])
        file.write(_chunk(b"tEXt", _KEYWORD + b"\0" + text))
        file.write(data[_HEADER_END:])


def _chunks(path: Path) -> Iterator[tuple[bytes, bytes]]:
    """Give type and data of the chunks that stand before the pixels.

    The layout: W3C, Portable Network Graphics (PNG) Specification, 3rd edition, section 5.
    """
    with path.open("rb") as file:
        file.seek(len(_SIGNATURE))
        while len(head := file.read(8)) == 8:
            length, kind = struct.unpack(">I4s", head)
            if kind == b"IDAT":
                return
            yield kind, file.read(length)
            file.seek(4, io.SEEK_CUR)  # the checksum


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
