"""Hand-eye transform from poses alone, in closed form: where least squares starts.

Every two stations give one motion seen from T-MAC and camera, A X = X B. The methods differ in what
they make linear, and so in what noise does to them: where they disagree, something is wrong with
the poses.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TypeAlias

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.calib.hand_eye.motions import (
    Motions,
    Poses,
    align_directions,
    check_motions,
    motions_between,
    stack_poses,
)
from tronlab.errors import CalibrationError, DegenerateGeometryError
from tronlab.geometry.poses import FloatArray, rotation_angle_rad, skew

__all__ = [
    "CLOSED_FORMS",
    "ClosedForm",
    "HandEyeStart",
    "check_motions",
    "disagreements",
    "mean_pose",
    "solve_closed_forms",
]

DISAGREEMENT_M = 1e-3
DISAGREEMENT_RAD = np.radians(0.1)
"""Methods that differ by less are taken as one."""
_DISAGREEMENT_SIGMAS = 3.0
_SIGMA_PER_MEDIAN = 1.4826
"""Of the absolute deviations of a normal distribution."""


@dataclass(frozen=True, slots=True)
class HandEyeStart:
    """A hand-eye transform without uncertainty."""

    tmac_from_cam: RigidTransform
    trk_from_board: RigidTransform


ClosedForm: TypeAlias = Callable[[Poses, Poses], HandEyeStart]
"""From trk_from_tmac and cam_from_board, one each a station."""


def solve_closed_forms(trk_from_tmac: Poses, cam_from_board: Poses) -> dict[str, HandEyeStart]:
    """Find where the camera sits on the T-MAC and where the board stands, by every method.

    Args:
        trk_from_tmac: Measured pose of the T-MAC at each station.
        cam_from_board: Pose of the board in the camera at each station.

    Returns:
        The solutions by name of the method; one that finds none is left out.

    Raises:
        DegenerateGeometryError: The motions do not determine the transform; see ``check_motions``.
        CalibrationError: No method finds a solution.
    """
    check_motions(trk_from_tmac)
    starts: dict[str, HandEyeStart] = {}
    for name, solve in CLOSED_FORMS.items():
        try:
            starts[name] = solve(trk_from_tmac, cam_from_board)
        except (CalibrationError, np.linalg.LinAlgError):
            continue
    if not starts:
        raise CalibrationError(
            "hand-eye: no closed form finds a transform; the poses of T-MAC and board contradict"
            " each other"
        )
    return starts


def distances(
    starts: Mapping[str, HandEyeStart], tmac_from_cam: RigidTransform
) -> dict[str, dict[str, float]]:
    """Give how far each closed form lies from a solution, as plain values by its name."""
    return {
        name: {
            "position_m": float(
                np.linalg.norm(start.tmac_from_cam.translation - tmac_from_cam.translation)
            ),
            "angle_rad": rotation_angle_rad(start.tmac_from_cam, tmac_from_cam),
        }
        for name, start in starts.items()
    }


def disagreements(starts: Mapping[str, HandEyeStart]) -> tuple[str, ...]:
    """Name the methods whose hand-eye transform lies away from the others'.

    Away is more than three robust sigmas of all methods' distances from their median, and more than
    ``DISAGREEMENT_M`` or ``DISAGREEMENT_RAD``.

    Returns:
        One line a method, empty if they agree.
    """
    poses = [start.tmac_from_cam for start in starts.values()]
    translations = np.array([pose.translation for pose in poses])
    distances_m = np.linalg.norm(translations - np.median(translations, axis=0), axis=1)
    rotations = Rotation.concatenate([pose.rotation for pose in poses])
    turns = (rotations[0].inv() * rotations).as_rotvec()
    middle = rotations[0] * Rotation.from_rotvec(np.median(turns, axis=0))
    angles_rad = (middle.inv() * rotations).magnitude()
    is_away = (distances_m > _limit(distances_m, DISAGREEMENT_M)) | (
        angles_rad > _limit(angles_rad, DISAGREEMENT_RAD)
    )
    return tuple(
        f"closed form {name} lies {1e3 * distances_m[i]:.1f} mm and"
        f" {np.degrees(angles_rad[i]):.2f} deg from the median of {len(starts)} methods"
        for i, name in enumerate(starts)
        if is_away[i]
    )


def mean_pose(poses: RigidTransform) -> RigidTransform:
    """Give the mean of several poses: of the translations, and of the rotations as matrices."""
    return RigidTransform.from_components(poses.translation.mean(axis=0), poses.rotation.mean())


def _limit(distances: FloatArray, least: float) -> float:
    return max(least, _DISAGREEMENT_SIGMAS * _SIGMA_PER_MEDIAN * float(np.median(distances)))


def _closed_form(solve: Callable[[Motions], RigidTransform]) -> ClosedForm:
    """Make a method for motions one for poses."""

    def solve_poses(trk_from_tmac: Poses, cam_from_board: Poses) -> HandEyeStart:
        tmac_from_cam = solve(motions_between(trk_from_tmac, cam_from_board))
        boards = stack_poses(trk_from_tmac) * tmac_from_cam * stack_poses(cam_from_board)
        return HandEyeStart(tmac_from_cam, mean_pose(boards))

    return solve_poses


def _park(motions: Motions) -> RigidTransform:
    """Turn the camera's rotation vectors onto the T-MAC's.

    Source: Park and Martin, IEEE Trans. Robotics and Automation 10 (1994) 717.
    """
    return _with_translation(motions, align_directions(motions.turns_tmac, motions.turns_cam))


def _tsai(motions: Motions) -> RigidTransform:
    """Solve for the axis times tan(angle / 2) of the rotation, which is linear.

    Source: Tsai and Lenz, IEEE Trans. Robotics and Automation 5 (1989) 345.
    """
    a = 2 * motions.tmac.rotation.as_quat(canonical=True)[:, :3]
    b = 2 * motions.cam.rotation.as_quat(canonical=True)[:, :3]
    half_tangent = _solve(skew(a + b).reshape(-1, 3), (b - a).ravel())
    return _with_translation(motions, Rotation.from_mrp(_mrp_of_half_tangent(half_tangent)))


def _horaud(motions: Motions) -> RigidTransform:
    """Minimise the difference of the products of quaternions, a x = x b, over unit x.

    Source: Horaud and Dornaika, Int. J. Robotics Research 14 (1995) 195.
    """
    a = motions.tmac.rotation.as_quat(canonical=True)
    b = motions.cam.rotation.as_quat(canonical=True)
    differences = _left_products(a) - _right_products(b)
    _, vectors = np.linalg.eigh(np.einsum("nki,nkj->ij", differences, differences))
    return _with_translation(motions, Rotation.from_quat(vectors[:, 0]))


def _daniilidis(motions: Motions) -> RigidTransform:
    """Find the dual quaternion in the null space of the screws' equations.

    Source: Daniilidis, Int. J. Robotics Research 18 (1999) 286.
    """
    a, a_dual = _dual_quaternions(motions.tmac)
    b, b_dual = _dual_quaternions(motions.cam)
    rows = np.zeros((len(motions), 6, 8))
    rows[:, :3, :4] = rows[:, 3:, 4:] = _screw_equations(a, b)
    rows[:, 3:, :4] = _screw_equations(a_dual, b_dual)
    _, _, vt = np.linalg.svd(rows.reshape(-1, 8), full_matrices=False)
    real, dual = _unit_dual_quaternion(vt[6], vt[7])
    rotation = Rotation.from_quat(real)
    conjugate = real * [-1.0, -1.0, -1.0, 1.0]
    translation = 2 * (_left_products(dual[None])[0] @ conjugate)[:3]
    return RigidTransform.from_components(translation, rotation)


def _andreff(motions: Motions) -> RigidTransform:
    """Solve for the nine entries of the rotation and the translation together, which is linear.

    Source: Andreff, Horaud and Espiau, Int. J. Robotics Research 20 (2001) 228.
    """
    n = len(motions)
    a, b = motions.tmac.rotation.as_matrix(), motions.cam.rotation.as_matrix()
    rows, right = np.zeros((n, 12, 12)), np.zeros((n, 12))
    rows[:, :9, :9] = np.eye(9) - np.einsum("nij,nkl->nikjl", a, b).reshape(n, 9, 9)
    rows[:, 9:, :9] = np.einsum("ij,nk->nijk", np.eye(3), motions.cam.translation).reshape(n, 3, 9)
    rows[:, 9:, 9:] = np.eye(3) - a
    right[:, 9:] = motions.tmac.translation
    unknowns = _solve(rows.reshape(-1, 12), right.ravel())
    u, _, vt = np.linalg.svd(unknowns[:9].reshape(3, 3))
    if np.linalg.det(u @ vt) < 0:
        raise DegenerateGeometryError("hand-eye: the rotation that fits best is a reflection")
    return RigidTransform.from_components(unknowns[9:], Rotation.from_matrix(u @ vt))


def _with_translation(motions: Motions, rotation: Rotation) -> RigidTransform:
    """Solve (R_A - I) t_X = R_X t_B - t_A over all motions in the least-squares sense."""
    left = motions.tmac.rotation.as_matrix() - np.eye(3)
    right = rotation.apply(motions.cam.translation) - motions.tmac.translation
    translation = _solve(left.reshape(-1, 3), right.ravel())
    return RigidTransform.from_components(translation, rotation)


def _solve(left: FloatArray, right: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.lstsq(left, right, rcond=None)[0], dtype=np.float64)


def _mrp_of_half_tangent(v: FloatArray) -> FloatArray:
    """Give axis tan(angle / 4), shape (3,), of axis tan(angle / 2)."""
    return v / (1.0 + np.sqrt(1.0 + v @ v))


def _left_products(q: FloatArray) -> FloatArray:
    """Give the matrices of x -> q x for quaternions xyzw, shape (n, 4, 4)."""
    return _products(q, skew(q[:, :3]))


def _right_products(q: FloatArray) -> FloatArray:
    """Give the matrices of x -> x q for quaternions xyzw, shape (n, 4, 4)."""
    return _products(q, -skew(q[:, :3]))


def _products(q: FloatArray, crosses: FloatArray) -> FloatArray:
    matrices = q[:, 3, None, None] * np.eye(4)
    matrices[:, :3, :3] += crosses
    matrices[:, :3, 3] += q[:, :3]
    matrices[:, 3, :3] -= q[:, :3]
    return matrices


def _dual_quaternions(poses: RigidTransform) -> tuple[FloatArray, FloatArray]:
    """Give real and dual part, xyzw, shape (n, 4) each; the dual part is t q / 2."""
    real = poses.rotation.as_quat(canonical=True)
    t = np.pad(poses.translation, ((0, 0), (0, 1)))
    return real, 0.5 * np.einsum("nij,nj->ni", _left_products(t), real)


def _screw_equations(a: FloatArray, b: FloatArray) -> FloatArray:
    """Give the vector part of a x - x b as matrices of x, xyzw, shape (n, 3, 4)."""
    difference, total = (a - b)[:, :3], (a + b)[:, :3]
    return np.concatenate([skew(total), difference[:, :, None]], axis=2)


def _unit_dual_quaternion(v: FloatArray, w: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Combine two vectors of the null space, shape (8,), to a unit dual quaternion.

    With s v + w its dual part must be perpendicular to its real part: a quadratic equation.
    """
    quadratic = [v[:4] @ v[4:], v[:4] @ w[4:] + w[:4] @ v[4:], w[:4] @ w[4:]]
    if quadratic[1] ** 2 < 4 * quadratic[0] * quadratic[2]:
        raise DegenerateGeometryError("hand-eye: the dual quaternion has no real solution")
    candidates = [s.real * v + w for s in np.roots(quadratic)]
    if not candidates:
        raise DegenerateGeometryError("hand-eye: the dual quaternion is not determined")
    best = max(candidates, key=lambda candidate: float(candidate[:4] @ candidate[:4]))
    best = best / np.linalg.norm(best[:4])
    return best[:4], best[4:]


CLOSED_FORMS: Mapping[str, ClosedForm] = MappingProxyType(
    {
        "park": _closed_form(_park),
        "tsai": _closed_form(_tsai),
        "horaud": _closed_form(_horaud),
        "daniilidis": _closed_form(_daniilidis),
        "andreff": _closed_form(_andreff),
    }
)
"""The methods by name."""
