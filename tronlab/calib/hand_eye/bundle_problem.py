"""What stations and views say of camera, board and hand-eye transform, as equations.

Unknown are the intrinsics, the board's bow, ``tmac_from_cam``, ``trk_from_board``, and of each view
the pose ``cam_from_board``. Pixels bind the camera, bow and the view's pose; the tracker's reading
binds the view's pose through hand-eye transform and board. So each measurement counts by its own
noise, and what stays uncertain comes out with its covariance. A view without a reading is free: it
serves the camera alone.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.calib.camera.board import BoardView
from tronlab.calib.camera.bow import N_BOW, bow_basis
from tronlab.calib.camera.fit import prior_information
from tronlab.calib.camera.projection import (
    N_INTRINSICS,
    intrinsics_of,
    project_with_jacobian,
    with_intrinsics,
)
from tronlab.calib.elimination import N_OWN, Rows
from tronlab.devices.laboratory import PatternSpec
from tronlab.devices.readings import PoseReading
from tronlab.errors import CalibrationError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray, skew


@dataclass(frozen=True, slots=True)
class Station:
    """What was measured while the robot stood still."""

    reading: PoseReading
    view: BoardView


@dataclass(frozen=True, slots=True)
class BundleState:
    """The unknowns as values."""

    camera: CameraModel
    bow_m: FloatArray
    """Shape (3,)."""
    tmac_from_cam: RigidTransform
    trk_from_board: RigidTransform
    cam_from_board: RigidTransform
    """Of each view: n_views poses."""


@dataclass(frozen=True, slots=True)
class BundleProblem:
    """What was measured, laid out view by view, stations first; implements ``Problem``."""

    free: NDArray[np.intp]
    """Which of intrinsics and bow are unknown, as in ``CameraKind.free``."""
    p_board_m: FloatArray
    """Corners on the flat board, shape (n_views, n_most, 3); where a view has fewer, its first."""
    bow_basis: FloatArray
    """Shape (n_views, n_most, 3)."""
    uv_px: FloatArray
    """Shape (n_views, n_most, 2)."""
    pixel_weights: FloatArray
    """One by sigma, or 0 where there is no corner, shape (n_views, n_most)."""
    trk_from_tmac: RigidTransform
    """As the tracker read them, n_stations poses."""
    pose_weights: FloatArray
    """W with W^T W the inverse covariance of each reading, shape (n_stations, 6, 6)."""
    trust: FloatArray
    """From 0 to 1, how much each reading counts, shape (n_stations,)."""

    @property
    def n_stations(self) -> int:
        """Get the number of readings."""
        return len(self.trust)

    @property
    def n_common(self) -> int:
        """Get the number of unknowns that the views share."""
        return len(self.free) + 12

    @property
    def hand_eye(self) -> slice:
        """Get where the hand-eye transform is among the common unknowns; the board follows."""
        return slice(len(self.free), len(self.free) + 6)

    @property
    def priors(self) -> FloatArray:
        """Get one by sigma of what is known before of ``free``, 0 if nothing, shape (n_free,)."""
        return np.sqrt(prior_information(sigma_px=1.0)[self.free])

    def trusting(self, trust: FloatArray) -> "BundleProblem":
        """Give the same problem with other trust in the readings, shape (n_stations,)."""
        return replace(self, trust=trust)

    def moved(self, state: BundleState, own: FloatArray, common: FloatArray) -> BundleState:
        """Give the state after a step; see ``Problem``."""
        lens_and_bow = _lens_and_bow(state)
        lens_and_bow[self.free] += common[: len(self.free)]
        return BundleState(
            camera=with_intrinsics(state.camera, lens_and_bow[:N_INTRINSICS]),
            bow_m=lens_and_bow[N_INTRINSICS:],
            tmac_from_cam=_moved(state.tmac_from_cam, common[self.hand_eye]),
            trk_from_board=_moved(state.trk_from_board, common[self.hand_eye.stop :]),
            cam_from_board=_moved(state.cam_from_board, own),
        )

    def rows(self, state: BundleState) -> Rows:
        """Give the problem made linear; see ``Problem``."""
        n_views, n_most = self.pixel_weights.shape
        blocks = np.zeros((n_views, 6 + 2 * n_most, N_OWN + self.n_common + 1))
        blocks[: self.n_stations, :6] = np.sqrt(self.trust)[:, None, None] * self.reading_rows(
            state
        )
        blocks[:, 6:] = self._pixel_rows(state)
        shared = np.zeros((len(self.free), self.n_common + 1))
        shared[:, : len(self.free)] = np.diag(self.priors)
        shared[:, -1] = self.priors * _lens_and_bow(state)[self.free]
        return Rows(blocks, shared)

    def corrections(self, state: BundleState) -> FloatArray:
        """Give what leads from each reading to its estimate, (rotation vector, translation) in trk.

        Returns:
            Shape (n_stations, 6), rad and m.
        """
        return self._corrections(self._estimates(state)[1])

    def reading_rows(self, state: BundleState) -> FloatArray:
        """Give the rows of the readings, each as if fully trusted.

        The estimate is trk_from_board * board_from_cam * cam_from_tmac; a pose's small rotation
        turns about its parent's axes, so that of a vector v the derivative is -[v]x.

        Returns:
            [by own | by common unknowns | residual], shape (n_stations, 6, 6 + n_common + 1).
        """
        trk_from_cam, estimates = self._estimates(state)
        corrections = self._corrections(estimates)
        cam_from_board = state.cam_from_board[: self.n_stations]
        tmac_in_cam = state.tmac_from_cam.inv().translation
        turn, turn_of_cam = estimates[:, :3, :3], trk_from_cam[:, :3, :3]
        lever_cam = skew(tmac_in_cam - cam_from_board.translation)
        lever_tmac = skew(state.tmac_from_cam.translation[None])
        lever_trk = skew(estimates[:, :3, 3] - state.trk_from_board.translation)
        rows = np.zeros((self.n_stations, 6, N_OWN + self.n_common + 1))
        own = slice(0, N_OWN)
        hand_eye = slice(N_OWN + self.hand_eye.start, N_OWN + self.hand_eye.stop)
        board = slice(hand_eye.stop, hand_eye.stop + 6)
        rows[:, :, own] = _by_pose(-turn_of_cam, turn_of_cam @ lever_cam)
        rows[:, :, hand_eye] = _by_pose(-turn, -turn @ lever_tmac)
        rows[:, :, board] = _by_pose(np.broadcast_to(np.eye(3), turn.shape), -lever_trk)
        rows[:, :3] = _by_turn(corrections[:, :3]) @ rows[:, :3]
        rows[:, :, -1] = corrections
        return self.pose_weights @ rows

    def _estimates(self, state: BundleState) -> tuple[FloatArray, FloatArray]:
        """Give trk_from_cam and trk_from_tmac of each station without its reading, (n, 4, 4)."""
        board_from_cam = state.cam_from_board[: self.n_stations].inv().as_matrix()
        trk_from_cam = state.trk_from_board.as_matrix() @ board_from_cam
        return trk_from_cam, trk_from_cam @ state.tmac_from_cam.inv().as_matrix()

    def _corrections(self, estimates: FloatArray) -> FloatArray:
        read = self.trk_from_tmac.as_matrix()
        turns = estimates[:, :3, :3] @ np.swapaxes(read[:, :3, :3], 1, 2)
        rotvecs = Rotation.from_matrix(turns).as_rotvec()
        return np.concatenate([rotvecs, estimates[:, :3, 3] - read[:, :3, 3]], axis=1)

    def _pixel_rows(self, state: BundleState) -> FloatArray:
        """Give [derivatives | residual], shape (n_views, 2 n_most, 6 + n_common + 1)."""
        n_views, n_most = self.pixel_weights.shape
        from_board = self._turned(state)
        p_cam = from_board + state.cam_from_board.translation[:, None]
        uv, by_point, by_intrinsics = project_with_jacobian(state.camera, p_cam.reshape(-1, 3))
        rows = np.zeros((n_views * n_most, 2, N_OWN + self.n_common + 1))
        rows[:, :, :3] = -by_point @ skew(from_board.reshape(-1, 3))
        rows[:, :, 3:6] = by_point
        normals = state.cam_from_board.rotation.as_matrix()[:, :, 2]
        by_height = by_point @ np.repeat(normals, n_most, axis=0)[:, :, None]
        by_bow = by_height * self.bow_basis.reshape(-1, 1, N_BOW)
        by_lens_and_bow = np.concatenate([by_intrinsics, by_bow], axis=2)
        rows[:, :, N_OWN : N_OWN + len(self.free)] = by_lens_and_bow[:, :, self.free]
        rows[:, :, -1] = uv - self.uv_px.reshape(-1, 2)
        rows *= self.pixel_weights.reshape(-1, 1, 1)
        return rows.reshape(n_views, 2 * n_most, -1)

    def residuals_px(self, state: BundleState) -> tuple[FloatArray, ...]:
        """Give projected minus detected corners of each view, shape (n, 2)."""
        p_cam = self._turned(state) + state.cam_from_board.translation[:, None]
        uv = state.camera.project(p_cam.reshape(-1, 3)).reshape(self.uv_px.shape)
        return tuple(
            difference[weights > 0]
            for difference, weights in zip(uv - self.uv_px, self.pixel_weights, strict=True)
        )

    def _turned(self, state: BundleState) -> FloatArray:
        """Give the corners from the board's origin along the axes of cam, (n_views, n_most, 3)."""
        points = self.p_board_m.copy()
        points[:, :, 2] += self.bow_basis @ state.bow_m
        return points @ np.swapaxes(state.cam_from_board.rotation.as_matrix(), 1, 2)


