"""Motions between stations, seen from T-MAC and camera: what closed hand-eye forms rest on."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.errors import CalibrationError, DegenerateGeometryError
from tronlab.geometry.poses import FloatArray

Poses: TypeAlias = Sequence[RigidTransform] | RigidTransform
"""One a station; a RigidTransform of many poses spares the time to stack them."""

MIN_STATIONS = 3
MIN_TURN_RAD = np.radians(5.0)
"""Least root mean square of the turns between stations, about each of two axes."""
_LARGEST_TURN_RAD = np.radians(165.0)
"""A rotation vector near half a turn flips its sign by noise."""
_MAX_MOTIONS = 5000
"""Long streams have millions of pairs; an even choice of them says the same."""

_LEAST_FREE_PART = 1e-6
"""Of the motions' translations, below which they say nothing about scale."""
_SURE_SIGMAS = 5.0
_SAME_FACTOR = 0.2
"""Largest difference of the logarithms of two factors taken as one."""
_LARGE_MISFIT = 0.3
"""Of the turns of T-MAC and camera, relative: beyond any noise."""
_FAR_BETTER = 3.0


@dataclass(frozen=True, slots=True)
class Motions:
    """How both moved between two stations: ``tmac * X = X * cam`` with X = tmac_from_cam."""

    tmac: RigidTransform
    """Earlier T-MAC in the later one, n poses."""
    cam: RigidTransform
    """Earlier camera in the later one, n poses."""

    def __len__(self) -> int:
        return len(self.tmac)

    @property
    def turns_tmac(self) -> FloatArray:
        """Get the rotation vectors of the T-MAC, shape (n, 3)."""
        return self.tmac.rotation.as_rotvec()

    @property
    def turns_cam(self) -> FloatArray:
        """Get the rotation vectors of the camera, shape (n, 3)."""
        return self.cam.rotation.as_rotvec()


def motions_between(trk_from_tmac: Poses, cam_from_board: Poses) -> Motions:
    """Give the motion between every two stations, near half turns left out.

    Args:
        trk_from_tmac: Measured pose of the T-MAC at each station.
        cam_from_board: Pose of the board in the camera at each station.
    """
    tmac, cam = stack_poses(trk_from_tmac), stack_poses(cam_from_board)
    first, second = _pairs(len(tmac))
    motions_tmac = tmac[second].inv() * tmac[first]
    is_used = motions_tmac.rotation.magnitude() < _LARGEST_TURN_RAD
    motions_cam = cam[second[is_used]] * cam[first[is_used]].inv()
    return Motions(motions_tmac[is_used], motions_cam)


def stack_poses(poses: Poses) -> RigidTransform:
    """Give poses as one object of many."""
    if isinstance(poses, RigidTransform):
        return poses
    return RigidTransform.concatenate(list(poses))


def check_motions(trk_from_tmac: Poses) -> None:
    """Refuse stations that cannot determine a hand-eye transform.

    Args:
        trk_from_tmac: Measured pose of the T-MAC at each station.

    Raises:
        DegenerateGeometryError: Fewer than three stations, or the T-MAC turned about one axis only,
            or hardly at all (then part of the translation is undetermined), or all stations are
            about half a turn apart.
    """
    n = len(trk_from_tmac)
    if n < MIN_STATIONS:
        raise DegenerateGeometryError(
            f"hand-eye: {n} stations, at least {MIN_STATIONS} with turns about two axes needed"
        )
    turns = motions_between(trk_from_tmac, trk_from_tmac).turns_tmac
    if not len(turns):
        raise DegenerateGeometryError(
            "hand-eye: all stations are about half a turn apart; add stations in between"
        )
    _, spread, axes = np.linalg.svd(turns / np.sqrt(len(turns)), full_matrices=False)
    needed = f"at least {np.degrees(MIN_TURN_RAD):.0f} deg needed"
    if spread[0] < MIN_TURN_RAD:
        raise DegenerateGeometryError(
            f"hand-eye: the T-MAC turned by {np.degrees(spread[0]):.2f} deg between stations"
            f" ({needed}); turn it about two axes"
        )
    # A single motion has a single axis: its two rows of zeros are not in the decomposition.
    second = spread[1] if len(spread) > 1 else 0.0
    if second < MIN_TURN_RAD:
        axis = ", ".join(f"{value:.2f}" for value in axes[0])
        raise DegenerateGeometryError(
            f"hand-eye: all turns are about the same axis ({axis}) of tmac, within"
            f" {np.degrees(second):.2f} deg ({needed}): the translation along it is not"
            " determined; turn the T-MAC about a second axis"
        )


