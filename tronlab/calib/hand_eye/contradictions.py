"""Why tracker and camera contradict each other: mistakes that leave a trace in the motions.

Between two stations T-MAC and camera make the same motion. If the T-MAC's is longer by a factor,
one of the two is in another unit; if it is the other's mirror image, a frame is left-handed; if its
turns fit once inverted, the poses were given the wrong way round, or a quaternion's scalar was read
from the wrong place: a cyclic shift of the four numbers is an inversion between two turns.
"""

import numpy as np

from tronlab.calib.hand_eye.motions import (
    Motions,
    Poses,
    align_directions,
    motions_between,
    stack_poses,
)
from tronlab.errors import CalibrationError, DegenerateGeometryError

_LEAST_FREE_PART = 1e-6
"""Of the motions' translations, below which they say nothing about scale."""
_SURE_SIGMAS = 5.0
_SAME_FACTOR = 0.2
"""Largest difference of the logarithms of two factors taken as one."""
_LARGE_MISFIT = 0.3
"""Of the turns of T-MAC and camera, relative: beyond any noise."""
_FAR_BETTER = 3.0
_INVERTED = (
    "the turns of T-MAC and camera agree only if one of the two is inverted: give the T-MAC in the"
    " tracker and the board in the camera, not the other way round (or say that the board is on"
    " the hand), and the quaternion's scalar last (qx qy qz qw)"
)


def check_agreement(trk_from_tmac: Poses, cam_from_board: Poses) -> None:
    """Refuse poses of T-MAC and board that cannot be of the same stations as they are written.

    Args:
        trk_from_tmac: Measured pose of the T-MAC at each station.
        cam_from_board: Pose of the board in the camera at each station.

    Raises:
        DegenerateGeometryError: One is mirrored.
        CalibrationError: One is in millimetres or written the other way round (board_from_cam,
            tmac_from_trk), or they have nothing in common.
    """
    if is_one_inverted(trk_from_tmac, cam_from_board):
        raise CalibrationError(f"hand-eye: {_INVERTED}")
    if (misfit := _misfit(motions_between(trk_from_tmac, cam_from_board))) > _LARGE_MISFIT:
        raise CalibrationError(
            f"hand-eye: the turns of T-MAC and camera differ by {misfit:.0%}, at most"
            f" {_LARGE_MISFIT:.0%} can be noise; are the poses of the same moments, in the same"
            " order?"
        )
    check_units_and_hands(trk_from_tmac, cam_from_board)


def check_units_and_hands(trk_from_tmac: Poses, cam_from_board: Poses) -> None:
    """Refuse poses in millimetres, or in a left-handed frame; see ``check_agreement``."""
    scale, sigma = _motion_scale(motions_between(trk_from_tmac, cam_from_board), len(trk_from_tmac))
    if abs(scale - 1.0) < _SURE_SIGMAS * sigma:
        return
    for factor, larger, smaller in ((1e3, "T-MAC", "board"), (1e-3, "board", "T-MAC")):
        if _is_about(abs(scale), factor):
            raise CalibrationError(
                f"hand-eye: the T-MAC moves {abs(scale):.4g} times as far as the camera: the poses"
                f" of the {larger} seem to be in millimetres, those of the {smaller} in metres;"
                " give both in metres"
            )
    if _is_about(-scale, 1.0):
        raise DegenerateGeometryError(
            f"hand-eye: the motions of T-MAC and camera fit each other mirrored only (scale"
            f" {scale:.3f}): the image, the board or one of the frames is mirrored, or left-handed"
        )


def explain(trk_from_tmac: Poses, cam_from_board: Poses) -> str:
    """Give a sentence on what may be wrong with readings that do not fit; empty if unknown."""
    if is_one_inverted(trk_from_tmac, cam_from_board):
        return _INVERTED
    scale, sigma = _motion_scale(motions_between(trk_from_tmac, cam_from_board), len(trk_from_tmac))
    if _is_about(scale, 1.0) and abs(scale - 1.0) > _SURE_SIGMAS * sigma:
        return (
            f"the T-MAC moved {scale:.4f} times as far as the camera saw: is the board's square_m"
            " right?"
        )
    return ""


def is_one_inverted(trk_from_tmac: Poses, cam_from_board: Poses) -> bool:
    """Tell whether the turns of T-MAC and camera agree only if one of the two is inverted."""
    stacked = stack_poses(cam_from_board)
    misfits = [_misfit(motions_between(trk_from_tmac, cam)) for cam in (stacked, stacked.inv())]
    return misfits[0] > _LARGE_MISFIT > _FAR_BETTER * misfits[1]


def _motion_scale(motions: Motions, n_stations: int) -> tuple[float, float]:
    """Find how many times as far as the camera's motions the T-MAC's are.

    The translation of A X = X B is solved with a factor before that of B.

    Args:
        motions: Of all stations.
        n_stations: How many there are: so many motions of theirs are independent.

    Returns:
        The factor and its sigma, infinite where the motions do not determine it: a camera that
        turns about one fixed point only looks the same at every scale.

    Source: Andreff, Horaud and Espiau, Int. J. Robotics Research 20 (2001) 228, section 5.
    """
    rotation = align_directions(motions.turns_tmac, motions.turns_cam)
    by_translation = (motions.tmac.rotation.as_matrix() - np.eye(3)).reshape(-1, 3)
    basis, _ = np.linalg.qr(by_translation)
    by_scale = rotation.apply(motions.cam.translation).ravel()
    free = by_scale - basis @ (basis.T @ by_scale)
    if np.linalg.norm(free) <= _LEAST_FREE_PART * np.linalg.norm(by_scale):
        return 1.0, np.inf
    moved = motions.tmac.translation.ravel()
    moved = moved - basis @ (basis.T @ moved)
    scale = float(free @ moved / (free @ free))
    residual = moved - scale * free
    variance = float(residual @ residual) / len(moved) / float(free @ free)
    return scale, float(np.sqrt(variance * max(1.0, len(motions) / n_stations)))


def _is_about(factor: float, expected: float) -> bool:
    return factor > 0 and abs(np.log(factor / expected)) < _SAME_FACTOR


def _misfit(motions: Motions) -> float:
    """Give the median difference of the turns after they are aligned, relative to the turns."""
    turns_tmac, turns_cam = motions.turns_tmac, motions.turns_cam
    differences = turns_tmac - align_directions(turns_tmac, turns_cam).apply(turns_cam)
    lengths = np.linalg.norm(turns_tmac, axis=1)
    return float(np.median(np.linalg.norm(differences, axis=1)) / np.median(lengths))
