# pyright: basic
"""The surface as the kernels see it: its triangles, normals and albedo, and the cone of the lamp.

In each cell of four nodes there are two triangles that share the edge from node (i, j) to node
(i + 1, j + 1): the upper one at c - j >= r - i. Rays meet the triangles; light is reflected as if
the surface were smooth.

Places are in grid coordinates: r and c count cells along the rows' and the columns' axis.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tronlab.render.renderer import SpotCone
from tronlab.terrain.kernels import inlined

NO_ALBEDO: NDArray[np.uint16] = np.empty((0, 0), dtype=np.uint16)
"""Stands for an albedo of 1 everywhere."""


class Cone(NamedTuple):
    """The cone of a lamp as the kernels see it."""

    axis: tuple[float, float, float]
    """Unit vector along the beam, frame trs."""
    cos_outer: float
    per_width: float
    """1 / (cos_inner - cos_outer)."""


def cone_numbers(cone: SpotCone | None) -> Cone:
    """Give a cone as the kernels see it; None: a lamp that shines in all directions."""
    if cone is None:
        return Cone((0.0, 0.0, 1.0), -3.0, 1.0)
    x, y, z = (float(v) for v in cone.axis_trs)
    cos_inner, cos_outer = np.cos([cone.inner_half_angle_rad, cone.outer_half_angle_rad])
    return Cone((x, y, z), float(cos_outer), 1.0 / max(float(cos_inner - cos_outer), 1e-12))


@inlined
def cone_factor(cone, to_lamp_x, to_lamp_y, to_lamp_z):
    """Give the part of the lamp's intensity that its cone lets through to a place.

    It is 1 within the inner half angle and falls to 0 at the outer one as a smooth step in the
    cosine.

    Args:
        cone: A ``Cone``.
        to_lamp_x: Unit vector from the place to the lamp, frame trs.
        to_lamp_y: Its y.
        to_lamp_z: Its z.
    """
    cos_off = -(cone.axis[0] * to_lamp_x + cone.axis[1] * to_lamp_y + cone.axis[2] * to_lamp_z)
    step = min(max((cos_off - cone.cos_outer) * cone.per_width, 0.0), 1.0)
    return step * step * (3.0 - 2.0 * step)


@inlined
def albedo_at(albedo, r, c):
    """Give the albedo, 0 to 1, interpolated bilinearly between the samples."""
    if albedo.shape[0] == 0:
        return 1.0
    i = min(max(int(r), 0), albedo.shape[0] - 2)
    j = min(max(int(c), 0), albedo.shape[1] - 2)
    a, b = r - i, c - j
    value = (1.0 - a) * _along_c(albedo, i, j, b) + a * _along_c(albedo, i + 1, j, b)
    return value * (1.0 / 65535.0)


@inlined
def triangle(height, i, j, is_upper):
    """Give height at node (i, j) and the rise a cell along r and c, on one of the triangles."""
    z00 = float(height[i, j])
    z11 = float(height[i + 1, j + 1])
    if is_upper:
        z01 = float(height[i, j + 1])
        return z00, z11 - z01, z01 - z00
    z10 = float(height[i + 1, j])
    return z00, z10 - z00, z11 - z10


@inlined
def height_at(grid, r, c):
    """Give the height of the surface at a place."""
    i = min(max(int(r), 0), grid.height_m.shape[0] - 2)
    j = min(max(int(c), 0), grid.height_m.shape[1] - 2)
    height, rise_r, rise_c = triangle(grid.height_m, i, j, c - j >= r - i)
    return height + rise_r * (r - i) + rise_c * (c - j)


@inlined
def facet_normal(grid, r, c):
    """Give the unit normal of the triangle at a place; components along x, y and z of trs."""
    i = min(max(int(r), 0), grid.height_m.shape[0] - 2)
    j = min(max(int(c), 0), grid.height_m.shape[1] - 2)
    _, slope_r, slope_c = triangle(grid.height_m, i, j, c - j >= r - i)
    return _unit_normal(slope_r / grid.spacing_m, slope_c / grid.spacing_m)


@inlined
def smooth_normal(grid, r, c):
    """Give the unit normal from the slopes at the four nodes around, interpolated bilinearly.

    The slope at a node is that of a central step, at the border of a one-sided one.
    """
    height = grid.height_m
    i = min(max(int(r), 0), height.shape[0] - 2)
    j = min(max(int(c), 0), height.shape[1] - 2)
    a = r - i
    b = c - j
    up, down = max(i - 1, 0), min(i + 2, height.shape[0] - 1)
    left, right = max(j - 1, 0), min(j + 2, height.shape[1] - 1)
    # Differences of interpolated heights are the interpolated differences, with half the reading.
    rise_0 = _along_c(height, i + 1, j, b) - _along_c(height, up, j, b)
    rise_1 = _along_c(height, down, j, b) - _along_c(height, i, j, b)
    slope_r = (1.0 - a) * rise_0 / (i + 1 - up) + a * rise_1 / (down - i)
    rise_0 = _along_r(height, i, j + 1, a) - _along_r(height, i, left, a)
    rise_1 = _along_r(height, i, right, a) - _along_r(height, i, j, a)
    slope_c = (1.0 - b) * rise_0 / (j + 1 - left) + b * rise_1 / (right - j)
    return _unit_normal(slope_r / grid.spacing_m, slope_c / grid.spacing_m)


@inlined
def _along_c(values, i, j, b):
    return (1.0 - b) * float(values[i, j]) + b * float(values[i, j + 1])


@inlined
def _along_r(values, i, j, a):
    return (1.0 - a) * float(values[i, j]) + a * float(values[i + 1, j])


@inlined
def _unit_normal(slope_r, slope_c):
    scale = 1.0 / np.sqrt(1.0 + slope_r * slope_r + slope_c * slope_c)
    return -slope_r * scale, -slope_c * scale, scale
