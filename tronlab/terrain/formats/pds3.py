"""Images of heights of the Planetary Data System, version 3: raw samples and a label."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tronlab.terrain.formats.model import (
    Announce,
    Raster,
    Window,
    check_shape,
    corner_of_window,
    from_numbers,
    window_slices,
)
from tronlab.terrain.formats.pds3_label import Label, Section, file_beside, read_label
from tronlab.terrain.formats.pds3_map import place_of, radius_m
from tronlab.terrain.heightmap import TerrainError

_SAMPLE_TYPES = {
    ">i": ("MSB_INTEGER", "INTEGER", "SUN_INTEGER", "MAC_INTEGER"),
    ">u": (
        "MSB_UNSIGNED_INTEGER",
        "UNSIGNED_INTEGER",
        "SUN_UNSIGNED_INTEGER",
        "MAC_UNSIGNED_INTEGER",
    ),
    "<i": ("LSB_INTEGER", "PC_INTEGER", "VAX_INTEGER"),
    "<u": ("LSB_UNSIGNED_INTEGER", "PC_UNSIGNED_INTEGER", "VAX_UNSIGNED_INTEGER"),
    ">f": ("IEEE_REAL", "FLOAT", "REAL", "SUN_REAL", "MAC_REAL"),
    "<f": ("PC_REAL",),
}
"""Names of sample types (PDS Standards Reference, version 3.8, table 3.2)."""
_BITS = {"i": (16, 32), "u": (16, 32), "f": (32, 64)}
_HOLE_KEYWORDS = (
    "MISSING_CONSTANT",
    "MISSING",
    "CORE_NULL",
    "NULL_CONSTANT",
    "INVALID_CONSTANT",
    "UNKNOWN_CONSTANT",
    "NOT_APPLICABLE_CONSTANT",
    "DUMMY",
)
_OTHER_FORMATS = (".tif", ".tiff", ".jp2", ".png", ".jpg")
_LARGEST_REAL = 1e38
"""Reals beyond are special pixels of image processing, not heights."""
_SMALLEST_BIT_PATTERN = 2**30
"""A whole number from here on, said of reals, is their bit pattern: 16#FF7FFFFB#."""
_METRES = {
    **dict.fromkeys(("M", "METER", "METERS", "METRE", "METRES"), 1.0),
    **dict.fromkeys(("KM", "KILOMETER", "KILOMETERS"), 1000.0),
}


@dataclass(frozen=True, slots=True)
class _Layout:
    """Where in which file the samples lie."""

    path: Path
    offset_bytes: int
    shape: tuple[int, int]
    dtype: np.dtype[Any]
    prefix_bytes: int
    suffix_bytes: int

    def samples(self) -> NDArray[Any]:
        """Map the samples into memory, shape ``shape``."""
        rows, columns = self.shape
        sample_bytes = columns * self.dtype.itemsize
        line_bytes = self.prefix_bytes + sample_bytes + self.suffix_bytes
        needed = self.offset_bytes + rows * line_bytes
        there = self.path.stat().st_size
        if there < needed:
            raise TerrainError(
                f"{self.path}: has {there} bytes, its label promises {needed}; the file is cut off"
            )
        lines = np.memmap(
            self.path, np.uint8, "r", offset=self.offset_bytes, shape=(rows, line_bytes)
        )
        inside = np.asarray(lines)[:, self.prefix_bytes : self.prefix_bytes + sample_bytes]
        return inside.view(self.dtype)


def read_pds3(path: Path, window: Window | None, announce: Announce) -> Raster:
    """Read heights, ``sample * SCALING_FACTOR + OFFSET``, from an image or by its label.

    Where OFFSET is the radius of the body, heights are radii. The spacing is the label's MAP_SCALE,
    which holds where the projection is true to scale.

    Raises:
        TerrainError: No label, one that is damaged or describes no map of heights, or samples are
            missing.
    """
    label = read_label(path)
    file_section, image = label.image()
    layout = _layout(label, file_section, image)
    check_shape(layout.shape, layout.path)
    unit_m, has_unit = _unit(label, image, layout.dtype)
    offset = label.number(image, "OFFSET", 0.0)[0]
    place = place_of(label, announce)
    _tell_of_radii(label, offset * unit_m, announce)
    rows, columns = window_slices(window, layout.shape, layout.path)
    numbers = layout.samples()[rows, columns]
    heights = from_numbers(
        numbers,
        scale=label.number(image, "SCALING_FACTOR", 1.0)[0] * unit_m,
        offset=offset * unit_m,
        holes=_holes(label, image, numbers),
    )
    if place is None:
        return Raster(heights, has_unit=has_unit)
    corner_m = corner_of_window(place.corner_m, place.spacing_m, window)
    return Raster(heights, place.spacing_m, has_unit, place.crs, corner_m)


def files_of_pds3(path: Path) -> tuple[Path, ...]:
    """Name the label and the image, of which ``path`` is one.

    Raises:
        TerrainError: As ``read_pds3``.
    """
    label = read_label(path)
    image_path, _ = _pointed_at(label, label.image()[0])
    return tuple(dict.fromkeys((label.path, image_path)))


