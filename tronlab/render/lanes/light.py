# pyright: basic
# ruff: noqa: PLR0917 - kernels work on plain numbers
"""The light that the points which a tile's rays have met send to the camera.

As in ``lanes`` one loop reads at scattered places and others calculate. What ``lanes`` needs no
more when all rays have met the surface is overwritten.
"""

import numpy as np

from tronlab.render.lanes.lookup import look_up
from tronlab.render.lanes.rows import (
    COS_EMISSION,
    COS_INCIDENCE,
    COS_OFF_AXIS,
    COS_PHASE,
    DEPTH,
    EYE_X,
    EYE_Y,
    EYE_Z,
    IS_LIT,
    LAMP_X,
    LAMP_Y,
    LAMP_Z,
    LIGHT_SHARE,
    LIGHT_X,
    LIGHT_Y,
    LIGHT_Z,
    PER_DISTANCE,
    RADIANCE,
    START_C,
    START_R,
    START_Z,
    STATE,
    TOWARDS_C,
    TOWARDS_R,
    TOWARDS_Z,
    C,
    R,
    Z,
)
from tronlab.render.lanes.stepping import HIT
from tronlab.render.lighting import light_at
from tronlab.render.photometry_kernel import LAMBERT, reflected
from tronlab.render.surface import albedo_at, cone_factor, height_at
from tronlab.terrain.kernels import kernel

_ZERO, _ONE = np.float32(0), np.float32(1)
_LEAST_SHARE = np.float32(1e-6)


@kernel
def light_lanes(
    grid, view, light, lamp_map, shadow_rays, frame, footprint, n_centres, n, floats, ints
):
    """Fill in RADIANCE, and IS_LIT of the rays through pixel centres.

    Args:
        grid: The surface.
        view: The camera.
        light: A ``Light``.
        lamp_map: A ``MapView``; None with shadow_rays.
        shadow_rays: True: shadows are found by rays; None: in the map.
        frame: Where the lanes count from.
        footprint: Of a pixel; of no width: the light at the point is taken.
        n_centres: So many lanes come first whose rays go through pixel centres. If there are
            others, these others' radiance counts.
        n: The number of lanes.
        floats: Rows of floats.
        ints: Rows of integers.
    """
    _look_about(grid, light, frame, n, floats)
    # Where one of the two is None numba leaves its branch out before compiling what it calls.
    if shadow_rays is not None:
        _follow_shadow_rays(grid, light, frame, n, floats, ints)
    if lamp_map is not None:
        look_up(grid, light, lamp_map, frame, footprint, n_centres, n, floats, ints)
        _reflect(light, n, floats)
        if light.cone.cos_outer >= -1.0:
            _narrow(light.cone, n, floats)
        if light.ambient > 0.0:
            _add_ambient(light, frame, n, floats, ints)
    if view.vignetting_power > 0.0:
        _darken_off_axis(view.vignetting_power, n, floats)


@kernel
def _look_about(grid, light, frame, n, floats):
    """Replace the rays by the points they have met, and find the directions to lamp and eye."""
    spacing = np.float32(grid.spacing_m)
    lamp_r = np.float32(light.lamp[0] - frame.row)
    lamp_c = np.float32(light.lamp[1] - frame.column)
    lamp_z = np.float32(light.lamp[2])
    for k in range(n):
        t = floats[DEPTH + k]
        dr, dc, dz = floats[TOWARDS_R + k], floats[TOWARDS_C + k], floats[TOWARDS_Z + k]
        r, c = floats[START_R + k] + t * dr, floats[START_C + k] + t * dc
        z = floats[START_Z + k] + t * dz
        floats[R + k], floats[C + k], floats[Z + k] = r, c, z
        x, y, z = (lamp_r - r) * spacing, (lamp_c - c) * spacing, lamp_z - z
        per_distance = _ONE / np.sqrt(x * x + y * y + z * z)
        floats[LAMP_X + k] = x * per_distance
        floats[LAMP_Y + k] = y * per_distance
        floats[LAMP_Z + k] = z * per_distance
        floats[PER_DISTANCE + k] = per_distance
        x, y = dr * spacing, dc * spacing
        per_distance = _ONE / np.sqrt(x * x + y * y + dz * dz)
        floats[EYE_X + k] = -x * per_distance
        floats[EYE_Y + k] = -y * per_distance
        floats[EYE_Z + k] = -dz * per_distance
        # The direction has depth 1.
        floats[COS_OFF_AXIS + k] = per_distance


