"""The pinhole camera with Brown-Conrady or rational distortion.

Pixel coordinates ``uv`` have their origin at the centre of the top-left pixel; u grows to the
right, v down. A ray is given by its normalised image coordinates (x, y): the direction (x, y, 1) in
cam, so that its parameter is the depth along the optical axis.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tronlab.errors import CalibrationError
from tronlab.geometry.poses import FloatArray

DISTORTION_NAMES = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
N_DISTORTION = len(DISTORTION_NAMES)
_NEWTON_STEPS = 20
_NEWTON_TOLERANCE = 1e-12


@dataclass(frozen=True, slots=True)
class CameraModel:
    """Intrinsics of a camera, in pixels of the image it delivers."""

    width_px: int
    """Number of columns."""
    height_px: int
    """Number of rows."""
    fx_px: float
    """Focal length along u."""
    fy_px: float
    """Focal length along v."""
    cx_px: float
    """Principal point, u."""
    cy_px: float
    """Principal point, v."""
    distortion: tuple[float, ...] = ()
    """k1, k2, p1, p2, k3, k4, k5, k6 in OpenCV's order (Brown, Photogrammetric Engineering 32,
    1966; k4 to k6 divide). Coefficients left out at the end are 0; there are always eight."""

    def __post_init__(self) -> None:
        if len(self.distortion) > N_DISTORTION:
            raise CalibrationError(
                f"camera model: {len(self.distortion)} distortion coefficients, at most"
                f" {N_DISTORTION} are known: {', '.join(DISTORTION_NAMES)}"
            )
        padding = (0.0,) * (N_DISTORTION - len(self.distortion))
        object.__setattr__(self, "distortion", (*self.distortion, *padding))

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> "CameraModel":
        """Make a model from what ``to_dict`` gave.

        Raises:
            CalibrationError: A key is missing or unknown, or a value has the wrong form.
        """
        names = {field.name for field in fields(cls)}
        if set(values) != names:
            wrong = ", ".join(sorted(names.symmetric_difference(values)))
            raise CalibrationError(f"camera model: missing or unknown: {wrong}")
        try:
            return cls(
                width_px=int(values["width_px"]),
                height_px=int(values["height_px"]),
                fx_px=float(values["fx_px"]),
                fy_px=float(values["fy_px"]),
                cx_px=float(values["cx_px"]),
                cy_px=float(values["cy_px"]),
                distortion=tuple(float(k) for k in values["distortion"]),
            )
        except (TypeError, ValueError) as error:
            raise CalibrationError(f"camera model: {error}") from error

    def to_dict(self) -> dict[str, Any]:
        """Give the model as plain values for JSON and YAML."""
        return {**asdict(self), "distortion": list(self.distortion)}

    @property
    def matrix(self) -> FloatArray:
        """Get the camera matrix K, shape (3, 3), pixels."""
        return np.array(
            [[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]]
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Get (rows, columns) of an image."""
        return self.height_px, self.width_px

    @property
    def horizontal_fov_rad(self) -> float:
        """Get the angle between the rays of the left and the right border at half height."""
        v = (self.height_px - 1) / 2
        rays = self.rays([[-0.5, v], [self.width_px - 0.5, v]])
        return float(np.arctan(rays[1, 0]) - np.arctan(rays[0, 0]))

    def cropped(self, *, left_px: int, top_px: int, width_px: int, height_px: int) -> "CameraModel":
        """Give the model of a region of interest of this camera."""
        return replace(
            self,
            width_px=width_px,
            height_px=height_px,
            cx_px=self.cx_px - left_px,
            cy_px=self.cy_px - top_px,
        )

    def scaled(self, width_px: int) -> "CameraModel":
        """Give the model of the same view in fewer and larger pixels, so many in a row."""
        height_px = max(1, round(self.height_px * width_px / self.width_px))
        along_u, along_v = width_px / self.width_px, height_px / self.height_px
        return replace(
            self,
            width_px=width_px,
            height_px=height_px,
            fx_px=self.fx_px * along_u,
            fy_px=self.fy_px * along_v,
            cx_px=(self.cx_px + 0.5) * along_u - 0.5,
            cy_px=(self.cy_px + 0.5) * along_v - 0.5,
        )

    def project(self, p_cam: ArrayLike) -> FloatArray:
        """Project points in front of the camera.

        Args:
            p_cam: Points in cam, shape (n, 3), metres, z > 0.

        Returns:
            Pixel coordinates uv, shape (n, 2); NaN where z <= 0.
        """
        p = np.atleast_2d(np.asarray(p_cam, dtype=np.float64))
        z = np.where(p[:, 2] > 0, p[:, 2], np.nan)
        return self.pixels(p[:, :2] / z[:, None])

    def pixels(self, rays: ArrayLike) -> FloatArray:
        """Give the pixel coordinates uv, shape (..., 2), of rays (x, y), shape (..., 2)."""
        distorted = distort(np.asarray(rays, dtype=np.float64), self.distortion)
        return distorted * [self.fx_px, self.fy_px] + [self.cx_px, self.cy_px]

    def rays(self, uv: ArrayLike) -> FloatArray:
        """Give the rays (x, y), shape (..., 2), through pixel coordinates uv, shape (..., 2).

        The distortion is inverted by Newton's method to 1e-12.

        Raises:
            CalibrationError: The distortion cannot be inverted there (it folds the image over).
        """
        target = (np.asarray(uv, dtype=np.float64) - [self.cx_px, self.cy_px]) / [
            self.fx_px,
            self.fy_px,
        ]
        return _undistort(target, self.distortion)

    def ray_table(self, *, du_px: float = 0.0, dv_px: float = 0.0) -> FloatArray:
        """Give the ray through every pixel centre, moved by (du, dv): shape (rows, columns, 2)."""
        u = np.arange(self.width_px) + du_px
        v = np.arange(self.height_px) + dv_px
        return self.rays(np.stack(np.meshgrid(u, v), axis=-1))


