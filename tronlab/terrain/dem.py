"""tronlab's own file of a terrain model: a NumPy array, and a description in JSON beside it.

``NAME.npy`` holds the heights as float32 in C order, to be opened or mapped by anyone;
``NAME.json`` says where they are, how they were made, and has a checksum of each band of rows.
"""

import json
import zlib
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, model_validator

from tronlab.terrain.dem_file import HeightsFile, read_rows, rows_offset
from tronlab.terrain.heightmap import (
    HeightMap,
    HeightStatistics,
    HeightSums,
    KnownHeights,
    TerrainError,
    rows_per_band,
)
from tronlab.terrain.kernels import n_cores
from tronlab.terrain.mapped import map_floats
from tronlab.yaml_models import Model

_MOST_BANDS_CHECKED = 24
"""A map of more bands of 16 MB is checked on so many of them, first and last included."""


class DemDescription(Model):
    """What the JSON beside the heights says."""

    format: Literal["tronlab-dem"] = "tronlab-dem"
    version: Literal[1] = 1
    shape: tuple[int, int]
    spacing_m: float = Field(gt=0.0)
    origin_trs_m: tuple[float, float, float]
    """Where sample (0, 0) would lie at height 0, in F_TRS."""
    lowest_m: float
    highest_m: float
    mean_m: float
    n_holes_filled: int = Field(default=0, ge=0)
    """How many of the samples were holes where this was measured."""
    made_by: dict[str, Any]
    """How the heights were made."""
    rows_per_checksum: int = Field(ge=1)
    crc32: tuple[int, ...]
    """CRC-32 of each band of rows."""

    @model_validator(mode="after")
    def _check_bands(self) -> Self:
        n_bands = -(-self.shape[0] // self.rows_per_checksum)
        if min(self.shape) < 2 or len(self.crc32) != n_bands:
            raise ValueError(
                f"{self.shape[0]} x {self.shape[1]} samples in bands of {self.rows_per_checksum}"
                f" rows need {n_bands} checksums, there are {len(self.crc32)}"
            )
        return self

    @property
    def fingerprint(self) -> str:
        """Get a name of the heights: other heights have another one."""
        rows, columns = self.shape
        crc32 = zlib.crc32(np.array(self.crc32, np.uint32).tobytes())
        extremes = np.array([self.lowest_m, self.highest_m, self.mean_m]).tobytes()
        return f"{rows}x{columns}-{crc32:08x}{zlib.crc32(extremes):08x}"

    @property
    def statistics(self) -> HeightStatistics:
        """Get what is known of all heights together."""
        return HeightStatistics(self.lowest_m, self.highest_m, self.mean_m)

    def band(self, i: int) -> tuple[int, int]:
        """Give the first row of a band and the row after its last."""
        first = i * self.rows_per_checksum
        return first, min(first + self.rows_per_checksum, self.shape[0])

    def bands_to_check(self) -> list[int]:
        """Give the bands to check when not all are read: of large models a part."""
        n = len(self.crc32)
        return sorted({round(i) for i in np.linspace(0, n - 1, min(n, _MOST_BANDS_CHECKED))})


class DemWriter(HeightsFile):
    """A terrain model being written: it appears under its name when it is finished.

    Use as a context; leaving it without ``finish`` leaves nothing behind.
    """

    def finish(
        self,
        *,
        spacing_m: float,
        origin_trs_m: tuple[float, float, float],
        made_by: Mapping[str, object],
        n_holes_filled: int = 0,
    ) -> DemDescription:
        """Measure the heights, then put both files in place.

        Raises:
            TerrainError: Some heights are not finite, or the files cannot be written.
        """
        step = rows_per_band(self.shape[1])
        sums, checksums = HeightSums(), list[int]()
        for first in range(0, self.shape[0], step):
            band = self.read_rows(first, min(first + step, self.shape[0]))
            sums.add(band)
            checksums.append(zlib.crc32(band.data))
        statistics = sums.result()
        description = DemDescription(
            shape=self.shape,
            spacing_m=spacing_m,
            origin_trs_m=origin_trs_m,
            lowest_m=statistics.lowest_m,
            highest_m=statistics.highest_m,
            mean_m=statistics.mean_m,
            n_holes_filled=n_holes_filled,
            made_by=dict(made_by),
            rows_per_checksum=step,
            crc32=tuple(checksums),
        )
        self.put_in_place_with(description_path(self.path), _as_json(description))
        return description


def _as_json(description: DemDescription) -> str:
    return json.dumps(description.model_dump(mode="json"), indent=1) + "\n"


def description_path(path: Path) -> Path:
    """Give where the description of the heights in a .npy file stands."""
    return path.with_suffix(".json")


def save_dem(
    path: Path, heightmap: HeightMap, *, made_by: Mapping[str, object], n_holes_filled: int = 0
) -> None:
    """Write a terrain model as NAME.npy and NAME.json; files of these names are replaced.

    Args:
        path: NAME.npy.
        heightmap: The model.
        made_by: How it was made: what JSON can hold.
        n_holes_filled: How many of its samples were holes where it was measured.

    Raises:
        TerrainError: The name does not end in .npy, or the files cannot be written.
    """
    x, y, z = map(float, heightmap.origin_trs_m)
    with DemWriter(path, heightmap.height_m.shape) as writer:
        step = rows_per_band(heightmap.height_m.shape[1])
        for first in range(0, heightmap.height_m.shape[0], step):
            writer.write(first, 0, heightmap.height_m[first : first + step])
        writer.finish(
            spacing_m=heightmap.spacing_m,
            origin_trs_m=(x, y, z),
            made_by=made_by,
            n_holes_filled=n_holes_filled,
        )


def describe_dem(path: Path) -> DemDescription:
    """Read what is said of a terrain model, without looking at its heights.

    Args:
        path: NAME.npy.

    Raises:
        TerrainError: The description is missing or damaged.
    """
    beside = description_path(path)
    try:
        return DemDescription.model_validate_json(beside.read_bytes(), strict=True)
    except FileNotFoundError:
        raise TerrainError(
            f"{path}: there is no {beside.name} beside it, which says where the heights are;"
            " tronlab terrain convert makes both from a plain file"
        ) from None
    except OSError as error:
        raise TerrainError(f"{beside}: cannot be read: {error.strerror}") from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the file"
        raise TerrainError(
            f"{beside}: is not the description of a terrain model: {where}: {first['msg']}"
        ) from error


def open_dem(path: Path, *, origin_trs_m: tuple[float, float, float] | None = None) -> HeightMap:
    """Map a terrain model into memory: only what is used of it is ever read.

    Its heights must not be written to; the file would not change.

    Args:
        path: NAME.npy.
        origin_trs_m: Where the model stands, instead of where its description says.

    Raises:
        TerrainError: A file is missing or damaged, or the two do not belong together. Of large
            models only a part is checked.
    """
    description = describe_dem(path)
    heights = _Heights(path, _offset(path, description), description)
    height_m = map_floats(path, description.shape, offset=heights.offset)
    _on_all_cores(heights.check_band, description.bands_to_check())
    return _heightmap(height_m, description, origin_trs_m, file=path)


def read_dem(path: Path, *, origin_trs_m: tuple[float, float, float] | None = None) -> HeightMap:
    """Read a terrain model into memory and check all of it; see ``open_dem``.

    Raises:
        TerrainError: A file is missing or damaged, or the two do not belong together.
    """
    description = describe_dem(path)
    heights = _Heights(path, _offset(path, description), description)
    height_m = np.empty(description.shape, np.float32)
    _on_all_cores(lambda i: heights.read_band(i, height_m), range(len(description.crc32)))
    return _heightmap(height_m, description, origin_trs_m)


def _heightmap(
    height_m: NDArray[np.float32],
    description: DemDescription,
    origin_trs_m: tuple[float, float, float] | None,
    file: Path | None = None,
) -> HeightMap:
    return HeightMap(
        height_m,
        description.spacing_m,
        np.array(origin_trs_m or description.origin_trs_m, dtype=np.float64),
        KnownHeights(description.statistics, description.fingerprint, file),
    )


def _offset(path: Path, description: DemDescription) -> int:
    """Give where the heights begin in their file, which must be as long as the description says."""
    rows, columns = description.shape
    try:
        offset = rows_offset(path, description.shape)
        n_bytes = path.stat().st_size
    except FileNotFoundError:
        raise TerrainError(f"{path}: no such file, though its description is there") from None
    except OSError as error:
        raise TerrainError(f"{path}: cannot be read: {error.strerror}") from error
    if n_bytes != offset + 4 * rows * columns:
        raise TerrainError(
            f"{path}: has {n_bytes} bytes, {rows} x {columns} heights need"
            f" {offset + 4 * rows * columns}; the file is damaged, copy or make it again"
        )
    return offset


@dataclass(frozen=True, slots=True)
class _Heights:
    """A file of heights and what is said of it."""

    path: Path
    offset: int
    description: DemDescription

    def check_band(self, i: int) -> None:
        """Compare a band with its checksum."""
        first, end = self.description.band(i)
        self._read(i, np.empty((end - first, self.description.shape[1]), np.float32))

    def read_band(self, i: int, into: NDArray[np.float32]) -> None:
        """Read a band into its rows of all heights, and compare it with its checksum."""
        first, end = self.description.band(i)
        self._read(i, into[first:end])

    def _read(self, i: int, into: NDArray[np.float32]) -> None:
        first, end = self.description.band(i)
        with self.path.open("rb") as file:
            read_rows(file.fileno(), self.offset, first, into)
        if zlib.crc32(into.data) != self.description.crc32[i]:
            raise TerrainError(
                f"{self.path}: rows {first} to {end - 1} are not those that"
                f" {description_path(self.path).name} was made for: one of the two files is"
                " damaged or of another terrain; copy or make both again"
            )


def _on_all_cores(run: Callable[[int], None], bands: Iterable[int]) -> None:
    with ThreadPoolExecutor(n_cores()) as pool:
        for _ in pool.map(run, bands):
            pass
