"""Station by station, the camera's pose by the tracker against that by the image of the board."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.calib.camera.bow import bowed
from tronlab.calib.camera.projection import project_with_jacobian
from tronlab.calib.camera.view_residuals import view_residuals
from tronlab.calib.inputs import Inputs, StationsInput
from tronlab.calib.results import CameraResult, Results
from tronlab.geometry.poses import FloatArray, pose_from_xyz_quat
from tronlab.geometry.uncertainty import compose_covariance, inverse_covariance, pose_difference


@dataclass(frozen=True, slots=True)
class StationGaps:
    """What leads from the pose by the tracker to the pose by the image."""

    gaps: FloatArray
    """(rotation vector, translation of the camera's centre) in trk, shape (n, 6), rad and m."""
    covariances: FloatArray
    """Of ``gaps`` by the reading and the corners of the station, shape (n, 6, 6); how uncertain
    camera, board and hand-eye transform are, which all stations share, is not in it."""
    is_outlier: NDArray[np.bool_]
    """Stations that were left out of the solution, shape (n,)."""


def station_gaps(inputs: Inputs, results: Results) -> StationGaps | None:
    """Hold the tracker's readings against the images.

    Returns:
        None if the record has no stations, or no camera and hand-eye transform from them.
    """
    measured, camera, hand_eye = inputs.hand_eye, results.camera, results.hand_eye
    if not isinstance(measured, StationsInput) or camera is None or hand_eye is None:
        return None
    trk_from_board = pose_from_xyz_quat(hand_eye.statistics["trk_from_board"])
    sigma_px = float(hand_eye.statistics["corner_sigma_px"])
    still, gaps, covariances = np.zeros((6, 6)), [], []
    for station, seen in zip(measured.stations, view_residuals(inputs, camera), strict=False):
        reading, view = station.reading.reading, station.view.view(measured.pattern)
        by_tracker = reading.trk_from_tmac * hand_eye.tmac_from_cam
        cam_from_board = seen.cam_from_board
        board_from_cam = cam_from_board.inv()
        gaps.append(pose_difference(by_tracker, trk_from_board * board_from_cam))
        bowed_m = bowed(view.p_board_m, measured.pattern, camera.bow_m)
        of_view = sigma_px**2 * _resection_covariance(camera, cam_from_board, bowed_m)
        covariances.append(
            compose_covariance(
                reading.trk_from_tmac, reading.covariance, hand_eye.tmac_from_cam, still
            )
            + compose_covariance(
                trk_from_board, still, board_from_cam, inverse_covariance(cam_from_board, of_view)
            )
        )
    left_out = set(hand_eye.statistics.get("outlier_stations", ()))
    return StationGaps(
        gaps=np.array(gaps),
        covariances=np.array(covariances),
        is_outlier=np.array([i in left_out for i in range(len(gaps))]),
    )


def _resection_covariance(
    camera: CameraResult, cam_from_board: RigidTransform, p_board_m: FloatArray
) -> FloatArray:
    """Give the covariance (6, 6) of ``cam_from_board`` by corners of one pixel each."""
    p_cam = cam_from_board.apply(p_board_m)
    _, by_point, _ = project_with_jacobian(camera.camera, p_cam)
    from_origin = p_cam - cam_from_board.translation
    by_turn = np.cross(from_origin[:, None], by_point)
    jacobian = np.concatenate([by_turn, by_point], axis=2).reshape(-1, 6)
    return np.asarray(np.linalg.inv(jacobian.T @ jacobian), dtype=np.float64)