def distort(xy: FloatArray, coefficients: tuple[float, ...]) -> FloatArray:
    """Give the distorted image coordinates, shape (..., 2), of rays (x, y), shape (..., 2)."""
    p1, p2 = coefficients[2:4]
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    radial, _ = _radial(r2, coefficients)
    return np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ],
        axis=-1,
    )


def _radial(r2: FloatArray, coefficients: tuple[float, ...]) -> tuple[FloatArray, FloatArray]:
    """Give the radial factor and its derivative by r^2."""
    k1, k2, _, _, k3, k4, k5, k6 = coefficients
    above = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
    by_r2 = k1 + r2 * (2 * k2 + 3 * r2 * k3) - above / below * (k4 + r2 * (2 * k5 + 3 * r2 * k6))
    return above / below, by_r2 / below


def _undistort(target: FloatArray, coefficients: tuple[float, ...]) -> FloatArray:
    if not any(coefficients) or not target.size:
        return target
    xy = target.copy()
    for _ in range(_NEWTON_STEPS):
        residual = distort(xy, coefficients) - target
        jacobian = distortion_jacobian(xy, coefficients)
        if np.abs(residual).max() < _NEWTON_TOLERANCE:
            if _determinant(jacobian).min() > 0 and jacobian[..., 0, 0].min() > 0:
                return xy
            break  # a root beyond the fold, where the image runs backward
        xy = xy - _solve_2x2(jacobian, residual)
    raise CalibrationError(
        f"camera model: distortion {coefficients} cannot be inverted over the whole image;"
        " check the coefficients and their order (k1, k2, p1, p2, k3, k4, k5, k6)"
    )


def distortion_jacobian(xy: FloatArray, coefficients: tuple[float, ...]) -> FloatArray:
    """Give d(distorted)/d(x, y), shape (..., 2, 2)."""
    p1, p2 = coefficients[2:4]
    x, y = xy[..., 0], xy[..., 1]
    radial, by_r2 = _radial(x * x + y * y, coefficients)
    slope = 2.0 * by_r2
    xx = radial + slope * x * x + 2 * p1 * y + 6 * p2 * x
    xy_ = slope * x * y + 2 * p1 * x + 2 * p2 * y
    yy = radial + slope * y * y + 6 * p1 * y + 2 * p2 * x
    return np.stack([np.stack([xx, xy_], -1), np.stack([xy_, yy], -1)], -2)


def _solve_2x2(a: FloatArray, b: FloatArray) -> FloatArray:
    determinant = _determinant(a)
    x = (a[..., 1, 1] * b[..., 0] - a[..., 0, 1] * b[..., 1]) / determinant
    y = (a[..., 0, 0] * b[..., 1] - a[..., 1, 0] * b[..., 0]) / determinant
    return np.stack([x, y], axis=-1)


def _determinant(a: FloatArray) -> FloatArray:
    return a[..., 0, 0] * a[..., 1, 1] - a[..., 0, 1] * a[..., 1, 0]
