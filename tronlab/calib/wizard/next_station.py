"""Which station comes next: the one that makes the hand-eye transform best known.

What a station will tell is predicted from geometry alone: its Fisher information about hand-eye
transform, place and bow of the board, and the camera's intrinsics, the T-MAC's own error eliminated
(Hartley and Zisserman, Multiple View Geometry, 2004, ch. 5). Choosing the experiment that shrinks
the trace of a covariance is A-optimal design (Pukelsheim, Optimal Design of Experiments, 2006).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.calib.camera.board import BoardView, corner_points
from tronlab.calib.camera.bow import N_BOW, bow_basis
from tronlab.calib.camera.projection import free_intrinsics, project_with_jacobian
from tronlab.devices.laboratory import PatternSpec
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray

LEVER_M = 0.5
"""What one radian of the hand-eye's rotation weighs in metres of its translation: about the ratio
of what is wanted of the truth, 0.15 mm and 0.015 deg, and the distance to the board."""
CORNER_SIGMA_PX = 0.05
_EDGE_PX = 3.0
"""Corners nearer to the edge of the image are not found."""
_FREE = free_intrinsics("brown")
_HAND_EYE, _BOARD = slice(0, 6), slice(6, 12)
_LENS = slice(12, 12 + len(_FREE))
_BOW = slice(_LENS.stop, _LENS.stop + N_BOW)
N_UNKNOWNS = _BOW.stop
_PRIOR_SIGMA: FloatArray = np.array(
    [*([0.1] * 3 + [0.05] * 3) * 2, 20.0, 20.0, 20.0, 20.0, *[0.2] * (len(_FREE) - 4), *[1e-3] * 3]
)
"""How well all of it is known before the first station: rad and m of hand-eye and board, px and
coefficients of the lens, m of bow."""


@dataclass(frozen=True, slots=True)
class Outlook:
    """What is expected of a station, by design or from the stations so far."""

    pattern: PatternSpec
    camera: CameraModel
    tmac_from_cam: RigidTransform
    trs_from_board: RigidTransform
    pose_sigma: FloatArray
    """One sigma of a T-MAC reading: rotation vector, translation; shape (6,), rad and m."""
    corner_sigma_px: float = CORNER_SIGMA_PX

    def information_of(self, trs_from_cam: RigidTransform) -> FloatArray:
        """Give the information that a station there will have, shape (n, n) of the unknowns."""
        points = corner_points(self.pattern)
        uv = self.camera.project((trs_from_cam.inv() * self.trs_from_board).apply(points))
        size = np.array([self.camera.width_px, self.camera.height_px])
        is_seen = ((uv > _EDGE_PX) & (uv < size - 1 - _EDGE_PX)).all(axis=1)
        return self._information(trs_from_cam, points[is_seen])

    def information_from(self, trs_from_cam: RigidTransform, view: BoardView) -> FloatArray:
        """Give the information of a station whose corners were found, shape (n, n)."""
        return self._information(trs_from_cam, view.p_board_m)

    def _information(self, trs_from_cam: RigidTransform, p_board_m: FloatArray) -> FloatArray:
        if not len(p_board_m):
            return np.zeros((N_UNKNOWNS, N_UNKNOWNS))
        by_unknowns, by_reading = self._derivatives(trs_from_cam, p_board_m)
        by_unknowns = by_unknowns.reshape(-1, N_UNKNOWNS) / self.corner_sigma_px
        by_reading = by_reading.reshape(-1, 6) / self.corner_sigma_px
        reading = by_reading.T @ by_reading + np.diag(self.pose_sigma**-2.0)
        shared = by_unknowns.T @ by_reading
        return by_unknowns.T @ by_unknowns - shared @ np.linalg.solve(reading, shared.T)

    def _derivatives(
        self, trs_from_cam: RigidTransform, p_board_m: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Give d(uv) by the unknowns, (m, 2, n), and by an error of the reading, (m, 2, 6).

        p_cam = X^-1 S^-1 Y p_board with X = tmac_from_cam, S = trs_from_tmac, Y = trs_from_board; a
        small rotation turns about the axes of the parent frame.
        """
        trs_from_tmac = trs_from_cam * self.tmac_from_cam.inv()
        p_trs = self.trs_from_board.apply(p_board_m)
        p_cam = trs_from_cam.inv().apply(p_trs)
        _, by_cam, by_intrinsics = project_with_jacobian(self.camera, p_cam)
        by_tmac = by_cam @ self.tmac_from_cam.rotation.as_matrix().T
        by_trs = by_cam @ trs_from_cam.rotation.as_matrix().T
        from_camera = self.tmac_from_cam.apply(p_cam) - self.tmac_from_cam.translation
        unknowns = np.zeros((len(p_cam), 2, N_UNKNOWNS))
        unknowns[:, :, _HAND_EYE] = -_by_pose(by_tmac, from_camera)
        unknowns[:, :, _BOARD] = _by_pose(by_trs, p_trs - self.trs_from_board.translation)
        unknowns[:, :, _LENS] = by_intrinsics[:, :, _FREE]
        by_height = by_trs @ self.trs_from_board.rotation.as_matrix()[:, 2]
        unknowns[:, :, _BOW] = by_height[:, :, None] * bow_basis(p_board_m, self.pattern)[:, None]
        return unknowns, -_by_pose(by_trs, p_trs - trs_from_tmac.translation)


def covariance_of(informations: Sequence[FloatArray]) -> FloatArray:
    """Give the covariance of the hand-eye transform from stations with these informations.

    Returns:
        Of (rotation vector, translation) in tmac, shape (6, 6), rad and m.
    """
    units: FloatArray = np.outer(_PRIOR_SIGMA, _PRIOR_SIGMA)
    information: FloatArray = np.eye(N_UNKNOWNS) + _total(informations) * units
    covariance: FloatArray = np.linalg.inv(information) * units
    return covariance[_HAND_EYE, _HAND_EYE]


def weigh(covariance: FloatArray) -> float:
    """Give the length in metres that says how badly a hand-eye transform is known."""
    variances = np.diag(covariance)
    return float(np.sqrt(LEVER_M**2 * variances[:3].sum() + variances[3:].sum()))


def rank_stations(
    informations: Sequence[FloatArray], candidates: Sequence[FloatArray]
) -> list[tuple[float, int]]:
    """Rank candidates by how well the hand-eye transform would be known with each of them.

    Args:
        informations: Of the stations so far.
        candidates: Of each candidate.

    Returns:
        What ``weigh`` gives with it, metres, and the candidate's index; the best first.
    """
    so_far = _total(informations)
    return sorted((weigh(covariance_of([so_far, one])), i) for i, one in enumerate(candidates))


def _total(informations: Sequence[FloatArray]) -> FloatArray:
    return sum(informations, np.zeros((N_UNKNOWNS, N_UNKNOWNS)))


def _by_pose(by_point: FloatArray, arms: FloatArray) -> FloatArray:
    """Give d(uv) by a small (rotation vector, translation) of what carries the points."""
    # d(point) = dw x arm + dt, and b . (dw x arm) = dw . (arm x b)
    return np.concatenate([np.cross(arms[:, None], by_point), by_point], axis=2)
