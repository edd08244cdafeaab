"""A terrain as Mitsuba's scene, and what is known of its surface where a ray meets it."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tronlab.geometry.poses import FloatArray
from tronlab.render.memory import check_memory
from tronlab.render.mitsuba.backend import Backend
from tronlab.terrain.heightmap import HeightMap

_BYTES_PER_TRIANGLE = 140.0
"""Measured: vertices, slopes, albedo, the triangles and Embree's tree over them, at its peak."""

_ASIDE_M = (1e-6, 0.6e-6, 0.0)


class Hits(NamedTuple):
    """Where rays meet the terrain from above; every field is an array over the rays."""

    is_seen: Any
    to_eye: Any
    """Unit vector against the ray."""
    depth: Any
    """The ray's parameter."""
    p: Any
    """Point, in the scene's frame."""
    facet_normal: Any
    """Of the triangle."""
    normal: Any
    """Of the smooth surface."""
    albedo: Any


class TerrainScene:
    """The terrain's triangles.

    The scene's frame is that of the height map moved to the model's middle, where single precision
    is finest.
    """

    def __init__(self, backend: Backend, heightmap: HeightMap) -> None:
        self._backend = backend
        height_m = heightmap.height_m
        self._n_columns = height_m.shape[1]
        self.origin_trs_m = _middle_trs_m(heightmap)
        # Not Mitsuba's own vertex normals: interpolated in a triangle they are not quite those of
        # slopes interpolated in a cell, on which the renderers have agreed.
        slopes = np.gradient(height_m, np.float32(heightmap.spacing_m))
        self._slopes = [backend.mi.Float(slope.ravel()) for slope in slopes]
        albedo = heightmap.albedo
        self._albedo = None if albedo is None else backend.mi.Float(np.float32(albedo).ravel())
        self.scene = self._scene(heightmap)

    def hits(self, rays: Any) -> Hits:
        """Find where rays (Ray3f, in the scene's frame) first meet the terrain from above."""
        mi, dr = self._backend
        found = self._met(rays)
        surface = found.compute_surface_interaction(rays, mi.RayFlags.Minimal)
        is_seen = found.is_valid() & (dr.dot(surface.n, rays.d) < 0)
        nodes, weights = self._cell(found)
        x, y = (self._interpolated(slope, nodes, weights, is_seen) for slope in self._slopes)
        albedo = 1.0
        if self._albedo is not None:
            albedo = self._interpolated(self._albedo, nodes, weights, is_seen) / 65535.0
        normal = dr.normalize(mi.Vector3f(-x, -y, 1))
        to_eye = -dr.normalize(rays.d)
        return Hits(is_seen, to_eye, found.t, surface.p, surface.n, normal, albedo)

    def _met(self, rays: Any) -> Any:
        """Find the triangles that rays meet.

        Embree's are not watertight: of 100000 rays one slips between two of them. What meets
        nothing looks again from a little aside.
        """
        mi, dr = self._backend
        found = self.scene.ray_intersect_preliminary(rays, coherent=True)
        is_lost = ~found.is_valid()
        aside = mi.Ray3f(rays.o + mi.Vector3f(*_ASIDE_M), rays.d)
        again = self.scene.ray_intersect_preliminary(aside, coherent=True, active=is_lost)
        return dr.select(is_lost, again, found)

    def _cell(self, found: Any) -> tuple[list[Any], list[Any]]:
        """Give the four nodes around hits and their weights in a bilinear interpolation."""
        dr = self._backend.dr
        n_cells = self._n_columns - 1
        cell = found.prim_index // 2
        row = cell // n_cells
        node = row * self._n_columns + cell - row * n_cells
        is_upper = found.prim_index & 1 == 0
        # Weights of a triangle's second and third corner; the second of the upper one and the
        # third of the lower one lie across the diagonal.
        second, third = found.prim_uv.x, found.prim_uv.y
        across_rows = dr.select(is_upper, second, second + third)
        across_columns = dr.select(is_upper, second + third, third)
        nodes = [node, node + 1, node + self._n_columns, node + self._n_columns + 1]
        weights = [
            (1 - across_rows) * (1 - across_columns),
            (1 - across_rows) * across_columns,
            across_rows * (1 - across_columns),
            across_rows * across_columns,
        ]
        return nodes, weights

    def _interpolated(self, values: Any, nodes: list[Any], weights: list[Any], where: Any) -> Any:
        mi, dr = self._backend
        terms = [
            weight * dr.gather(mi.Float, values, node, where)
            for node, weight in zip(nodes, weights, strict=True)
        ]
        return sum(terms[1:], terms[0])

    def _scene(self, heightmap: HeightMap) -> Any:
        mi, dr = self._backend
        vertices = _vertices(heightmap, self.origin_trs_m)
        mesh = mi.Mesh("terrain", len(vertices), 2 * _n_cells(heightmap))
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = mi.Float(vertices.ravel())
        del vertices
        parameters["faces"] = mi.UInt32(_faces(heightmap.height_m.shape).ravel())
        parameters.update()
        scene = mi.load_dict({"type": "scene", "terrain": mesh})
        dr.flush_malloc_cache()
        return scene


