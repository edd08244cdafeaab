"""What the uncertainty of the intrinsics means in the image.

Errors of the intrinsics go together with errors of the camera's pose: a wrong principal point is
nearly a camera turned a little, and whoever solves for poses with these intrinsics absorbs it so.
What counts is what is left when the camera may turn (and, for a board at some distance, move): the
idea of mrcal's projection uncertainty (D. Kogan, mrcal.secretsauce.net/uncertainty.html).
"""

import numpy as np

from tronlab.calib.camera.projection import project_with_jacobian
from tronlab.calib.results import CameraResult
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray, skew

_GRID = 21
"""The turn is what fits best at GRID x GRID points of the image."""


def projection_sigma_px(
    result: CameraResult, uv: FloatArray, *, distance_m: float | None = None
) -> FloatArray:
    """Give how well the calibrated camera knows where it projects a direction to.

    Args:
        result: The camera and its covariance.
        uv: Where in the image, shape (n, 2).
        distance_m: Of a plane square to the optical axis, on which a movement of the camera is
            left out as well; None for directions alone.

    Returns:
        One sigma of a coordinate, root mean square of the two, shape (n,), pixels.
    """
    camera = result.camera
    by_intrinsics, by_pose = _derivatives(camera, _grid(camera), distance_m)
    columns = by_pose.shape[2]
    absorbed = np.linalg.lstsq(
        by_pose.reshape(-1, columns), by_intrinsics.reshape(-1, by_intrinsics.shape[2])
    )[0]
    by_intrinsics, by_pose = _derivatives(camera, uv, distance_m)
    left = by_intrinsics - by_pose @ absorbed
    variances = np.einsum("nij,jk,nik->n", left, result.covariance, left)
    return np.sqrt(np.maximum(variances, 0.0) / 2)


def _grid(camera: CameraModel) -> FloatArray:
    u, v = np.meshgrid(
        np.linspace(0, camera.width_px - 1, _GRID), np.linspace(0, camera.height_px - 1, _GRID)
    )
    return np.stack([u.ravel(), v.ravel()], axis=1)


def _derivatives(
    camera: CameraModel, uv: FloatArray, distance_m: float | None
) -> tuple[FloatArray, FloatArray]:
    """Give d(uv) by the intrinsics, (n, 2, 12), and by turn and movement, (n, 2, 3 or 6)."""
    p_cam = np.column_stack([camera.rays(uv), np.ones(len(uv))]) * (distance_m or 1.0)
    _, by_point, by_intrinsics = project_with_jacobian(camera, p_cam)
    by_turn = by_point @ skew(p_cam)
    if distance_m is None:
        return by_intrinsics, by_turn
    return by_intrinsics, np.concatenate([by_turn, by_point], axis=2)
