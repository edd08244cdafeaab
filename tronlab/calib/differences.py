"""By how much one part of two calibrations differs, with the covariance of the difference."""

from dataclasses import dataclass

import numpy as np

from tronlab.calib.camera.projection import INTRINSICS, intrinsics_of
from tronlab.calib.results import (
    CameraResult,
    FrameResult,
    HandEyeResult,
    LampResult,
    PhotometryResult,
    RobotResult,
)
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray
from tronlab.geometry.uncertainty import pose_difference

_MDEG = float(np.degrees(1e3))
_MM = 1e3
_GRID = 24
"""The image is looked at in so many rows and columns."""
_STEP = 1e-6
"""Turn by which derivatives are taken, radians."""
_SMALLEST_EIGENVALUE = 1e-12
"""Of a correlation matrix; smaller ones are rounding errors."""
_SAME_PLACE_M = 1e-9
_POSE_AXES = (
    *((f"turn about {axis}", "mdeg", _MDEG) for axis in "xyz"),
    *((f"shift along {axis}", "mm", _MM) for axis in "xyz"),
)


@dataclass(frozen=True, slots=True)
class Difference:
    """How one part differs, in SI."""

    axes: tuple[tuple[str, str, float], ...]
    """Name, unit and factor to that unit of each value."""
    values: FloatArray
    """Second minus first, shape (n,)."""
    covariance: FloatArray
    """Of ``values``, shape (n, n)."""
    size: str
    """How large it is, for people."""

    def chi_square(self) -> tuple[float, int]:
        """Give the squared Mahalanobis distance and in how many directions it is one.

        Numbers without variance, as the coefficients a distortion model holds at 0, say nothing
        unless they differ.
        """
        sigmas = np.sqrt(np.diag(self.covariance))
        is_free = sigmas > 0
        if self.values[~is_free].any():
            return float("inf"), len(self.values)
        scaled, sigmas = self.values[is_free] / sigmas[is_free], sigmas[is_free]
        correlation = self.covariance[np.ix_(is_free, is_free)] / np.outer(sigmas, sigmas)
        eigenvalues, axes = np.linalg.eigh(correlation)
        is_real = eigenvalues > _SMALLEST_EIGENVALUE * len(scaled)
        along = (axes.T @ scaled)[is_real]
        return float((along**2 / eigenvalues[is_real]).sum()), int(is_real.sum())


def frame_difference(first: FrameResult, second: FrameResult) -> Difference:
    """Give how far the tracker moved in the model frame, as turn and shift along its axes."""
    covariance = first.covariance + second.covariance
    return _of_pose(pose_difference(first.trs_from_trk, second.trs_from_trk), covariance)


def hand_eye_difference(first: HandEyeResult, second: HandEyeResult) -> Difference:
    """Give how far the camera moved on the T-MAC, as turn and shift along the axes of tmac."""
    covariance = first.covariance + second.covariance
    return _of_pose(pose_difference(first.tmac_from_cam, second.tmac_from_cam), covariance)


def camera_difference(first: CameraResult, second: CameraResult) -> Difference:
    """Give how the intrinsics differ; as a size, how far apart the two see the same rays."""
    axes = tuple(
        (name.removesuffix("_px"), "px" if name.endswith("_px") else "1", 1.0)
        for name in INTRINSICS
    )
    values = intrinsics_of(second.camera) - intrinsics_of(first.camera)
    covariance = first.covariance + second.covariance
    return Difference(axes, values, covariance, _camera_size(first.camera, second.camera))


def lamp_difference(first: LampResult, second: LampResult) -> Difference:
    """Give how far the lamp moved.

    The light is where it was in its housing, unless the rig file says otherwise: how well that
    place is known makes the light uncertain, but not its way.
    """
    values = second.p_trs_m - first.p_trs_m
    covariance = first.covariance_m2 + second.covariance_m2
    if _is_same_housing(first, second):
        common_m2 = sum(lamp.statistics["light_sigma_m"] ** 2 for lamp in (first, second))
        covariance = covariance - common_m2 * np.eye(3)
    return Difference(_POSE_AXES[3:], values, covariance, _length(values))


