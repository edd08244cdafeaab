"""Frames from points: the model frame by three reflectors, and rigid alignment of point sets."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.errors import DegenerateGeometryError
from tronlab.geometry.poses import FloatArray, pose_from_rotation

MIN_TRIANGLE_ANGLE_RAD = np.radians(5.0)
"""Three points with a smaller angle between the two arms leave the frame's roll undetermined."""


def frame_from_reflectors(
    top_left: ArrayLike, bottom_left: ArrayLike, top_right: ArrayLike
) -> RigidTransform:
    """Find the model frame F_TRS from its three reflectors (paper, section 3.3).

    The origin is the top-left reflector; X points towards the bottom-left one; Y lies in the plane
    of the three, perpendicular to X, and points to the right; Z completes the right-handed frame
    and points out of the model towards the camera.

    Args:
        top_left: Reflector centre in the tracker frame, shape (3,), metres.
        bottom_left: The same for the reflector below it.
        top_right: The same for the reflector to its right.

    Returns:
        ``trk_from_trs``.

    Raises:
        DegenerateGeometryError: Two reflectors coincide, or the three are collinear.
    """
    a, b, c = (np.asarray(p, dtype=np.float64) for p in (top_left, bottom_left, top_right))
    down, across = b - a, c - a
    if min(np.linalg.norm(down), np.linalg.norm(across)) < 1e-3:
        raise DegenerateGeometryError("F_TRS: two reflectors lie within 1 mm of each other")
    normal = np.cross(down, across)
    sine = np.linalg.norm(normal) / (np.linalg.norm(down) * np.linalg.norm(across))
    if sine < np.sin(MIN_TRIANGLE_ANGLE_RAD):
        raise DegenerateGeometryError(
            f"F_TRS: the reflectors are collinear within {np.degrees(np.arcsin(sine)):.2f} deg"
            f" (at least {np.degrees(MIN_TRIANGLE_ANGLE_RAD):.0f} deg needed);"
            " the rotation about their line is not determined"
        )
    x = down / np.linalg.norm(down)
    z = normal / np.linalg.norm(normal)
    return pose_from_rotation(np.column_stack([x, np.cross(z, x), z]), a)


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
    a0, b0 = a.mean(axis=0), b.mean(axis=0)
    if _rank(a - a0) < 2:
        raise DegenerateGeometryError("alignment: all points lie on one line")
    u, _, vt = np.linalg.svd((a - a0).T @ (b - b0))
    handed = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = Rotation.from_matrix(u @ handed @ vt)
    return RigidTransform.from_components(a0 - rotation.apply(b0), rotation)


def _rank(centred: FloatArray) -> int:
    scale = np.linalg.norm(centred)
    return int(np.linalg.matrix_rank(centred, tol=1e-9 * max(scale, 1e-300)))
