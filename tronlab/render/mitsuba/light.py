"""What the lamp does to the terrain, in Dr.Jit's arrays over the rays."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tronlab.render.mitsuba.backend import Backend
from tronlab.render.mitsuba.photometry import reflected
from tronlab.render.mitsuba.scene import Hits, TerrainScene
from tronlab.render.photometry import Photometry
from tronlab.render.renderer import Lamp, SpotCone

_N_LAMP_POINTS = 32
"""Points of a lamp's disk that are looked for: of what a straight edge leaves of the disk they tell
the share within 0.08, 0.02 in the root mean square."""
_SHADOW_OFFSET_M = 2e-5
"""Off the triangle along its normal. Mitsuba's own offset is of the size of a sample."""
_GOLDEN_ANGLE_RAD = math.pi * (3 - math.sqrt(5))


class Light(NamedTuple):
    """The lamp's light on what rays see; both are arrays over the rays."""

    radiance: Any
    """Towards the camera, 0 where nothing is seen."""
    is_lit: Any


def light_on(
    backend: Backend, terrain: TerrainScene, hits: Hits, lamp: Lamp, photometry: Photometry
) -> Light:
    """Give the lamp's light on the terrain.

    Args:
        backend: The modules.
        terrain: What may cast a shadow.
        hits: What the rays see.
        lamp: The lamp.
        photometry: How the surface reflects.
    """
    _, dr = backend
    centre = backend.point(lamp.p_trs_m - terrain.origin_trs_m)
    distance = dr.norm(centre - hits.p)
    to_lamp = (centre - hits.p) / distance
    mu0 = dr.dot(hits.normal, to_lamp)
    mu = dr.maximum(dr.dot(hits.normal, hits.to_eye), 0)
    # Half the phase angle from its tangent: single precision spoils the arc cosine near opposition.
    phase_rad = 2 * dr.atan2(dr.norm(to_lamp - hits.to_eye), dr.norm(to_lamp + hits.to_eye))
    faces = hits.is_seen & (mu0 > 0)
    offsets = _lamp_points(backend, to_lamp, lamp.radius_m)
    share = _mean_seen(backend, terrain, hits, faces, [centre + offset for offset in offsets])
    radiance = backend.number(lamp.intensity) * share * hits.albedo / dr.square(distance)
    radiance *= reflected(dr, photometry, mu0, mu, phase_rad)
    if lamp.cone is not None:
        radiance *= _through_cone(backend, lamp.cone, to_lamp)
    return Light(dr.select(faces, radiance, 0), faces & (share >= 0.5))


def _lamp_points(backend: Backend, to_lamp: Any, radius_m: float) -> list[Any]:
    """Give points, from the lamp's centre, of its disk turned to a place."""
    if radius_m == 0:
        return [backend.vector((0.0, 0.0, 0.0))]
    across, along = backend.mi.coordinate_system(to_lamp)
    points = _disk_points(_N_LAMP_POINTS) * radius_m
    return [backend.number(x) * across + backend.number(y) * along for x, y in points]


def _mean_seen(
    backend: Backend, terrain: TerrainScene, hits: Hits, where: Any, targets: list[Any]
) -> Any:
    """Give the share of the targets, each an array over the rays, that is seen from the hits."""
    mi, dr = backend
    start = hits.p + _SHADOW_OFFSET_M * hits.facet_normal
    n_seen = mi.Float(0)
    for target in targets:
        way = target - start
        is_above = where & (dr.dot(hits.facet_normal, way) > 0)
        # The way is the ray's direction, so the lamp is at its parameter 1.
        is_hidden = terrain.scene.ray_test(mi.Ray3f(start, way, 1.0, 0.0, []), is_above)
        n_seen += dr.select(is_above & ~is_hidden, 1, 0)
        dr.eval(n_seen)  # else one kernel would hold all the targets' rays
    return n_seen / len(targets)


def _disk_points(n: int) -> NDArray[np.float64]:
    """Spread points evenly over the unit disk, shape (n, 2) (Vogel, Math. Biosci. 44, 1979)."""
    k = np.arange(n)
    radius, angle_rad = np.sqrt((k + 0.5) / n), k * _GOLDEN_ANGLE_RAD
    return radius[:, None] * np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=-1)


def _through_cone(backend: Backend, cone: SpotCone, to_lamp: Any) -> Any:
    """Give what part of the lamp's intensity its cone lets through."""
    dr = backend.dr
    cos_off = -dr.dot(backend.vector(cone.axis_trs), to_lamp)
    inner, outer = math.cos(cone.inner_half_angle_rad), math.cos(cone.outer_half_angle_rad)
    if inner == outer:
        return dr.select(cos_off >= backend.number(outer), 1.0, 0.0)
    step = dr.clip((cos_off - outer) / (inner - outer), 0, 1)
    return dr.square(step) * (3 - 2 * step)