def _is_same_housing(first: LampResult, second: LampResult) -> bool:
    """Tell whether both have the light at the same place behind its reflector."""
    if not all("p_reflector_trs_m" in lamp.statistics for lamp in (first, second)):
        return False
    offsets_m = [
        lamp.p_trs_m - np.array(lamp.statistics["p_reflector_trs_m"]) for lamp in (first, second)
    ]
    return bool(np.allclose(*offsets_m, rtol=0.0, atol=_SAME_PLACE_M))


def robot_difference(first: RobotResult, second: RobotResult) -> Difference:
    """Give how rail, its axis, and T-MAC on the flange moved."""
    rail = pose_difference(first.trs_from_rail, second.trs_from_rail)
    along = second.rail_axis - first.rail_axis
    tool = pose_difference(first.flange_from_tmac, second.flange_from_tmac)
    axes = (
        *((f"rail: {name}", unit, factor) for name, unit, factor in _POSE_AXES),
        *((f"rail axis {axis}", "1", 1.0) for axis in "xyz"),
        *((f"T-MAC: {name}", unit, factor) for name, unit, factor in _POSE_AXES),
    )
    size = (
        f"rail {_pose_size(rail)}; its axis {np.linalg.norm(along):.1e};"
        f" T-MAC on the flange {_pose_size(tool)}"
    )
    values = np.concatenate([rail, along, tool])
    return Difference(axes, values, first.covariance + second.covariance, size)


def photometry_difference(first: PhotometryResult, second: PhotometryResult) -> Difference:
    """Give how the shares of Lommel-Seeliger differ."""
    share = second.weight - first.weight
    variance = first.weight_sigma**2 + second.weight_sigma**2
    axes = (("share of Lommel-Seeliger", "1", 1.0),)
    return Difference(axes, np.array([share]), np.array([[variance]]), f"its share {share:+.3f}")


def _of_pose(values: FloatArray, covariance: FloatArray) -> Difference:
    return Difference(_POSE_AXES, values, covariance, _pose_size(values))


def _camera_size(first: CameraModel, second: CameraModel) -> str:
    if first.shape != second.shape:
        return "another image size"
    return f"{image_shift_px(first, second):.3f} px rms over the image, best turn taken out"


def image_shift_px(first: CameraModel, second: CameraModel) -> float:
    """Give how far apart two cameras see the same rays, once the second is turned to fit best.

    What a turn of the camera explains belongs to the hand-eye transform (as in mrcal's
    differencing). Root mean square over the image of the first, pixels.
    """
    u = np.linspace(0, first.width_px - 1, _GRID)
    v = np.linspace(0, first.height_px - 1, _GRID)
    rays = first.rays(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
    shift = (second.pixels(rays) - first.pixels(rays)).ravel()
    by_turn = np.stack(
        [(first.pixels(_turned(rays, w)) - first.pixels(rays)).ravel() for w in _STEP * np.eye(3)],
        axis=1,
    )
    turn, *_ = np.linalg.lstsq(by_turn, shift, rcond=None)
    return float(np.sqrt(((shift - by_turn @ turn) ** 2).sum() / len(rays)))


def _turned(rays: FloatArray, turn_rad: FloatArray) -> FloatArray:
    directions = np.column_stack([rays, np.ones(len(rays))])
    directions = directions + np.cross(turn_rad, directions)
    return directions[:, :2] / directions[:, 2:]


def _pose_size(difference: FloatArray) -> str:
    turn_deg = float(np.degrees(np.linalg.norm(difference[:3])))
    turn = f"{turn_deg:.3f} deg" if turn_deg >= 1 else f"{turn_deg * 1e3:.2f} mdeg"
    return f"{_length(difference[3:])} and {turn}"


def _length(shift_m: FloatArray) -> str:
    length_m = float(np.linalg.norm(shift_m))
    return f"{length_m:.3f} m" if length_m >= 1 else f"{length_m * _MM:.3f} mm"
