"""Poses as ``scipy.spatial.transform.RigidTransform``: made from validated input, and compared.

``a_from_b`` maps coordinates of frame b to frame a: ``p_a = a_from_b.apply(p_b)``, and the
translation of ``a_from_b`` is the origin of b in a. RigidTransform normalises a scaled or skewed
rotation silently; everything here checks first, so that a bad matrix is an error and not a pose.
"""

from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.errors import FrameError

FloatArray: TypeAlias = NDArray[np.float64]

ROTATION_TOLERANCE = 1e-6
"""Largest departure of R R^T from the identity, or of a quaternion's norm from 1, accepted."""

CAM_FROM_BLENDER_CAM = RigidTransform.from_rotation(
    Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))
)
"""Blender's camera frame has the Y- and Z-axis of the camera frame reversed (paper, Fig. 4)."""


def pose_from_matrix(matrix: ArrayLike, *, tolerance: float = ROTATION_TOLERANCE) -> RigidTransform:
    """Make a pose from a homogeneous matrix.

    Args:
        matrix: ``a_from_b``, shape (4, 4); translation in metres.
        tolerance: Largest accepted departure from an orthonormal rotation.

    Raises:
        FrameError: Wrong shape, not finite, scaled, skewed, mirrored, or a wrong last row.
    """
    m = _finite(matrix, shape=(4, 4), what="pose matrix")
    if not np.allclose(m[3], [0.0, 0.0, 0.0, 1.0], atol=tolerance):
        raise FrameError(f"pose matrix: last row is {m[3].tolist()}, expected [0, 0, 0, 1]")
    return pose_from_rotation(m[:3, :3], m[:3, 3], tolerance=tolerance)


def pose_from_rotation(
    rotation: ArrayLike, translation_m: ArrayLike, *, tolerance: float = ROTATION_TOLERANCE
) -> RigidTransform:
    """Make a pose from a rotation matrix (3, 3) and a translation (3,), metres.

    Raises:
        FrameError: Wrong shape, not finite, not orthonormal within ``tolerance``, or mirrored.
    """
    r = _finite(rotation, shape=(3, 3), what="rotation matrix")
    t = _finite(translation_m, shape=(3,), what="translation")
    departure = float(np.abs(r @ r.T - np.eye(3)).max())
    if departure > tolerance:
        raise FrameError(
            f"rotation matrix: not orthonormal, R R^T differs from identity by {departure:.3g}"
            f" (allowed {tolerance:.3g})"
        )
    if np.linalg.det(r) < 0:
        raise FrameError("rotation matrix: determinant is -1, the frame is left-handed")
    return RigidTransform.from_components(t, Rotation.from_matrix(r))


def pose_from_xyz_quat(
    xyz_quat: ArrayLike, *, tolerance: float = ROTATION_TOLERANCE
) -> RigidTransform:
    """Make a pose from ``x y z qx qy qz qw``, shape (7,); metres, scalar-last unit quaternion.

    Raises:
        FrameError: Wrong shape, not finite, or a quaternion whose norm is not 1.
    """
    v = _finite(xyz_quat, shape=(7,), what="pose (x y z qx qy qz qw)")
    norm = float(np.linalg.norm(v[3:]))
    if abs(norm - 1.0) > tolerance:
        raise FrameError(f"pose: the quaternion's norm is {norm:.9g}, expected 1")
    return RigidTransform.from_components(v[:3], Rotation.from_quat(v[3:]))


def xyz_quat_from_pose(pose: RigidTransform) -> FloatArray:
    """Give ``x y z qx qy qz qw``, shape (7,), with qw >= 0 so that equal poses look equal."""
    return np.concatenate([pose.translation, pose.rotation.as_quat(canonical=True)])


def pose_along_boresight(
    position_m: ArrayLike, *, boresight: ArrayLike, right: ArrayLike
) -> RigidTransform:
    """Place a camera by where it is, where it looks and what lies to its right.

    Args:
        position_m: Camera centre in frame a, shape (3,), metres.
        boresight: Direction of the camera's z-axis in frame a, shape (3,), any length.
        right: Direction towards the right of the image, shape (3,); only its part perpendicular
            to ``boresight`` counts.

    Returns:
        ``a_from_cam``.

    Raises:
        FrameError: A zero direction, or the two are parallel.
    """
    z = unit(boresight, what="boresight")
    x = unit(right, what="right")
    x = x - (x @ z) * z
    if np.linalg.norm(x) < 1e-6:
        raise FrameError("camera pose: 'right' is parallel to the boresight")
    x /= np.linalg.norm(x)
    return pose_from_rotation(np.column_stack([x, np.cross(z, x), z]), position_m)


def rotation_angle_rad(a_from_b: RigidTransform, a_from_c: RigidTransform) -> float:
    """Give the angle of the rotation between two poses, radians, 0 to pi."""
    return float((a_from_b.rotation.inv() * a_from_c.rotation).magnitude())


def unit(vector: ArrayLike, *, what: str = "direction") -> FloatArray:
    """Scale a vector (3,) to length 1.

    Raises:
        FrameError: The vector is zero, not finite, or not of shape (3,).
    """
    v = _finite(vector, shape=(3,), what=what)
    length = float(np.linalg.norm(v))
    if length < 1e-12:
        raise FrameError(f"{what}: is zero")
    return v / length


def skew(v: ArrayLike) -> FloatArray:
    """Give the matrices [v]x of the cross product, shape (..., 3, 3), of vectors (..., 3)."""
    vectors = np.asarray(v, dtype=np.float64)
    matrices = np.zeros((*vectors.shape, 3))
    matrices[..., [2, 0, 1], [1, 2, 0]] = vectors
    return matrices - np.swapaxes(matrices, -1, -2)


def _finite(value: ArrayLike, *, shape: tuple[int, ...], what: str) -> FloatArray:
    array = np.asarray(value, dtype=np.float64)
    if array.shape != shape:
        raise FrameError(f"{what}: shape is {array.shape}, expected {shape}")
    if not np.isfinite(array).all():
        raise FrameError(f"{what}: has values that are not finite: {array.tolist()}")
    return array
