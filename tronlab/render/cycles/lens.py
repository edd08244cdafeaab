"""From images of a camera without distortion to those of the camera asked for.

Cycles has no camera with our distortion: it renders a pinhole image of a somewhat wider view in
finer pixels, and what each ray of the camera sees is looked up there.
"""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray
from tronlab.render.rays import centre_rays, subpixel_rays
from tronlab.render.renderer import RenderError

OVERSAMPLING = 2.0
"""So many pixels of the pinhole image lie along one of the camera's, or more."""
LARGEST_PX = 1 << 25
"""Pixels of a pinhole image, at most: about 3 GB while they are worked on."""
_MARGIN_PX = 2
_GRAZING_COSINE = 0.02


class Lens:
    """Makes images of a camera from those of its pinhole; without distortion they are the same."""

    def __init__(self, camera: CameraModel) -> None:
        self.camera = camera
        """The camera asked for."""
        self.pinhole = pinhole_of(camera)
        """The camera that Cycles has for it."""

    @property
    def n_pixels(self) -> float:
        """Get how many pixels of the pinhole image one of the camera's covers in its middle."""
        camera, pinhole = self.camera, self.pinhole
        return pinhole.fx_px * pinhole.fy_px / (camera.fx_px * camera.fy_px)

    def radiance(self, radiance: NDArray[np.float32], *, over_area: bool) -> NDArray[np.float32]:
        """Interpolate radiance at the centres of the camera's pixels, or its mean over each."""
        if self.pinhole is self.camera:
            return radiance
        lookups = self._over_area if over_area else [self._centre]
        return np.mean([lookup.interpolated(radiance) for lookup in lookups], axis=0)

    def depth_m(
        self, depth_m: NDArray[np.float32], normal_cam: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Give the depth at the centres of the camera's pixels; see ``Lookup.depth_m``."""
        if self.pinhole is self.camera:
            return depth_m
        return self._centre.depth_m(depth_m, normal_cam)

    def mostly(self, values: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Tell what is true of the greater part around the centres of the camera's pixels."""
        if self.pinhole is self.camera:
            return values
        return self._centre.interpolated(values.astype(np.float32)) > 0.5

    @cached_property
    def _centre(self) -> "Lookup":
        return Lookup(self.pinhole, centre_rays(self.camera))

    @cached_property
    def _over_area(self) -> "list[Lookup]":
        return [Lookup(self.pinhole, rays) for rays in subpixel_rays(self.camera)]


def pinhole_of(camera: CameraModel) -> CameraModel:
    """Give a camera without distortion that sees all of a camera's view, finer everywhere.

    A camera without distortion is given back as it is.

    Raises:
        RenderError: That takes too many pixels.
    """
    if not any(camera.distortion):
        return camera
    rays = centre_rays(camera)
    steps = (np.diff(rays[..., 0], axis=1), np.diff(rays[..., 1], axis=0))
    focal_px = OVERSAMPLING / min(float(step.min()) for step in steps if step.size)
    border = subpixel_rays(camera).reshape(-1, 2)
    left, top = np.floor(border.min(axis=0) * focal_px) - _MARGIN_PX
    right, bottom = np.ceil(border.max(axis=0) * focal_px) + _MARGIN_PX
    width_px, height_px = int(right - left) + 1, int(bottom - top) + 1
    if width_px * height_px > LARGEST_PX:
        raise RenderError(
            f"renderer cycles: a camera of {camera.width_px} x {camera.height_px} pixels with"
            f" distortion {camera.distortion} takes an undistorted image of {width_px} x"
            f" {height_px} pixels, {LARGEST_PX:,} pixels are allowed\ntake fewer pixels, or"
            " renderer heightfield, reference or mitsuba, which bend the rays themselves"
        )
    return CameraModel(width_px, height_px, focal_px, focal_px, -float(left), -float(top))


class Lookup:
    """Where rays, shape (rows, columns, 2), meet a pinhole image."""

    def __init__(self, pinhole: CameraModel, rays: FloatArray) -> None:
        uv = pinhole.pixels(rays)
        last = [pinhole.width_px - 2, pinhole.height_px - 2]
        corner = np.floor(uv).astype(np.intp).clip(0, last)
        self._pinhole = pinhole
        self._rays = rays
        self._column, self._row = np.moveaxis(corner, -1, 0)
        self._right, self._down = np.moveaxis((uv - corner).astype(np.float32), -1, 0)

    def interpolated(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Interpolate values, one a pixel of the pinhole image, bilinearly."""
        i, j, a, b = self._row, self._column, self._down, self._right
        above = (1 - b) * values[i, j] + b * values[i, j + 1]
        below = (1 - b) * values[i + 1, j] + b * values[i + 1, j + 1]
        return (1 - a) * above + a * below

    def depth_m(
        self, depth_m: NDArray[np.float32], normal_cam: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Give the depth that each ray sees, from depths and facets at the pixels' centres.

        The ray is met with the plane of the triangle that the nearest pixel shows, so that depths
        on either side of a silhouette are not mixed: exact where the ray meets that triangle,
        otherwise off by what the terrain bends within half a pixel of the pinhole image. A plane
        nearly along the ray tells nothing: there the nearest pixel's depth stands as it is.

        Args:
            depth_m: Shape (rows, columns) of the pinhole image.
            normal_cam: Unit normals of the triangles in cam, shape (rows, columns, 3).
        """
        v, u = self._row + (self._down >= 0.5), self._column + (self._right >= 0.5)
        normal = normal_cam[v, u]
        towards_pixel = _along(normal, self._pinhole.rays(np.stack([u, v], axis=-1)))
        towards_ray = _along(normal, self._rays)
        tells = np.minimum(np.abs(towards_pixel), np.abs(towards_ray)) > _GRAZING_COSINE
        ratio = np.divide(towards_pixel, towards_ray, out=np.ones_like(towards_ray), where=tells)
        return (depth_m[v, u] * ratio).astype(np.float32)


def _along(normal_cam: NDArray[np.float32], rays: FloatArray) -> FloatArray:
    """Give the product of normals (..., 3) with rays (..., 2), directions of depth 1."""
    x, y, z = np.moveaxis(normal_cam.astype(np.float64), -1, 0)
    return x * rays[..., 0] + y * rays[..., 1] + z
