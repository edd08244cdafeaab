"""Bodies and lines of a scene as flat faces, in trs, with the colour they are drawn in."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise, product

import numpy as np
from matplotlib.colors import to_rgb
from numpy.typing import NDArray

from tronlab.geometry.poses import FloatArray
from tronlab.terrain.heightmap import HeightMap

_AROUND = 16
"""Sides of a drawn capsule."""
_CAP_RINGS = 4
_LONGEST_FACE_M = 0.15
"""Longer lines and faces are cut, so that what is nearer can be told face by face."""
_AMBIENT = 0.45
_TERRAIN_NODES = 60
"""Nodes of the drawn terrain along its longer side."""
_SKIRT_M = 0.15
"""The model is drawn as a slab so much thicker than its relief."""
_BOX_FACES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
"""Corners of the faces of a box, whose corners count as ``itertools.product`` does."""


@dataclass(frozen=True, slots=True)
class Faces:
    """Faces with one number of corners; two corners are a line."""

    points_trs_m: FloatArray
    """Shape (n, corners, 3)."""
    colours: FloatArray
    """Red, green, blue and opacity of each, shape (n, 4)."""
    line_width: float = 0.0
    """Of lines and of the borders of faces, points; 0: no border."""


def terrain(heightmap: HeightMap, p_lamp_trs_m: FloatArray) -> Faces:
    """Give the model as a slab whose surface is lit by the lamp, shadows left out."""
    nodes = _terrain_nodes(heightmap)
    surface = _grid_faces(nodes)
    lit = _lambert(surface, p_lamp_trs_m)
    grey = 0.32 + 0.62 * lit
    base_z = float(nodes[..., 2].min()) - _SKIRT_M
    skirt = np.concatenate(
        [_skirt(edge, base_z) for edge in (nodes[0], nodes[-1], nodes[:, 0], nodes[:, -1])]
    )
    brightness = np.concatenate([grey, np.full(len(skirt), 0.55)])
    return Faces(
        points_trs_m=np.concatenate([surface, skirt]),
        colours=np.column_stack([brightness, brightness, brightness, np.ones_like(brightness)]),
        line_width=0.3,
    )


def capsule(
    p0_trs_m: FloatArray, p1_trs_m: FloatArray, radius_m: float, *, colour: str, opacity: float = 1
) -> Faces:
    """Give a cylinder with round ends."""
    along = p1_trs_m - p0_trs_m
    length = float(np.linalg.norm(along))
    axis = along / length if length > 0 else np.array([0.0, 0.0, 1.0])
    sideways = np.linalg.svd(axis[None])[2][1:]
    around = np.linspace(0.0, 2 * np.pi, _AROUND + 1)
    circle = np.cos(around)[:, None] * sideways[0] + np.sin(around)[:, None] * sideways[1]
    n_cuts = 1 + int(length / _LONGEST_FACE_M)
    latitudes = np.linspace(0.0, np.pi / 2, _CAP_RINGS)
    rings = [
        *((p0_trs_m, -latitude) for latitude in latitudes[::-1]),
        *((p0_trs_m + i / n_cuts * along, 0.0) for i in range(1, n_cuts)),
        *((p1_trs_m, latitude) for latitude in latitudes),
    ]
    nodes = np.array(
        [
            centre + radius_m * (np.cos(latitude) * circle + np.sin(latitude) * axis)
            for centre, latitude in rings
        ]
    )
    return _solid(_grid_faces(nodes), colour=colour, opacity=opacity)


def box(corners_trs_m: FloatArray, *, colour: str, opacity: float = 1) -> tuple[Faces, Faces]:
    """Give the faces and the edges of a box.

    Args:
        corners_trs_m: Shape (8, 3), low and high in the order of ``itertools.product``.
        colour: Of the faces; the edges are darker.
        opacity: Of both.
    """
    faces = np.concatenate([_tiles(corners_trs_m[list(face)]) for face in _BOX_FACES])
    edges = np.concatenate(
        [
            _cut(corners_trs_m[i], corners_trs_m[j])
            for i, j in combinations(range(8), 2)
            if (i ^ j).bit_count() == 1
        ]
    )
    colours = np.tile([*(0.6 * np.array(to_rgb(colour))), opacity], (len(edges), 1))
    return (
        _solid(faces, colour=colour, opacity=opacity, line_width=0.0),
        Faces(edges, colours, line_width=0.5),
    )


def box_corners(low_m: Sequence[float], high_m: Sequence[float]) -> FloatArray:
    """Give the corners of a box along the axes, shape (8, 3), as ``box`` wants them."""
    return np.array(list(product(*zip(low_m, high_m, strict=True))), dtype=np.float64)


def line(points_trs_m: FloatArray, *, colour: str, width: float = 0.8, opacity: float = 1) -> Faces:
    """Give a line through points, shape (n, 3), n at least 2, in short pieces."""
    pieces = [_cut(start, end) for start, end in pairwise(points_trs_m)]
    points = np.concatenate(pieces)
    colours = np.tile([*to_rgb(colour), opacity], (len(points), 1))
    return Faces(points, colours, line_width=width)


def sheet(corners_trs_m: FloatArray, *, colour: str, opacity: float = 1) -> Faces:
    """Give one flat face, shape (corners, 3)."""
    return Faces(corners_trs_m[None], np.array([[*to_rgb(colour), opacity]]), line_width=1.0)


def _tiles(corners: FloatArray) -> FloatArray:
    """Cut a rectangle, corners in a round, into small ones."""
    start, along, aside = corners[0], corners[1] - corners[0], corners[3] - corners[0]
    n, m = (2 + int(np.linalg.norm(side) / _LONGEST_FACE_M) for side in (along, aside))
    i, j = np.linspace(0.0, 1.0, n), np.linspace(0.0, 1.0, m)
    return _grid_faces(start + i[:, None, None] * along + j[None, :, None] * aside)


def _solid(points: FloatArray, *, colour: str, opacity: float, line_width: float = 0.15) -> Faces:
    """Shade faces by their direction, as if lit from above and aside."""
    normal = _normals(points)
    light = np.array([-0.70, 0.35, 0.62])
    shade = _AMBIENT + (1 - _AMBIENT) * np.abs(normal @ light)
    colours = np.column_stack([np.outer(shade, to_rgb(colour)), np.full(len(points), opacity)])
    return Faces(points, np.clip(colours, 0.0, 1.0), line_width=line_width)


def _terrain_nodes(heightmap: HeightMap) -> FloatArray:
    rows, columns = heightmap.height_m.shape
    step = max(1, -(-max(rows, columns) // _TERRAIN_NODES))
    at_row, at_column = _thinned(rows, step), _thinned(columns, step)
    i, j = np.meshgrid(at_row, at_column, indexing="ij")
    places = np.stack(
        [i * heightmap.spacing_m, j * heightmap.spacing_m, heightmap.height_m[i, j]], axis=-1
    )
    return places.astype(np.float64) + heightmap.origin_trs_m


def _thinned(n: int, step: int) -> NDArray[np.intp]:
    """Give every step-th index, and the last."""
    return np.unique(np.append(np.arange(0, n, step), n - 1))


def _grid_faces(nodes: FloatArray) -> FloatArray:
    """Give the quadrilaterals of a grid of nodes, shape (rows, columns, 3)."""
    corners = (nodes[:-1, :-1], nodes[1:, :-1], nodes[1:, 1:], nodes[:-1, 1:])
    return np.stack(corners, axis=2).reshape(-1, 4, 3)


def _skirt(edge: FloatArray, base_z_m: float) -> FloatArray:
    """Give the faces from the border of the surface down to the base."""
    below = edge.copy()
    below[:, 2] = base_z_m
    return _grid_faces(np.stack([edge, below]))


def _lambert(faces: FloatArray, p_lamp_trs_m: FloatArray) -> FloatArray:
    normal = _normals(faces)
    normal *= np.where(normal[:, 2:] < 0, -1.0, 1.0)
    to_lamp = p_lamp_trs_m - faces.mean(axis=1)
    to_lamp /= np.linalg.norm(to_lamp, axis=1, keepdims=True)
    return np.clip(np.einsum("ni,ni->n", normal, to_lamp), 0.0, 1.0)


def _normals(faces: FloatArray) -> FloatArray:
    normal = np.cross(faces[:, 2] - faces[:, 0], faces[:, 3] - faces[:, 1])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return normal / np.where(length > 0, length, 1.0)


def _cut(start: FloatArray, end: FloatArray) -> FloatArray:
    n = 1 + int(np.linalg.norm(end - start) / _LONGEST_FACE_M)
    nodes = start + np.linspace(0.0, 1.0, n + 1)[:, None] * (end - start)
    return np.stack([nodes[:-1], nodes[1:]], axis=1)
