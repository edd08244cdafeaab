"""Images without lens distortion, for formats that know nothing but a camera matrix."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tronlab.geometry.camera import CameraModel, distortion_jacobian
from tronlab.geometry.poses import FloatArray

_OUTSIDE = -1.0e4
"""A pixel coordinate far beside every image."""


class Rectification:
    """Resamples images of a camera to what a pinhole of the same matrix would see."""

    def __init__(self, camera: CameraModel) -> None:
        self._uv = _source_uv(camera) if any(camera.distortion) else None

    def image(self, image: NDArray[Any]) -> NDArray[Any]:
        """Resample grey values, bilinear; 0 where the camera saw nothing. No distortion: as is."""
        return self._resampled(image, cv2.INTER_LINEAR)

    def mask(self, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Resample a mask by the nearest pixel; false where the camera saw nothing."""
        return self._resampled(mask.astype(np.uint8), cv2.INTER_NEAREST) > 0

    def _resampled(self, image: NDArray[Any], interpolation: int) -> NDArray[Any]:
        if self._uv is None:
            return image
        u, v = self._uv
        return cv2.remap(image, u, v, interpolation, borderMode=cv2.BORDER_CONSTANT, borderValue=0)


def _source_uv(camera: CameraModel) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Give where in the camera's image each pixel of the pinhole's lies."""
    u, v = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
    x, y = (u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px
    rays: FloatArray = np.stack([x, y], axis=-1, dtype=np.float64)
    uv = camera.pixels(rays)
    # Beyond the fold of the distortion polynomial the image would come back a second time.
    uv[np.linalg.det(distortion_jacobian(rays, camera.distortion)) <= 0] = _OUTSIDE
    return uv[..., 0].astype(np.float32), uv[..., 1].astype(np.float32)
