"""The pose from matches of which some are wrong.

All methods judge a match by its distance, on the plane at unit depth, between ray and projected
point; ``scale`` plays no part here. Every one is deterministic: same matches and seed, same answer.
"""

from typing import Any, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.geometry.camera import CameraModel
from tronlab.nav.pose.correspondences import MIN_POINTS, Correspondences, NoPoseError, need
from tronlab.nav.pose.solvers import OPENCV_SOLVERS, Solver, checked, first_line, for_opencv, solve
from tronlab.nav.settings import PoseSettings

RANSAC_ROUNDS = 1000
"""Of five matches each: a set without a wrong one is likely up to two wrong matches in three, but
a set whose noise is small enough only up to one in two."""
MODERN_ROUNDS = 10_000
"""Of three matches each, at most: nine wrong matches in ten. They stop when confident."""
CONFIDENCE = 0.9999
POSELIB_MIN_ROUNDS = 50
USAC_TOLERANCE = 4.0
"""The unit that distances are handed to USAC in is a fourth of the tolerance."""

_MAX_OPENCV_SEED = 2**31
_POLISHING_ROUNDS = 3

Agreement: TypeAlias = tuple[RigidTransform, NDArray[np.bool_]]


def find_agreeing(
    matches: Correspondences, camera: CameraModel, settings: PoseSettings, *, seed: int = 0
) -> Agreement:
    """Find ``trs_from_cam`` and the matches that agree with it, as the settings say.

    Args:
        matches: The most similar first; the robust methods look at the first ``n_best``.
        camera: Intrinsics; ``tolerance_px`` holds at the centre of the image.
        settings: Method, solver, tolerance.
        seed: Of the draws.

    Returns:
        The pose and which matches agree with it, shape (n,); those not looked at do not.

    Raises:
        NoPoseError: Too few matches, too few of them agree, or points are behind the camera.
    """
    if settings.robust == "none":
        return solve(settings.solver, matches), np.ones(len(matches), np.bool_)
    looked_at = matches.take(slice(settings.n_best))
    if settings.robust == "ransac":
        tolerance = settings.tolerance_px / camera.fx_px
        pose, agrees = solve_ransac(
            looked_at, tolerance=tolerance, solver=settings.solver, seed=seed
        )
    elif settings.robust == "usac":
        pose, agrees = solve_usac(
            looked_at, camera, tolerance_px=settings.tolerance_px, solver=settings.solver, seed=seed
        )
    else:
        pose, agrees = solve_poselib(
            looked_at, camera, tolerance_px=settings.tolerance_px, seed=seed
        )
    return pose, np.pad(agrees, (0, len(matches) - len(agrees)))


def solve_ransac(
    matches: Correspondences, *, tolerance: float, solver: Solver = "epnp", seed: int = 0
) -> Agreement:
    """Find ``trs_from_cam`` by RANSAC around EPnP (Fischler and Bolles, CACM 24, 1981).

    OpenCV draws the same numbers every time; a seed other than 0 shuffles the matches instead.

    Args:
        matches: Correspondences.
        tolerance: Largest distance of an inlier on the plane at unit depth.
        solver: Of the pose from all that agree.
        seed: Of the draws.

    Returns:
        The pose and which matches agree with it, shape (n,).

    Raises:
        NoPoseError: Too few matches, or too few of them agree.
    """
    need(len(matches), MIN_POINTS, "matches")
    order = _order(len(matches), seed)
    try:
        answer: Any = cv2.solvePnPRansac(
            *for_opencv(matches.take(order)),
            np.eye(3),
            None,
            iterationsCount=RANSAC_ROUNDS,
            reprojectionError=tolerance,
            confidence=CONFIDENCE,
            flags=OPENCV_SOLVERS[solver],
        )
    except cv2.error as error:
        raise NoPoseError(f"RANSAC failed: {first_line(error)}") from error
    found, rotation_vector, translation, inliers = answer
    agrees = np.empty(len(matches), np.bool_)
    agrees[order] = _mask(inliers if found else None, len(matches), "RANSAC")
    return checked(rotation_vector, translation, matches.take(agrees)), agrees


