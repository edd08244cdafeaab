"""The pose from matches that are all trusted."""

from typing import Any, Literal, TypeAlias

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.geometry.poses import FloatArray
from tronlab.nav.pose.correspondences import MIN_POINTS, Correspondences, NoPoseError, need

Solver: TypeAlias = Literal["epnp", "sqpnp"]

OPENCV_SOLVERS: dict[Solver, int] = {"epnp": cv2.SOLVEPNP_EPNP, "sqpnp": cv2.SOLVEPNP_SQPNP}
TITLES: dict[Solver, str] = {"epnp": "EPnP", "sqpnp": "SQPnP"}


def solve(solver: Solver, matches: Correspondences) -> RigidTransform:
    """Find ``trs_from_cam``, every match trusted.

    Raises:
        NoPoseError: Too few matches, no solution, or one with points behind the camera.
    """
    need(len(matches), MIN_POINTS, "matches")
    title = TITLES[solver]
    try:
        found, rotation_vector, translation = cv2.solvePnP(
            *for_opencv(matches), np.eye(3), None, flags=OPENCV_SOLVERS[solver]
        )
    except cv2.error as error:
        raise NoPoseError(f"{title} failed: {first_line(error)}") from error
    if not found:
        raise NoPoseError(f"{title} found no solution")
    return checked(rotation_vector, translation, matches)


def solve_epnp(matches: Correspondences) -> RigidTransform:
    """Find ``trs_from_cam`` by EPnP (Lepetit et al., IJCV 81, 2009), every match trusted.

    Raises:
        NoPoseError: Too few matches, no solution, or one with points behind the camera.
    """
    return solve("epnp", matches)


def solve_sqpnp(matches: Correspondences) -> RigidTransform:
    """Find ``trs_from_cam`` by SQPnP (Terzakis and Lourakis, ECCV 2020), every match trusted.

    Its error is that of least squares, while EPnP's is larger by a third and more.

    Raises:
        NoPoseError: Too few matches, no solution, or one with points behind the camera.
    """
    return solve("sqpnp", matches)


def checked(rotation_vector: Any, translation: Any, matches: Correspondences) -> RigidTransform:
    """Turn ``cam_from_trs`` round, if it is a pose that sees its points.

    Raises:
        NoPoseError: It is not.
    """
    vector = np.concatenate([np.ravel(rotation_vector), np.ravel(translation)]).astype(np.float64)
    if not np.isfinite(vector).all():
        raise NoPoseError("the solver's pose is not finite")
    cam_from_trs = RigidTransform.from_components(vector[3:], Rotation.from_rotvec(vector[:3]))
    n_behind = int((cam_from_trs.apply(matches.p_trs_m)[:, 2] <= 0).sum())
    if n_behind:
        raise NoPoseError(f"the pose has {n_behind} of {len(matches)} points behind the camera")
    return cam_from_trs.inv()


def for_opencv(matches: Correspondences) -> tuple[FloatArray, FloatArray]:
    """Give points and rays laid out row by row: OpenCV miscounts the points of other layouts."""
    return np.ascontiguousarray(matches.p_trs_m), np.ascontiguousarray(matches.rays)


def first_line(error: Exception) -> str:
    """Give what an error of OpenCV says, in one line."""
    return " ".join(str(error).split())[:200]
