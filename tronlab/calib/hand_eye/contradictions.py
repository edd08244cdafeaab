"""Why tracker and camera contradict each other: mistakes that leave a trace in the motions.

Between two stations T-MAC and camera make the same motion. If the T-MAC's is longer by a factor,
one of the two is in another unit; if it is the other's mirror image, a frame is left-handed; if its
rotations fit once inverted, the readings were given the wrong way round, or a quaternion's scalar
was read from the wrong place: a cyclic shift of the four numbers is an inversion between two turns.
"""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.calib.hand_eye.motions import Motions, align_directions, motions_between
from tronlab.errors import CalibrationError, DegenerateGeometryError

_MM_PER_M = 1e3
_ABOUT = 2.0
"""A factor this near a thousand is a thousand."""
_FAR_BETTER = 0.2
"""A mistake is named if without it the misfit is less than this part."""


def check_units_and_hands(
    trk_from_tmac: Sequence[RigidTransform], cam_from_board: Sequence[RigidTransform]
) -> None:
    """Refuse readings in millimetres, or in a left-handed frame.

    Args:
        trk_from_tmac: Measured pose of the T-MAC at each station.
        cam_from_board: Pose of the board in the camera at each station.

    Raises:
        CalibrationError: The readings look like millimetres.
        DegenerateGeometryError: One of the two motions is the other's mirror image.
    """
    factor, gain = _length_factor(motions_between(trk_from_tmac, cam_from_board))
    if gain > _FAR_BETTER:
        return
    if _MM_PER_M / _ABOUT < factor < _MM_PER_M * _ABOUT:
        raise CalibrationError(
            f"hand-eye: the T-MAC moved {factor:.0f} times as far as the camera saw: its readings"
            " look like millimetres; give them in metres"
        )
    if factor < 0:
        raise DegenerateGeometryError(
            "hand-eye: the T-MAC's motions are the mirror image of what the camera saw: one of the"
            " frames is left-handed; set the tracker to right-handed coordinates, and check that"
            " images are not flipped"
        )


def explain(
    trk_from_tmac: Sequence[RigidTransform], cam_from_board: Sequence[RigidTransform]
) -> str:
    """Give a sentence on what may be wrong with readings that do not fit; empty if unknown."""
    motions = motions_between(trk_from_tmac, cam_from_board)
    inverted = motions_between([pose.inv() for pose in trk_from_tmac], cam_from_board)
    if _turn_misfit(inverted) < _FAR_BETTER * _turn_misfit(motions):
        return (
            "the readings' rotations fit once inverted: are they tmac_from_trk instead of"
            " trk_from_tmac, or is the quaternion's scalar in another place?"
        )
    factor, gain = _length_factor(motions)
    if gain < _FAR_BETTER:
        return (
            f"the T-MAC moved {factor:.4f} times as far as the camera saw: is the board's square_m"
            " right?"
        )
    return ""


def _length_factor(motions: Motions) -> tuple[float, float]:
    """Give how much farther the T-MAC moved than the camera, and how much better that fits.

    (R_A - I) t_X - s R_X t_B = -t_A is solved for t_X and s in the least-squares sense.

    Returns:
        The factor s, and the misfit with it as part of the misfit with s = 1.
    """
    rotation = align_directions(motions.turns_tmac, motions.turns_cam)
    by_lever = (motions.tmac.rotation.as_matrix() - np.eye(3)).reshape(-1, 3)
    seen = rotation.apply(motions.cam.translation).ravel()
    moved = motions.tmac.translation.ravel()
    free = np.column_stack([by_lever, -seen])
    solution, *_ = np.linalg.lstsq(free, -moved)
    lever, *_ = np.linalg.lstsq(by_lever, seen - moved)
    misfit = np.linalg.norm(free @ solution + moved)
    misfit_of_one = np.linalg.norm(by_lever @ lever - seen + moved)
    return float(solution[3]), float(misfit / max(misfit_of_one, np.finfo(float).tiny))


def _turn_misfit(motions: Motions) -> float:
    turns_tmac, turns_cam = motions.turns_tmac, motions.turns_cam
    rotation = align_directions(turns_tmac, turns_cam)
    return float(np.linalg.norm(turns_tmac - rotation.apply(turns_cam)))
