"""A terrain handed to Blender, and what Cycles finds there."""

from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from threading import Lock
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.camera import CameraModel
from tronlab.render.cycles.process import BlenderProcess, blender_python
from tronlab.render.memory import check_memory
from tronlab.render.pose_file import write_poses
from tronlab.render.renderer import Lamp, RenderError
from tronlab.terrain.heightmap import HeightMap

BYTES_PER_SAMPLE = 520.0
"""Of Blender's memory at its peak, measured."""
BYTES_AT_LEAST = 0.4e9
IMAGE_LIMIT_S = 1800.0
TERRAIN_LIMIT_S = 120.0
TERRAIN_LIMIT_PER_SAMPLE_S = 4e-5
"""Ten times what it takes here."""


@dataclass(frozen=True, slots=True)
class Sampling:
    """How Cycles samples a pixel."""

    n: int
    over_area: bool
    """All over it, not at its centre alone."""


@dataclass(frozen=True, slots=True)
class Passes:
    """What Cycles writes of an image; arrays of shape (rows, columns), and one more axis or not."""

    radiance: NDArray[np.float32]
    """Under a point lamp in place of the true one, whose intensity is 1."""
    depth_m: NDArray[np.float32]
    """At the pixel's centre; NaN: no terrain."""
    facet_normal: NDArray[np.float32]
    """Unit normal of the triangle in trs, shape (rows, columns, 3)."""
    slope: NDArray[np.float32]
    """Of the smooth surface along X_TRS and Y_TRS, shape (rows, columns, 2)."""
    albedo: NDArray[np.float32]
    """0 where no terrain is seen."""


@dataclass(frozen=True, slots=True)
class PoseFile:
    """Camera poses as Blender reads them."""

    path: Path
    process: BlenderProcess


class BlenderScene:
    """A terrain in Blender, which is started when it is first needed and when it has ended."""

    def __init__(
        self,
        heightmap: HeightMap,
        announce: Callable[[str], None] | None,
    ) -> None:
        self._heightmap = heightmap
        self._announce = announce
        self._python = blender_python()
        self._process: BlenderProcess | None = None
        self._starting = Lock()
        self._numbers = count()
        _check_terrain_fits(heightmap)

    @property
    def spacing_m(self) -> float:
        """Get the distance of the terrain's samples."""
        return self._heightmap.spacing_m

    @contextmanager
    def hand_over(self, trs_from_cams: Sequence[RigidTransform]) -> Generator[PoseFile, None, None]:
        """Write the text file of poses for ``look``, and remove it at the end."""
        process = self._running()
        path = process.folder / f"poses{next(self._numbers)}.txt"
        try:
            write_poses(path, trs_from_cams)
        except OSError as error:
            raise RenderError(f"renderer cycles: {path} cannot be written: {error}") from error
        try:
            yield PoseFile(path, process)
        finally:
            path.unlink(missing_ok=True)

    def look(
        self, poses: PoseFile, i_pose: int, pinhole: CameraModel, lamp: Lamp, sampling: Sampling
    ) -> Passes:
        """Render from one of the poses.

        Args:
            poses: Given by ``hand_over``.
            i_pose: Which, from 0.
            pinhole: A camera without distortion.
            lamp: Its place and radius count, neither its intensity nor its cone.
            sampling: Of a pixel.

        Raises:
            RenderError: Blender cannot, or has ended.
        """
        image = poses.path.with_name(f"image{next(self._numbers)}.npz")
        request = {
            "do": "render",
            "poses": poses.path.name,
            "i_pose": i_pose,
            "camera": {
                name: value for name, value in pinhole.to_dict().items() if name != "distortion"
            },
            "lamp": {"p_trs_m": [float(x) for x in lamp.p_trs_m], "radius_m": lamp.radius_m},
            "n_samples": sampling.n,
            "over_area": sampling.over_area,
            "image": image.name,
        }
        poses.process.ask(request, what="render an image", limit_s=IMAGE_LIMIT_S)
        passes = _read(image)
        image.unlink()
        return passes

    def close(self) -> None:
        """End Blender."""
        if self._process is not None:
            self._process.end()

    def _running(self) -> BlenderProcess:
        with self._starting:
            if self._process is None or self._process.has_ended:
                self._process = self._started()
            return self._process

    def _started(self) -> BlenderProcess:
        n = self._heightmap.height_m.size
        if self._announce is not None:
            gigabytes = _needed_bytes(self._heightmap) / 1e9
            self._announce(f"starting Blender with {n:,} samples of terrain ({gigabytes:.1f} GB)")
        process = BlenderProcess(self._python)
        try:
            self._hand_over_terrain(process)
        except BaseException:
            process.end()
            raise
        return process

    def _hand_over_terrain(self, process: BlenderProcess) -> None:
        terrain, albedo = self._heightmap, self._heightmap.albedo
        request = {
            "do": "terrain",
            "heights": _saved(process.folder / "heights.npy", terrain.height_m),
            "albedo": None if albedo is None else _saved(process.folder / "albedo.npy", albedo),
            "spacing_m": terrain.spacing_m,
            "origin_m": [float(x) for x in terrain.origin_trs_m],
        }
        limit_s = TERRAIN_LIMIT_S + terrain.height_m.size * TERRAIN_LIMIT_PER_SAMPLE_S
        process.ask(request, what="build the terrain", limit_s=limit_s)


def _saved(path: Path, array: NDArray[np.generic]) -> str:
    try:
        np.save(path, array)
    except OSError as error:
        raise RenderError(f"renderer cycles: {path} cannot be written: {error}") from error
    return path.name


def _read(image: Path) -> Passes:
    try:
        with np.load(image) as arrays:
            return Passes(**arrays)
    except (OSError, ValueError, TypeError, BadZipFile) as error:
        raise RenderError(
            f"renderer cycles: Blender wrote no image that can be read: {error}"
        ) from error


def _needed_bytes(heightmap: HeightMap) -> float:
    return BYTES_AT_LEAST + heightmap.height_m.size * BYTES_PER_SAMPLE


def _check_terrain_fits(heightmap: HeightMap) -> None:
    n = heightmap.height_m.size
    check_memory(
        _needed_bytes(heightmap),
        what=f"renderer cycles: a terrain of {n:,} samples ({2 * n:,} triangles) in Blender",
        remedy="take every_n: 2 (every second sample, a quarter of the memory) or more,"
        " or a terrain of coarser spacing",
    )
