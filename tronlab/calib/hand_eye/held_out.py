"""How well a solution predicts stations it has not seen.

Every fifth station is predicted by a solution of the others, five times over. These solutions lie
so close to the full one that one step of Gauss and Newton from there, without the rows of the
stations held out, reaches them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tronlab.calib.elimination import N_OWN, CommonRows, Elimination, Rows, eliminate
from tronlab.calib.hand_eye.bundle import BundleProblem, BundleState
from tronlab.errors import CalibrationError
from tronlab.geometry.poses import FloatArray, skew

N_FOLDS = 5
MIN_STATIONS = 6
"""With fewer, holding one out says more of the lack of stations than of the solution."""


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Errors of the stations held out, root mean squares of vectors' lengths."""

    n_stations: int
    rms_px: float
    """Of corners predicted from the tracker's reading."""
    position_rms_m: float
    """Of the camera centre: from the tracker's reading less from the image."""
    angle_rms_rad: float
    """Of the camera's rotation, likewise."""
    expected_position_rms_m: float
    """What the covariances predict."""
    expected_angle_rms_rad: float
    """What the covariances predict."""


def hold_out(problem: BundleProblem, state: BundleState) -> HeldOut | None:
    """Predict every station that counts by the others.

    Args:
        problem: The problem; only stations of trust 1 are held out.
        state: Its solution.

    Returns:
        None if there are fewer than ``MIN_STATIONS``, or without a fifth of them the others do not
        determine the solution.
    """
    stations = np.flatnonzero(problem.trust == 1.0)
    if len(stations) < MIN_STATIONS:
        return None
    rows = problem.rows(state)
    eliminated, linear = eliminate(rows), _Linear.of(problem, state, rows)
    predictions: list[_Prediction] = []
    for fold in range(N_FOLDS):
        held = stations[fold::N_FOLDS]
        is_held = np.isin(np.arange(len(rows.blocks)), held)
        try:
            common = eliminated.common(without=is_held)
        except CalibrationError:
            return None
        predictions.append(linear.predicted(common, held))
    return _held_out(predictions)


class _Prediction(NamedTuple):
    """Of the n stations of one fold."""

    gaps: FloatArray
    """Camera's pose by image less by reading, (rotation vector, translation) in trk, (n, 6)."""
    covariances: FloatArray
    """Of the gaps, shape (n, 6, 6)."""
    square_sums_px: FloatArray
    """Of the residuals of the corners predicted from the reading, shape (n,)."""
    n_corners: FloatArray
    """Shape (n,)."""


@dataclass(frozen=True, slots=True)
class _Linear:
    """What reading and image each say of a station's pose, made linear."""

    readings: FloatArray
    """[derivatives | residual] in units of the readings, shape (n_stations, 6, n_unknowns + 1)."""
    pixels: FloatArray
    """[derivatives | residual], pixels, shape (n_stations, m, n_unknowns + 1)."""
    n_corners: FloatArray
    """Shape (n_stations,)."""
    images: Elimination
    """Of the pixels alone."""
    to_camera: FloatArray
    """d(pose of the camera in trk) by what ``readings`` gives, shape (n_stations, 6, 6)."""

    @classmethod
    def of(cls, problem: BundleProblem, state: BundleState, rows: Rows) -> "_Linear":
        """Take the rows apart."""
        arms = problem.trk_from_tmac.rotation.apply(state.tmac_from_cam.translation)
        levers = np.tile(np.eye(6), (len(arms), 1, 1))
        levers[:, 3:, :3] = -skew(arms)
        return cls(
            readings=problem.reading_rows(state),
            pixels=rows.blocks[: problem.n_stations, 6:] / problem.pixel_weights.max(),
            n_corners=np.count_nonzero(problem.pixel_weights[: problem.n_stations], axis=1),
            images=eliminate(Rows(rows.blocks[:, 6:], rows.shared)),
            to_camera=levers @ np.linalg.inv(problem.pose_weights),
        )

    def predicted(self, common: CommonRows, held: NDArray[np.intp]) -> _Prediction:
        """Predict the stations held out from a solution of the others."""
        covariance = self.images.covariance(common.covariance)[held]
        derivatives, to_camera = self.readings[held, :, :-1], self.to_camera[held]
        gaps = self._after(self.readings, common, self.images.own_steps(common.step), held)
        covariances = np.eye(6) + derivatives @ covariance @ np.swapaxes(derivatives, 1, 2)
        pixels = self._after(self.pixels, common, self._steps_to_reading(common), held)
        return _Prediction(
            gaps=np.einsum("nij,nj->ni", to_camera, gaps),
            covariances=to_camera @ covariances @ np.swapaxes(to_camera, 1, 2),
            square_sums_px=(pixels**2).sum(axis=1),
            n_corners=self.n_corners[held],
        )

    def _steps_to_reading(self, common: CommonRows) -> FloatArray:
        """Give the steps of the views' poses to where reading and solution put them, (n, 6)."""
        known = self.readings[:, :, N_OWN:-1] @ common.step + self.readings[:, :, -1]
        steps = -np.linalg.solve(self.readings[:, :, :N_OWN], known[:, :, None])[:, :, 0]
        return np.asarray(steps, dtype=np.float64)

    @staticmethod
    def _after(
        rows: FloatArray, common: CommonRows, own: FloatArray, held: NDArray[np.intp]
    ) -> FloatArray:
        """Give the residuals after a step, shape (n_held, m)."""
        chosen = rows[held]
        moved = chosen[:, :, N_OWN:-1] @ common.step + chosen[:, :, -1]
        return moved + np.einsum("nij,nj->ni", chosen[:, :, :N_OWN], own[held])


def _held_out(folds: Sequence[_Prediction]) -> HeldOut:
    gaps, covariances, square_sums_px, n_corners = map(np.concatenate, zip(*folds, strict=True))
    expected = np.sqrt(np.einsum("nii->ni", covariances))
    return HeldOut(
        n_stations=len(gaps),
        rms_px=float(np.sqrt(square_sums_px.sum() / n_corners.sum())),
        position_rms_m=rms(gaps[:, 3:]),
        angle_rms_rad=rms(gaps[:, :3]),
        expected_position_rms_m=rms(expected[:, 3:]),
        expected_angle_rms_rad=rms(expected[:, :3]),
    )


def rms(vectors: FloatArray) -> float:
    """Give the root mean square of the vectors' lengths, shape (n, k)."""
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))
