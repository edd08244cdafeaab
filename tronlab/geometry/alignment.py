"""Frames from points: the model frame by three reflectors, and rigid alignment of point sets."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.errors import DegenerateGeometryError
from tronlab.geometry.poses import FloatArray, pose_from_rotation, skew, unit
from tronlab.geometry.uncertainty import perturb

MIN_TRIANGLE_ANGLE_RAD = np.radians(5.0)
"""Three points with a smaller angle between the two arms leave the frame's roll undetermined."""
_COINCIDENT_M = 1e-3
_CORNERS = ("top_left", "bottom_left", "top_right")
_MAX_STEPS = 20
_SMALL_STEP = 1e-12
"""Of a rotation vector in rad and a translation in m."""


@dataclass(frozen=True, slots=True)
class PointAlignment:
    """A rigid transform fitted to points with covariances."""

    a_from_b: RigidTransform
    covariance: FloatArray
    """Of (rotation vector, translation) in a, shape (6, 6); see geometry.uncertainty."""
    residuals_m: FloatArray
    """Points in a minus the transformed ones, shape (n, 3), frame a."""
    chi_square: float
    """Weighted sum of squares of the residuals; expected to be ``dof``."""

    @property
    def dof(self) -> int:
        """Get the degrees of freedom."""
        return self.residuals_m.size - 6


def frame_from_reflectors(
    top_left: ArrayLike,
    bottom_left: ArrayLike,
    top_right: ArrayLike,
    *,
    heights_m: ArrayLike = (0.0, 0.0, 0.0),
) -> RigidTransform:
    """Find the model frame F_TRS from its three reflectors (paper, section 3.3).

    The origin is the top-left mark; X points towards the bottom-left one; Y lies in the plane of
    the three, perpendicular to X, and points to the right; Z completes the right-handed frame and
    points out of the model towards the camera. A mark lies below its reflector's centre.

    Args:
        top_left: Reflector centre in the tracker frame, shape (3,), metres.
        bottom_left: The same for the reflector below it.
        top_right: The same for the reflector to its right.
        heights_m: Of the three centres above their marks, along Z, shape (3,).

    Returns:
        ``trk_from_trs``.

    Raises:
        DegenerateGeometryError: Two reflectors coincide, or the three are collinear.
    """
    centres = np.array([top_left, bottom_left, top_right], dtype=np.float64)
    for i, j in combinations(range(3), 2):
        if np.linalg.norm(centres[i] - centres[j]) < _COINCIDENT_M:
            raise DegenerateGeometryError(
                f"F_TRS: reflectors {_CORNERS[i]} and {_CORNERS[j]} lie within 1 mm of each other"
            )
    heights = np.asarray(heights_m, dtype=np.float64)
    arms_trk, rises = centres[1:] - centres[0], heights[1:] - heights[0]
    # Seen along Z, lengths and angle are those between the marks.
    down, across, angle = _flat_arms(arms_trk @ arms_trk.T - np.outer(rises, rises))
    arms_trs = np.array(
        [[down, 0.0, rises[0]], [across * np.cos(angle), across * np.sin(angle), rises[1]]]
    )
    rotation = _triad(arms_trk) @ _triad(arms_trs).T
    return pose_from_rotation(rotation, centres[0] - rotation[:, 2] * heights[0])


def align_points(p_a: ArrayLike, p_b: ArrayLike) -> RigidTransform:
    """Find ``a_from_b`` that maps points onto points in the least-squares sense, without scale.

    Args:
        p_a: Points in frame a, shape (n, 3), metres, n >= 3.
        p_b: The same points in frame b, shape (n, 3), metres.

    Raises:
        DegenerateGeometryError: Fewer than three points, or all on one line.

    Source: Kabsch, Acta Cryst. A32 (1976) 922, by singular values, determinant kept at +1.
    """
    a, b = np.asarray(p_a, dtype=np.float64), np.asarray(p_b, dtype=np.float64)
    if len(a) < 3:
        raise DegenerateGeometryError(f"alignment: {len(a)} points, at least 3 needed")
    if _rank(a - a.mean(axis=0)) < 2:
        raise DegenerateGeometryError("alignment: all points lie on one line")
    return _kabsch(a, b)


