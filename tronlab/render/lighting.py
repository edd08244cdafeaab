# pyright: basic
# ruff: noqa: PLR0917 - kernels work on plain numbers
"""The light that a point of the surface sends to the eye, with a ray to the lamp for its shadow.

Places are in grid coordinates, directions along x, y and z of trs in metres.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tronlab.render.photometry_kernel import PhotometryNumbers, reflected
from tronlab.render.raycast import MISSED, first_hit
from tronlab.render.shadow_reach import shadow_reach
from tronlab.render.surface import Cone, albedo_at, cone_factor, facet_normal, smooth_normal
from tronlab.terrain.kernels import inlined

SHADOW_OFFSET_M = 1e-7
"""Light is looked for from this far above the surface, along the normal: well over what rounding
leaves of a place on it, and far below what can be seen."""
_SHADOW_LEVEL = np.int64(1)
_GOLDEN_ANGLE_RAD = np.pi * (3.0 - np.sqrt(5.0))
_N_DISK_POINTS = 128


class Light(NamedTuple):
    """A lamp in grid coordinates, and how the surface reflects its light."""

    lamp: NDArray[np.float64]
    """Centre, shape (3,)."""
    intensity: float
    ambient: float
    """Radiance that a surface of albedo 1 has without the lamp."""
    cone: Cone
    disk_m: NDArray[np.float64]
    """Points of the lamp seen as a disk, from its centre, shape (n, 2)."""
    shadow_reaches: NDArray[np.float32]
    """See ``shadow_reach``; for a lamp that is not a point of shape (0, 0)."""
    photometry: PhotometryNumbers
    albedo: NDArray[np.uint16]
    """Shape as the heights; of shape (0, 0): 1 everywhere."""


def disk_points(radius_m: float) -> NDArray[np.float64]:
    """Give points that stand for equal parts of a disk, shape (n, 2); one for a radius of 0.

    They lie on Vogel's spiral (Mathematical Biosciences 44 (1979), 179). Where a straight edge
    hides a part of the disk, the share of the 128 points that it hides is that part within 0.037,
    and within 0.0073 in the mean square over all edges.
    """
    if radius_m == 0:
        return np.zeros((1, 2))
    k = np.arange(_N_DISK_POINTS)
    angle = k * _GOLDEN_ANGLE_RAD
    distance = radius_m * np.sqrt((k + 0.5) / _N_DISK_POINTS)
    return np.stack([distance * np.cos(angle), distance * np.sin(angle)], axis=-1)


@inlined
def light_at(grid, light, r, c, z, to_eye):
    """Give the radiance of a point of the surface, and whether the lamp lights it.

    Args:
        grid: The surface.
        light: A ``Light``.
        r: The point.
        c: The point.
        z: The point.
        to_eye: Unit vector towards the eye.
    """
    albedo = albedo_at(light.albedo, r, c)
    radiance = light.ambient * albedo
    to_lamp, distance = _to_lamp(grid, light, r, c, z)
    normal = smooth_normal(grid, r, c)
    cos_incidence = _dot(normal, to_lamp)
    if not cos_incidence > 0.0:
        return radiance, False
    share = visible_share(grid, light, r, c, z, to_lamp)
    if share > 0.0:
        beam = light.intensity * cone_factor(light.cone, *to_lamp) * share / distance**2
        cos_emission = max(_dot(normal, to_eye), 0.0)
        cos_phase = _dot(to_lamp, to_eye)
        factor = reflected(light.photometry, cos_incidence, cos_emission, cos_phase)
        radiance += beam * albedo * factor
    return radiance, share >= 0.5


@inlined
def _to_lamp(grid, light, r, c, z):
    """Give the unit vector towards the lamp's centre, and the distance."""
    x = (light.lamp[0] - r) * grid.spacing_m
    y = (light.lamp[1] - c) * grid.spacing_m
    z = light.lamp[2] - z
    distance = np.sqrt(x * x + y * y + z * z)
    return (x / distance, y / distance, z / distance), distance


@inlined
def visible_share(grid, light, r, c, z, to_lamp):
    """Give the part of the lamp that is seen from just above the triangle a point lies on.

    The lamp is taken as the disk about its centre that faces the point.
    """
    normal = facet_normal(grid, r, c)
    r += normal[0] * SHADOW_OFFSET_M / grid.spacing_m
    c += normal[1] * SHADOW_OFFSET_M / grid.spacing_m
    z += normal[2] * SHADOW_OFFSET_M
    right, up = _across(to_lamp)
    reach = 1.0
    if light.shadow_reaches.shape[0] > 0:
        reach = shadow_reach(grid, light.lamp, light.shadow_reaches, r, c)
    n_seen = 0
    for k in range(light.disk_m.shape[0]):
        a, b = light.disk_m[k, 0], light.disk_m[k, 1]
        dr = light.lamp[0] - r + (a * right[0] + b * up[0]) / grid.spacing_m
        dc = light.lamp[1] - c + (a * right[1] + b * up[1]) / grid.spacing_m
        dz = light.lamp[2] - z + a * right[2] + b * up[2]
        along = (dr * grid.spacing_m, dc * grid.spacing_m, dz)
        if _dot(normal, along) > 0.0:
            n_seen += first_hit(grid, r, c, z, dr, dc, dz, reach, _SHADOW_LEVEL) == MISSED
    return n_seen / light.disk_m.shape[0]


@inlined
def _across(direction):
    """Give two unit vectors at right angles to a unit vector and to each other.

    Duff et al., Building an Orthonormal Basis, Revisited, Journal of Computer Graphics Techniques 6
    (2017).
    """
    x, y, z = direction
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    return (1.0 + sign * x * x * a, sign * b, -sign * x), (b, sign + y * y * a, -y)


@inlined
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