def motion_scale(motions: Motions, n_stations: int) -> tuple[float, float]:
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
    if np.linalg.norm(free) < _LEAST_FREE_PART * np.linalg.norm(by_scale):
        return 1.0, np.inf
    moved = motions.tmac.translation.ravel()
    moved = moved - basis @ (basis.T @ moved)
    scale = float(free @ moved / (free @ free))
    residual = moved - scale * free
    variance = float(residual @ residual) / len(moved) / float(free @ free)
    return scale, float(np.sqrt(variance * max(1.0, len(motions) / n_stations)))


def is_one_inverted(trk_from_tmac: Poses, cam_from_board: Poses) -> bool:
    """Tell whether the turns of T-MAC and camera agree only if one of the two is inverted."""
    stacked = stack_poses(cam_from_board)
    misfits = [_misfit(motions_between(trk_from_tmac, cam)) for cam in (stacked, stacked.inv())]
    return misfits[0] > _LARGE_MISFIT > _FAR_BETTER * misfits[1]


def check_agreement(trk_from_tmac: Poses, cam_from_board: Poses) -> None:
    """Refuse poses of T-MAC and board that cannot be of the same stations as they are written.

    Args:
        trk_from_tmac: Measured pose of the T-MAC at each station.
        cam_from_board: Pose of the board in the camera at each station.

    Raises:
        CalibrationError: One is in millimetres, one is mirrored, one is written the other way round
            (board_from_cam, tmac_from_trk), or they have nothing in common.
    """
    if is_one_inverted(trk_from_tmac, cam_from_board):
        raise CalibrationError(
            "hand-eye: the turns of T-MAC and camera agree only if one of the two is inverted;"
            " give the T-MAC in the tracker and the board in the camera, or say that the board is"
            " on the hand"
        )
    motions = motions_between(trk_from_tmac, cam_from_board)
    if (misfit := _misfit(motions)) > _LARGE_MISFIT:
        raise CalibrationError(
            f"hand-eye: the turns of T-MAC and camera differ by {misfit:.0%}, at most"
            f" {_LARGE_MISFIT:.0%} can be noise; are the poses of the same moments, in the same"
            " order, and is the quaternion's scalar last?"
        )
    scale, sigma = motion_scale(motions, len(trk_from_tmac))
    if abs(scale - 1.0) < _SURE_SIGMAS * sigma:
        return
    for factor, larger, smaller in ((1e3, "T-MAC", "board"), (1e-3, "board", "T-MAC")):
        if abs(np.log(abs(scale) / factor)) < _SAME_FACTOR:
            raise CalibrationError(
                f"hand-eye: the T-MAC moves {abs(scale):.4g} times as far as the camera: the poses"
                f" of the {larger} seem to be in millimetres, those of the {smaller} in metres;"
                " give both in metres"
            )
    if abs(np.log(abs(scale))) < _SAME_FACTOR and scale < 0:
        raise CalibrationError(
            f"hand-eye: the motions of T-MAC and camera fit each other mirrored only (scale"
            f" {scale:.3f}): the image, the board or one of the frames is mirrored, or left-handed"
        )


def align_directions(a: FloatArray, b: FloatArray) -> Rotation:
    """Find R with a = R b in the least-squares sense, vectors of shape (n, 3)."""
    u, _, vt = np.linalg.svd(a.T @ b)
    handed = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    return Rotation.from_matrix(u @ handed @ vt)


def _pairs(n: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    first, second = np.triu_indices(n, k=1)
    if len(first) > _MAX_MOTIONS:
        chosen = np.linspace(0, len(first) - 1, _MAX_MOTIONS).astype(np.intp)
        return first[chosen], second[chosen]
    return first, second


def _misfit(motions: Motions) -> float:
    """Give the median difference of the turns after they are aligned, relative to the turns."""
    turns_tmac, turns_cam = motions.turns_tmac, motions.turns_cam
    differences = turns_tmac - align_directions(turns_tmac, turns_cam).apply(turns_cam)
    lengths = np.linalg.norm(turns_tmac, axis=1)
    return float(np.median(np.linalg.norm(differences, axis=1)) / np.median(lengths))