def _layout(label: Label, file_section: Section, image: Section) -> _Layout:
    if label.whole(image, "BANDS", 1) != 1:
        raise label.error(f"has an image of {image['BANDS']} BANDS, a height map has one")
    encoding = label.word(image, "ENCODING_TYPE", "N/A")
    if encoding not in ("N/A", "NONE", "UNCOMPRESSED"):
        raise label.error(f"has an image with ENCODING_TYPE {encoding}, which cannot be read")
    path, offset_bytes = _pointed_at(label, file_section)
    return _Layout(
        path,
        offset_bytes,
        (label.whole(image, "LINES"), label.whole(image, "LINE_SAMPLES")),
        _dtype(label, image),
        label.whole(image, "LINE_PREFIX_BYTES", 0),
        label.whole(image, "LINE_SUFFIX_BYTES", 0),
    )


def _pointed_at(label: Label, file_section: Section) -> tuple[Path, int]:
    """Follow ^IMAGE: "FILE", RECORD, BYTE <BYTES>, or ("FILE", RECORD or BYTE <BYTES>)."""
    pointer: Any = file_section["^IMAGE"]
    parts = list(pointer) if isinstance(pointer, list) else [pointer]
    path = label.path
    if parts and isinstance(parts[0], str):
        name = parts.pop(0)
        found = file_beside(label.path, name)
        if found is None:
            raise TerrainError(
                f"{label.path.with_name(name)}: does not exist; the PDS3 label"
                f" {label.path.name} names it as the image"
            )
        if found.suffix.lower() in _OTHER_FORMATS:
            raise label.error(
                f"points to {found.name}, which is no raw image; read that file itself"
            )
        path = found
    place = {"^IMAGE": parts[0] if parts else 1}
    number = label.whole(place, "^IMAGE")
    is_in_bytes = label.number(place, "^IMAGE")[1].startswith("BYTE")
    record_bytes = 1 if is_in_bytes or number == 1 else label.whole(file_section, "RECORD_BYTES")
    if number < 1:
        raise label.error(f"points to ^IMAGE {number}; counting begins at 1")
    return path, (number - 1) * record_bytes


def _dtype(label: Label, image: Section) -> np.dtype[Any]:
    name, bits = label.word(image, "SAMPLE_TYPE"), label.whole(image, "SAMPLE_BITS")
    kinds = [kind for kind, names in _SAMPLE_TYPES.items() if name in names]
    if not kinds:
        allowed = ", ".join(name for names in _SAMPLE_TYPES.values() for name in names)
        raise label.error(f"gives SAMPLE_TYPE as {name or 'nothing'} (allowed: {allowed})")
    if bits not in _BITS[kinds[0][1]]:
        allowed = " or ".join(map(str, _BITS[kinds[0][1]]))
        raise label.error(f"gives SAMPLE_BITS as {bits}; {name} heights have {allowed}")
    return np.dtype(f"{kinds[0]}{bits // 8}")


def _unit(label: Label, image: Section, dtype: np.dtype[Any]) -> tuple[float, bool]:
    """Give the metres of a height of 1, and whether the file says so; reals are metres without."""
    unit = label.word(image, "UNIT", "N/A")
    if unit in ("N/A", "NULL", "UNK"):
        return 1.0, dtype.kind == "f"
    if unit not in _METRES:
        raise label.error(f"gives UNIT as {unit}; heights are in metres or kilometres")
    return _METRES[unit], True


def _tell_of_radii(label: Label, offset_m: float, announce: Announce) -> None:
    section = label.section("IMAGE_MAP_PROJECTION")
    if offset_m != 0.0 and section is not None and radius_m(label, section) == offset_m:
        announce(
            f"{label.path.name}: OFFSET is the radius of the body: heights count from its centre,"
            f" {offset_m:.0f} m below the reference sphere"
        )


def _holes(label: Label, image: Section, numbers: NDArray[Any]) -> NDArray[np.bool_]:
    holes = np.zeros(numbers.shape, dtype=np.bool_)
    for keyword in _HOLE_KEYWORDS:
        values: Any = image.get(keyword, [])
        for value in values if isinstance(values, list) else [values]:
            if not isinstance(value, str):  # "N/A", "NULL"
                constant = label.number({keyword: value}, keyword)[0]
                holes |= numbers == _as_sample(constant, numbers.dtype)
    if numbers.dtype.kind == "f":
        holes |= ~(np.abs(numbers) < _LARGEST_REAL)
    return holes


def _as_sample(constant: float, dtype: np.dtype[Any]) -> Any:
    if dtype.kind != "f":
        return constant
    if isinstance(constant, int) and constant >= _SMALLEST_BIT_PATTERN:
        return np.array(constant, dtype=f"u{dtype.itemsize}").view(f"f{dtype.itemsize}")
    return dtype.type(constant)