def make_problem(
    stations: Mapping[int, Station],
    free_views: Sequence[BoardView],
    pattern: PatternSpec,
    *,
    free: NDArray[np.intp],
    sigma_px: float,
) -> BundleProblem:
    """Lay out what was measured.

    Args:
        stations: Readings and views, by the number errors call them by.
        free_views: Views of the same board without a reading.
        pattern: The board.
        free: Which of intrinsics and bow are unknown, as in ``CameraKind.free``.
        sigma_px: One sigma of a corner's coordinate.

    Raises:
        CalibrationError: A reading without a usable covariance.
    """
    views = [*(station.view for station in stations.values()), *free_views]
    n_most = max(len(view) for view in views)
    kept = [np.pad(np.arange(len(view)), (0, n_most - len(view))) for view in views]
    p_board = np.stack([view.p_board_m[i] for view, i in zip(views, kept, strict=True)])
    is_corner = np.arange(n_most) < np.array([len(view) for view in views])[:, None]
    basis = bow_basis(p_board.reshape(-1, 3), pattern)
    poses = [station.reading.trk_from_tmac for station in stations.values()]
    return BundleProblem(
        free=free,
        p_board_m=p_board,
        bow_basis=basis.reshape(p_board.shape),
        uv_px=np.stack([view.uv_px[i] for view, i in zip(views, kept, strict=True)]),
        pixel_weights=is_corner / sigma_px,
        trk_from_tmac=RigidTransform.concatenate(poses),
        pose_weights=np.stack([_weight(i, station) for i, station in stations.items()]),
        trust=np.ones(len(stations)),
    )


