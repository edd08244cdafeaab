"""Hand-eye transform from poses alone, in closed form: where the bundle starts."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.errors import DegenerateGeometryError
from tronlab.geometry.poses import FloatArray

MIN_STATIONS = 3
MIN_TURN_RAD = np.radians(5.0)
"""Least root mean square of the turns between stations, about each of two axes."""
_LARGEST_TURN_RAD = np.radians(165.0)
"""A rotation vector near half a turn flips its sign by noise."""


@dataclass(frozen=True, slots=True)
class HandEyeStart:
    """A hand-eye transform without uncertainty."""

    tmac_from_cam: RigidTransform
    trk_from_board: RigidTransform


def solve_closed_form(
    trk_from_tmac: Sequence[RigidTransform], cam_from_board: Sequence[RigidTransform]
) -> HandEyeStart:
    """Find where the camera sits on the T-MAC and where the board stands.

    Every two stations give the same motion seen from T-MAC and camera: A X = X B. Rotation vectors
    of A are those of B turned by X; then the translation is a linear problem.

    Args:
        trk_from_tmac: Measured pose of the T-MAC at each station.
        cam_from_board: Pose of the board in the camera at each station.

    Raises:
        DegenerateGeometryError: Fewer than three stations, or the T-MAC turned about one axis only,
            or hardly at all: then part of the translation is undetermined.

    Source: Park and Martin, IEEE Trans. Robotics and Automation 10 (1994) 717.
    """
    n = len(trk_from_tmac)
    if n < MIN_STATIONS:
        raise DegenerateGeometryError(
            f"hand-eye: {n} stations, at least {MIN_STATIONS} with turns about two axes needed"
        )
    motions_tmac, motions_cam = _motions(trk_from_tmac, cam_from_board)
    if not motions_tmac:
        raise DegenerateGeometryError(
            "hand-eye: all stations are about half a turn apart; add stations in between"
        )
    turns_tmac = np.array([motion.rotation.as_rotvec() for motion in motions_tmac])
    turns_cam = np.array([motion.rotation.as_rotvec() for motion in motions_cam])
    _check_turns(turns_tmac)
    rotation = _align_directions(turns_tmac, turns_cam)
    translation = _solve_translation(motions_tmac, motions_cam, rotation)
    tmac_from_cam = RigidTransform.from_components(translation, rotation)
    boards = [
        tmac * tmac_from_cam * board
        for tmac, board in zip(trk_from_tmac, cam_from_board, strict=True)
    ]
    return HandEyeStart(tmac_from_cam, _mean_pose(boards))


def _motions(
    trk_from_tmac: Sequence[RigidTransform], cam_from_board: Sequence[RigidTransform]
) -> tuple[list[RigidTransform], list[RigidTransform]]:
    """Give the motion from each station to each other one, in tmac and in cam."""
    motions_tmac: list[RigidTransform] = []
    motions_cam: list[RigidTransform] = []
    for i, j in combinations(range(len(trk_from_tmac)), 2):
        motion_tmac = trk_from_tmac[i].inv() * trk_from_tmac[j]
        if motion_tmac.rotation.magnitude() < _LARGEST_TURN_RAD:
            motions_tmac.append(motion_tmac)
            motions_cam.append(cam_from_board[i] * cam_from_board[j].inv())
    return motions_tmac, motions_cam


def _check_turns(turns: FloatArray) -> None:
    _, spread, axes = np.linalg.svd(turns / np.sqrt(len(turns)))
    needed = f"at least {np.degrees(MIN_TURN_RAD):.0f} deg needed"
    if spread[0] < MIN_TURN_RAD:
        raise DegenerateGeometryError(
            f"hand-eye: the T-MAC turned by {np.degrees(spread[0]):.2f} deg between stations"
            f" ({needed}); turn it about two axes"
        )
    if spread[1] < MIN_TURN_RAD:
        axis = ", ".join(f"{value:.2f}" for value in axes[0])
        raise DegenerateGeometryError(
            f"hand-eye: all turns are about the same axis ({axis}) of tmac, within"
            f" {np.degrees(spread[1]):.2f} deg ({needed}): the translation along it is not"
            " determined; turn the T-MAC about a second axis"
        )


def _align_directions(a: FloatArray, b: FloatArray) -> Rotation:
    """Find R with a = R b in the least-squares sense, vectors of shape (n, 3)."""
    u, _, vt = np.linalg.svd(a.T @ b)
    handed = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    return Rotation.from_matrix(u @ handed @ vt)


def _solve_translation(
    motions_tmac: Sequence[RigidTransform],
    motions_cam: Sequence[RigidTransform],
    rotation: Rotation,
) -> FloatArray:
    """Solve (R_A - I) t_X = R_X t_B - t_A over all motions in the least-squares sense."""
    left = np.vstack([motion.rotation.as_matrix() - np.eye(3) for motion in motions_tmac])
    right = np.concatenate(
        [
            rotation.apply(motion_cam.translation) - motion_tmac.translation
            for motion_tmac, motion_cam in zip(motions_tmac, motions_cam, strict=True)
        ]
    )
    return np.linalg.lstsq(left, right, rcond=None)[0]


def _mean_pose(poses: Sequence[RigidTransform]) -> RigidTransform:
    translation = np.mean([pose.translation for pose in poses], axis=0)
    rotation = Rotation.concatenate([pose.rotation for pose in poses]).mean()
    return RigidTransform.from_components(translation, rotation)
