"""A height map as a mesh of triangles, written a few rows at a time."""

import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from tronlab.terrain.formats.model import Announce
from tronlab.terrain.formats.writing import written_whole
from tronlab.terrain.heightmap import HeightMap, TerrainError

OnProgress: TypeAlias = Callable[[int, int], None]
"""Is told how many rows are done, of how many."""
MeshWriter: TypeAlias = Callable[["Mesh", Path, OnProgress], None]

_NODES_AT_ONCE = 250_000
_LARGEST_INDEX = 2**32 - 1
_PLY_FACE = np.dtype([("n", "u1"), ("nodes", "<u4", 3)])
_STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


@dataclass(frozen=True, slots=True)
class Mesh:
    """Every n-th node of a height map, joined to triangles whose normals point along +Z_TRS."""

    height_map: HeightMap
    every_n: int

    @property
    def shape(self) -> tuple[int, int]:
        """Get how many nodes there are along X_TRS and Y_TRS."""
        rows, columns = self.height_map.height_m.shape
        return (rows - 1) // self.every_n + 1, (columns - 1) // self.every_n + 1

    @property
    def n_nodes(self) -> int:
        """Get the number of nodes."""
        return self.shape[0] * self.shape[1]

    @property
    def n_triangles(self) -> int:
        """Get the number of triangles."""
        return 2 * (self.shape[0] - 1) * (self.shape[1] - 1)

    def bands(self, overlap: int) -> Iterator[tuple[int, int]]:
        """Give first and last row (not included) of bands of nodes of which few fit in memory."""
        n_rows = self.shape[0]
        step = max(1, _NODES_AT_ONCE // self.shape[1])
        for first in range(0, n_rows - overlap, step):
            yield first, min(first + step + overlap, n_rows)

    def nodes_trs_m(self, first: int, last: int) -> NDArray[np.float64]:
        """Give the nodes of some rows, shape (rows, columns, 3)."""
        step_m = self.every_n * self.height_map.spacing_m
        n = self.every_n
        nodes = np.empty((last - first, self.shape[1], 3))
        nodes[..., 0] = np.arange(first, last)[:, None] * step_m
        nodes[..., 1] = np.arange(self.shape[1]) * step_m
        nodes[..., 2] = self.height_map.height_m[first * n : (last - 1) * n + 1 : n, ::n]
        return nodes + self.height_map.origin_trs_m

    def triangles(self, first: int, last: int) -> NDArray[np.int64]:
        """Give the node numbers of the triangles between some rows, shape (triangles, 3)."""
        n_columns = self.shape[1]
        rows = np.arange(first, last - 1)[:, None] * n_columns
        corner = rows + np.arange(n_columns - 1)
        across = corner + n_columns + 1
        lower = np.stack([corner, corner + n_columns, across], axis=-1)
        upper = np.stack([corner, across, corner + 1], axis=-1)
        return np.stack([lower, upper], axis=2).reshape(-1, 3)


def write_ply(mesh: Mesh, path: Path, on_progress: OnProgress) -> None:
    """Write a binary PLY file: 12 bytes a node, 13 a triangle."""
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment F_TRS, metres\n"
        f"element vertex {mesh.n_nodes}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {mesh.n_triangles}\n"
        "property list uchar uint vertex_indices\nend_header\n"
    )
    n_rows = mesh.shape[0]
    with written_whole(path) as draft, draft.open("wb") as file:
        file.write(header.encode("ascii"))
        for first, last in mesh.bands(overlap=0):
            file.write(mesh.nodes_trs_m(first, last).astype("<f4").data)
            on_progress(last, 2 * n_rows)
        for first, last in mesh.bands(overlap=1):
            triangles = mesh.triangles(first, last)
            faces = np.empty(len(triangles), _PLY_FACE)
            faces["n"] = 3
            faces["nodes"] = triangles
            file.write(faces.data)
            on_progress(n_rows + last, 2 * n_rows)


def write_stl(mesh: Mesh, path: Path, on_progress: OnProgress) -> None:
    """Write a binary STL file: 50 bytes a triangle, nodes repeated."""
    with written_whole(path) as draft, draft.open("wb") as file:
        file.write(b"tronlab height map, F_TRS, metres".ljust(80))
        file.write(struct.pack("<I", mesh.n_triangles))
        for first, last in mesh.bands(overlap=1):
            nodes = mesh.nodes_trs_m(first, last).reshape(-1, 3)
            corners = nodes[mesh.triangles(0, last - first)]
            normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            triangles = np.zeros(len(corners), _STL_TRIANGLE)
            triangles["corners"] = corners
            triangles["normal"] = normal / np.linalg.norm(normal, axis=1, keepdims=True)
            file.write(triangles.data)
            on_progress(last, mesh.shape[0])


def write_obj(mesh: Mesh, path: Path, on_progress: OnProgress) -> None:
    """Write a Wavefront OBJ file: text, coordinates to 0.1 um."""
    n_rows = mesh.shape[0]
    with written_whole(path) as draft, draft.open("w", encoding="ascii", newline="\n") as file:
        file.write("# F_TRS, metres\n")
        for first, last in mesh.bands(overlap=0):
            nodes = mesh.nodes_trs_m(first, last).reshape(-1, 3)
            file.write(len(nodes) * "v %.7f %.7f %.7f\n" % tuple(nodes.ravel().tolist()))
            on_progress(last, 2 * n_rows)
        for first, last in mesh.bands(overlap=1):
            numbers = mesh.triangles(first, last) + 1
            file.write(len(numbers) * "f %d %d %d\n" % tuple(numbers.ravel().tolist()))
            on_progress(n_rows + last, 2 * n_rows)


MESH_WRITERS: Mapping[str, MeshWriter] = {".ply": write_ply, ".stl": write_stl, ".obj": write_obj}


def mesh_of(height_map: HeightMap, every_n: int, path: Path, announce: Announce) -> Mesh:
    """Choose the nodes and check that files can number them.

    Raises:
        TerrainError: No cell is left, or nodes or triangles need more than 32 bits.
    """
    if every_n < 1:
        raise TerrainError(f"{path}: every_n is {every_n}, must be 1 or more")
    mesh = Mesh(height_map, every_n)
    rows, columns = mesh.shape
    if min(rows, columns) < 2:
        raise TerrainError(
            f"{path}: every {every_n}-th node of {height_map.height_m.shape[0]} x"
            f" {height_map.height_m.shape[1]} leaves {rows} x {columns}, a mesh needs 2 x 2"
        )
    if max(mesh.n_nodes, mesh.n_triangles) > _LARGEST_INDEX:
        raise TerrainError(
            f"{path}: {mesh.n_triangles} triangles are more than the format can number"
            f" ({_LARGEST_INDEX}); make every_n larger"
        )
    announce(f"{path.name}: {mesh.n_nodes} nodes and {mesh.n_triangles} triangles")
    return mesh