def _weight(i: int, station: Station) -> FloatArray:
    covariance = station.reading.covariance
    try:
        return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), dtype=np.float64)
    except np.linalg.LinAlgError:
        raise CalibrationError(
            f"hand-eye: the covariance of the tracker's reading at station {i} is not positive"
            f" definite (its diagonal is {np.diag(covariance).tolist()}, rad^2 and m^2)"
        ) from None


def _lens_and_bow(state: BundleState) -> FloatArray:
    """Give intrinsics and bow, shape (15,), in the order of ``CameraKind.free``."""
    return np.concatenate([intrinsics_of(state.camera), state.bow_m])


def _moved(pose: RigidTransform, step: FloatArray) -> RigidTransform:
    """Apply (rotation vector, translation) in the parent frame, (6,) or (n, 6) for n poses."""
    rotation = Rotation.from_rotvec(step[..., :3]) * pose.rotation
    return RigidTransform.from_components(pose.translation + step[..., 3:], rotation)


def _by_pose(turn: FloatArray, shift_by_turn: FloatArray) -> FloatArray:
    """Give d(turn, shift) by a pose whose shift moves as its turn turns, shape (n, 6, 6)."""
    rows = np.zeros((len(turn), 6, 6))
    rows[:, :3, :3] = rows[:, 3:, 3:] = turn
    rows[:, 3:, :3] = shift_by_turn
    return rows


def _by_turn(rotvecs: FloatArray) -> FloatArray:
    """Give d(rotation vector) by a small turn from the left, shape (n, 3, 3), for small vectors.

    The inverse left Jacobian of SO(3) to second order (Chirikjian, Stochastic Models, Information
    Theory, and Lie Groups, vol. 2, 2012).
    """
    crosses = skew(rotvecs)
    return np.eye(3) - crosses / 2 + crosses @ crosses / 12