@kernel
def _follow_shadow_rays(grid, light, frame, n, floats, ints):
    for k in range(n):
        floats[RADIANCE + k] = _ZERO
        ints[IS_LIT + k] = 0
        if ints[STATE + k] == HIT:
            r, c = float(floats[R + k]) + frame.row, float(floats[C + k]) + frame.column
            to_eye = float(floats[EYE_X + k]), float(floats[EYE_Y + k]), float(floats[EYE_Z + k])
            # 32 bits hold the height to a micrometre: not enough for a ray that starts there.
            radiance, is_lit = light_at(grid, light, r, c, height_at(grid, r, c), to_eye)
            floats[RADIANCE + k] = radiance
            ints[IS_LIT + k] = is_lit


@kernel
def _reflect(light, n, floats):
    """Turn the light that falls on the lanes into radiance."""
    intensity = np.float32(light.intensity)
    for k in range(n):
        share = floats[LIGHT_SHARE + k]
        per_share = _ONE / share if share > _LEAST_SHARE else _ZERO
        x, y, z = floats[LIGHT_X + k], floats[LIGHT_Y + k], floats[LIGHT_Z + k]
        lamp_x, lamp_y, lamp_z = floats[LAMP_X + k], floats[LAMP_Y + k], floats[LAMP_Z + k]
        eye_x, eye_y, eye_z = floats[EYE_X + k], floats[EYE_Y + k], floats[EYE_Z + k]
        cos_incidence = (x * lamp_x + y * lamp_y + z * lamp_z) * per_share
        cos_emission = (x * eye_x + y * eye_y + z * eye_z) * per_share
        floats[COS_INCIDENCE + k] = cos_incidence if cos_incidence > _ZERO else _ZERO
        floats[COS_EMISSION + k] = cos_emission if cos_emission > _ZERO else _ZERO
        floats[COS_PHASE + k] = lamp_x * eye_x + lamp_y * eye_y + lamp_z * eye_z
        per_distance = floats[PER_DISTANCE + k]
        floats[RADIANCE + k] = intensity * share * per_distance * per_distance
    if light.photometry.kind == LAMBERT:
        for k in range(n):
            floats[RADIANCE + k] *= floats[COS_INCIDENCE + k]
    else:
        for k in range(n):
            if floats[COS_INCIDENCE + k] > _ZERO:
                floats[RADIANCE + k] *= np.float32(
                    reflected(
                        light.photometry,
                        float(floats[COS_INCIDENCE + k]),
                        float(floats[COS_EMISSION + k]),
                        float(floats[COS_PHASE + k]),
                    )
                )
            else:
                floats[RADIANCE + k] = _ZERO


@kernel
def _narrow(cone, n, floats):
    """Take away what the lamp's cone does not let through."""
    for k in range(n):
        x, y, z = floats[LAMP_X + k], floats[LAMP_Y + k], floats[LAMP_Z + k]
        floats[RADIANCE + k] *= np.float32(cone_factor(cone, x, y, z))


@kernel
def _add_ambient(light, frame, n, floats, ints):
    for k in range(n):
        if ints[STATE + k] == HIT:
            r, c = float(floats[R + k]) + frame.row, float(floats[C + k]) + frame.column
            floats[RADIANCE + k] += np.float32(light.ambient * albedo_at(light.albedo, r, c))


@kernel
def _darken_off_axis(power, n, floats):
    for k in range(n):
        floats[RADIANCE + k] *= floats[COS_OFF_AXIS + k] ** np.float32(power)