def largest_misfit_m(p_a: ArrayLike, p_b: ArrayLike) -> float:
    """Give the farthest that one of the points lies from its partner after ``align_points``.

    Two points, or points on one line, leave the transform undetermined, but not the misfit.
    """
    a, b = np.asarray(p_a, dtype=np.float64), np.asarray(p_b, dtype=np.float64)
    return float(np.linalg.norm(a - _kabsch(a, b).apply(b), axis=1).max())


def align_points_weighted(
    p_a: ArrayLike, p_b: ArrayLike, covariances_b: ArrayLike
) -> PointAlignment:
    """Find ``a_from_b`` that fits points best by their covariances: maximum likelihood.

    Args:
        p_a: Points in frame a, shape (n, 3), metres, n >= 3, without errors.
        p_b: The same points in frame b, shape (n, 3), metres.
        covariances_b: Of each point in b, shape (n, 3, 3), positive definite.

    Raises:
        DegenerateGeometryError: Fewer than three points, or all on one line.
    """
    a, b = np.asarray(p_a, dtype=np.float64), np.asarray(p_b, dtype=np.float64)
    covariances = np.asarray(covariances_b, dtype=np.float64)
    a_from_b = align_points(a, b)
    for _ in range(_MAX_STEPS):
        normal, gradient, _ = _normal_equations(a_from_b, a, b, covariances)
        step = np.linalg.solve(normal, gradient).astype(np.float64)
        a_from_b = perturb(a_from_b, step)
        if np.abs(step).max() < _SMALL_STEP:
            break
    normal, _, chi_square = _normal_equations(a_from_b, a, b, covariances)
    covariance = np.linalg.inv(normal).astype(np.float64)
    return PointAlignment(a_from_b, covariance, a - a_from_b.apply(b), chi_square)


def _normal_equations(
    a_from_b: RigidTransform, a: FloatArray, b: FloatArray, covariances_b: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Give J^T W J, J^T W r and r^T W r of the residuals by (rotation vector, translation)."""
    r = a_from_b.rotation.as_matrix()
    residuals = a - a_from_b.apply(b)
    weights: FloatArray = np.linalg.inv(r @ covariances_b @ r.T)
    jacobians = np.array([np.hstack([-skew(r @ point), np.eye(3)]) for point in b])
    weighted = np.einsum("nij,nik->njk", jacobians, weights)
    normal: FloatArray = np.einsum("nij,njk->ik", weighted, jacobians)
    gradient: FloatArray = np.einsum("nij,nj->i", weighted, residuals)
    return normal, gradient, float(np.einsum("ni,nij,nj", residuals, weights, residuals))


def _kabsch(a: FloatArray, b: FloatArray) -> RigidTransform:
    a0, b0 = a.mean(axis=0), b.mean(axis=0)
    u, _, vt = np.linalg.svd((a - a0).T @ (b - b0))
    handed = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = Rotation.from_matrix(u @ handed @ vt)
    return RigidTransform.from_components(a0 - rotation.apply(b0), rotation)


def _flat_arms(products: FloatArray) -> tuple[float, float, float]:
    """Give the lengths of two arms and the angle between them, by their scalar products (2, 2).

    Raises:
        DegenerateGeometryError: The arms are parallel, or one vanishes.
    """
    squares, product = np.diag(products), float(products[0, 1])
    down, across = (float(length) for length in np.sqrt(np.maximum(squares, 0.0)))
    has_arms = min(down, across) > _COINCIDENT_M
    angle = np.arccos(np.clip(product / (down * across), -1.0, 1.0)) if has_arms else 0.0
    from_line = float(min(angle, np.pi - angle))
    if from_line < MIN_TRIANGLE_ANGLE_RAD:
        raise DegenerateGeometryError(
            f"F_TRS: the reflectors {', '.join(_CORNERS)} are collinear within"
            f" {np.degrees(from_line):.2f} deg (at least"
            f" {np.degrees(MIN_TRIANGLE_ANGLE_RAD):.0f} deg needed);"
            " the rotation about their line is not determined"
        )
    return down, across, float(angle)


def _triad(arms: FloatArray) -> FloatArray:
    """Give a rotation matrix that turns with two arms, shape (2, 3)."""
    x, z = unit(arms[0]), unit(np.cross(arms[0], arms[1]))
    return np.column_stack([x, np.cross(z, x), z])


def _rank(centred: FloatArray) -> int:
    scale = np.linalg.norm(centred)
    return int(np.linalg.matrix_rank(centred, tol=1e-9 * max(scale, 1e-300)))