def solve_usac(
    matches: Correspondences,
    camera: CameraModel,
    *,
    tolerance_px: float,
    solver: Solver = "sqpnp",
    seed: int = 0,
) -> Agreement:
    """Find ``trs_from_cam`` by OpenCV's USAC (Raguram et al., TPAMI 35, 2013).

    P3P scored by MAGSAC++, every record improved locally; the solver has the last word. Drawn
    uniformly: OpenCV's PROSAC stops too early and misses a third of the poses of 20 matches.

    Args:
        matches: Correspondences.
        camera: Intrinsics.
        tolerance_px: Largest distance of an inlier, pixels at the centre of the image.
        solver: Of the pose from all that agree.
        seed: Of the draws.

    Returns:
        The pose and which matches agree with it, shape (n,).

    Raises:
        NoPoseError: Too few matches, or too few of them agree.
    """
    need(len(matches), MIN_POINTS, "matches")
    points, rays = for_opencv(matches)
    # Not in pixels but in parts of the tolerance: MAGSAC++ integrates over noise up to a fixed 7.5.
    focal = camera.fx_px * USAC_TOLERANCE / tolerance_px
    try:
        answer: Any = cv2.solvePnPRansac(
            points - points.mean(axis=0),  # it calculates in single precision
            rays * focal,
            np.diag([focal, focal, 1.0]),
            None,
            params=_usac_parameters(seed),
        )
    except cv2.error as error:
        raise NoPoseError(f"USAC failed: {first_line(error)}") from error
    agrees = _mask(answer[4] if answer[0] else None, len(matches), "USAC")
    return solve(solver, matches.take(agrees)), agrees


def solve_poselib(
    matches: Correspondences, camera: CameraModel, *, tolerance_px: float, seed: int = 0
) -> Agreement:
    """Find ``trs_from_cam`` by PoseLib's LO-RANSAC (Chum et al., DAGM 2003) and least squares.

    Args:
        matches: Correspondences.
        camera: Intrinsics.
        tolerance_px: Largest distance of an inlier, pixels at the centre of the image.
        seed: Of the draws.

    Returns:
        The pose and which matches agree with it, shape (n,).

    Raises:
        NoPoseError: Too few matches, or too few of them agree.
        ImportError: PoseLib is not installed.
    """
    import poselib  # an extra; PoseSettings say so where it is missing

    need(len(matches), MIN_POINTS, "matches")
    focal_px = camera.fx_px
    points, rays = for_opencv(matches)
    pose, found = poselib.estimate_absolute_pose(
        rays * focal_px,
        points,
        {
            "model": "SIMPLE_PINHOLE",
            "width": camera.width_px,
            "height": camera.height_px,
            "params": [focal_px, 0.0, 0.0],
        },
        {
            "max_reproj_error": tolerance_px,
            "max_iterations": MODERN_ROUNDS,
            "min_iterations": POSELIB_MIN_ROUNDS,
            "success_prob": CONFIDENCE,
            "seed": seed,
        },
        {"loss_type": "TRUNCATED", "loss_scale": tolerance_px},
    )
    agrees = np.array(found["inliers"], np.bool_)
    need(int(agrees.sum()), MIN_POINTS, "agreeing matches")
    turned = Rotation.from_quat(pose.q, scalar_first=True).as_rotvec()
    return checked(turned, pose.t, matches.take(agrees)), agrees


def _mask(inliers: Any, n: int, method: str) -> NDArray[np.bool_]:
    """Turn OpenCV's indices of inliers, or None, into a mask."""
    if inliers is None:
        raise NoPoseError(f"{method}: no pose that {MIN_POINTS} of {n} matches agree with")
    agrees = np.zeros(n, np.bool_)
    agrees[np.ravel(inliers)] = True
    need(int(agrees.sum()), MIN_POINTS, "agreeing matches")
    return agrees


def _order(n: int, seed: int) -> NDArray[np.intp]:
    return np.random.default_rng(seed).permutation(n) if seed else np.arange(n)


def _usac_parameters(seed: int) -> cv2.UsacParams:
    parameters = cv2.UsacParams()
    parameters.threshold = USAC_TOLERANCE
    parameters.confidence = CONFIDENCE
    parameters.maxIterations = MODERN_ROUNDS
    parameters.randomGeneratorState = seed % _MAX_OPENCV_SEED
    parameters.sampler = cv2.SAMPLING_UNIFORM
    parameters.score = cv2.SCORE_METHOD_MAGSAC
    parameters.loMethod = cv2.LOCAL_OPTIM_INNER_LO
    parameters.final_polisher = cv2.LSQ_POLISHER
    parameters.final_polisher_iterations = _POLISHING_ROUNDS
    return parameters
