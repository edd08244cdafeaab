"""Means over square patches of an image: what is left when noise and small shifts are averaged."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tronlab.calib.inputs import PatchesInput
from tronlab.geometry.poses import FloatArray

MOST_PATCHES = 150
"""Of one image: neighbouring ones say much the same."""
_MOST_SATURATED = 1e-3
"""Part of a patch that may be at full scale, as a hot pixel is."""
_SMALLEST_PX = 8
_PATCHES_ALONG_ROW = 32
_GREY_DECIMALS = 6
_DIGITS = 6


@dataclass(frozen=True, slots=True)
class RenderedView:
    """What renderings from the pose of an image have in each pixel, shape (rows, columns)."""

    lambert: NDArray[np.float32]
    """Radiance of a white Lambert surface; the lamp has the intensity 1."""
    lommel_seeliger: NDArray[np.float32]
    phase_rad: FloatArray
    """Phase angle at the pixel centre; NaN where no terrain is seen."""
    cos_axis: FloatArray
    """Cosine of the angle between ray and optical axis."""


def patch_size_px(width_px: int) -> int:
    """Give the side of patches: a fixed part of the image's width, if that is enough pixels."""
    return max(_SMALLEST_PX, width_px // _PATCHES_ALONG_ROW)


def patches_of(
    image: NDArray[np.unsignedinteger],
    mask: NDArray[np.bool_],
    view: RenderedView,
    *,
    full_scale: int,
    patch_px: int,
    shot_id: int,
    exposure_s: float,
    gain_db: float,
) -> PatchesInput:
    """Give the patches that lie wholly on the model and are not saturated, at most so many.

    Args:
        image: Grey values, shape (rows, columns).
        mask: Where the model is seen, same shape.
        view: Renderings from the same pose.
        full_scale: Highest grey value.
        patch_px: Side of a patch.
        shot_id: Number of the shot; it and what follows is kept with the patches.
        exposure_s: Exposure time.
        gain_db: Gain.
    """
    is_model = _means(mask & np.isfinite(view.phase_rad), patch_px) == 1.0
    is_saturated = _means(image >= full_scale, patch_px) > _MOST_SATURATED
    chosen = _spread(np.flatnonzero(is_model & ~is_saturated))

    def column(values: NDArray[np.generic]) -> FloatArray:
        return _means(values, patch_px).ravel()[chosen]

    # A converter gives the grey value g to light between g and g + 1.
    grey = (column(image) + 0.5) / (full_scale + 1)
    return PatchesInput(
        shot_id=shot_id,
        exposure_s=exposure_s,
        gain_db=gain_db,
        grey=tuple(np.round(grey, _GREY_DECIMALS).tolist()),
        cos_axis=_rounded(column(view.cos_axis)),
        lambert=_rounded(column(view.lambert)),
        lommel_seeliger=_rounded(column(view.lommel_seeliger)),
        phase_deg=tuple(np.round(np.degrees(column(view.phase_rad)), 3).tolist()),
    )


def phase_angles(
    points_m: NDArray[np.floating], p_lamp_m: FloatArray, p_camera_m: FloatArray
) -> FloatArray:
    """Give the angle at each point between the directions to lamp and camera, radians.

    Args:
        points_m: Shape (..., 3); NaN gives NaN.
        p_lamp_m: Shape (3,), in the same frame; likewise the camera.
        p_camera_m: Shape (3,).
    """
    to_lamp, to_camera = p_lamp_m - points_m, p_camera_m - points_m
    along = np.einsum("...i,...i->...", to_lamp, to_camera)
    across = np.linalg.norm(np.cross(to_lamp, to_camera), axis=-1)
    return np.arctan2(across, along)


def _means(values: NDArray[np.generic], size_px: int) -> FloatArray:
    """Give the means over squares, shape (rows // size, columns // size); what is left over is."""
    rows, columns = (n // size_px for n in values.shape)
    whole = values[: rows * size_px, : columns * size_px].astype(np.float64)
    return whole.reshape(rows, size_px, columns, size_px).mean(axis=(1, 3))


def _spread(numbers: NDArray[np.intp]) -> NDArray[np.intp]:
    """Give at most ``MOST_PATCHES`` of them, evenly spread."""
    if len(numbers) <= MOST_PATCHES:
        return numbers
    return numbers[np.linspace(0, len(numbers) - 1, MOST_PATCHES).round().astype(np.intp)]


def _rounded(values: FloatArray) -> tuple[float, ...]:
    return tuple(float(f"{value:.{_DIGITS}g}") for value in values)