def check_terrain_fits(heightmap: HeightMap) -> str:
    """Refuse a terrain whose triangles do not fit into memory; tell how much they will take.

    Raises:
        RenderError: There is less memory.
    """
    n_triangles = 2 * _n_cells(heightmap)
    needed = n_triangles * _BYTES_PER_TRIANGLE
    what = f"renderer mitsuba: a terrain of {n_triangles / 1e6:.1f} million triangles"
    check_memory(
        needed,
        what=what,
        remedy="take every second sample alone (every_n: 2) or fewer, or a wider spacing",
    )
    return f"{what}, about {needed / 1e9:.1f} GB"


def _n_cells(heightmap: HeightMap) -> int:
    rows, columns = heightmap.height_m.shape
    return (rows - 1) * (columns - 1)


def _middle_trs_m(heightmap: HeightMap) -> FloatArray:
    middle_height_m = 0.5 * (float(heightmap.height_m.min()) + float(heightmap.height_m.max()))
    middle_m = np.array([0.5 * size_m for size_m in heightmap.size_m] + [middle_height_m])
    return heightmap.origin_trs_m + middle_m


def _vertices(heightmap: HeightMap, origin_trs_m: FloatArray) -> NDArray[np.float32]:
    """Give the nodes about the origin, shape (n, 3), row by row."""
    height_m = heightmap.height_m
    x0, y0, z0 = heightmap.origin_trs_m - origin_trs_m
    vertices = np.empty((*height_m.shape, 3), dtype=np.float32)
    vertices[..., 0] = (x0 + np.arange(height_m.shape[0]) * heightmap.spacing_m)[:, None]
    vertices[..., 1] = y0 + np.arange(height_m.shape[1]) * heightmap.spacing_m
    np.add(height_m, np.float32(z0), out=vertices[..., 2])
    return vertices.reshape(-1, 3)


def _faces(shape: tuple[int, ...]) -> NDArray[np.uint32]:
    """Give the corners of the triangles, shape (rows - 1, columns - 1, 2, 3).

    Of a cell first the upper triangle, then the lower one; both begin at node (i, j) and turn
    anticlockwise seen from above, so that their normals point up.
    """
    node = np.arange(shape[0] * shape[1], dtype=np.uint32).reshape(shape)
    faces = np.empty((shape[0] - 1, shape[1] - 1, 2, 3), dtype=np.uint32)
    faces[..., 0] = node[:-1, :-1, None]
    faces[..., 0, 1] = faces[..., 1, 2] = node[1:, 1:]
    faces[..., 0, 2] = node[:-1, 1:]
    faces[..., 1, 1] = node[1:, :-1]
    return faces
