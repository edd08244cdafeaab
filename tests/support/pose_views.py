"""Matches of a rough surface seen by a distorted camera, right ones and wrong ones."""

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.geometry.camera import CameraModel
from tronlab.geometry.uncertainty import perturb
from tronlab.nav.pose import Correspondences, residuals_px

CAMERA = CameraModel(1024, 1024, 744.0, 745.0, 511.0, 509.0, (-0.12, 0.05, 5e-4, -3e-4, 0.0))
TRUTH = RigidTransform.from_components(
    [1.1, 2.1, 2.5],
    Rotation.from_rotvec([0.03, -0.05, 0.1])
    * Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
)


def make_matches(
    rng: np.random.Generator,
    n: int,
    *,
    sigma_px: float = 0.0,
    n_wrong: int = 0,
    half_x: float = 0.55,
    half_y: float = 0.55,
    depth_m: tuple[float, float] = (2.3, 2.6),
) -> Correspondences:
    """Matches within so much of the optical axis; the first ``n_wrong`` show another point."""
    rays = rng.uniform(-1.0, 1.0, (n, 2)) * [half_x, half_y]
    p_cam = np.column_stack([rays, np.ones(n)]) * rng.uniform(*depth_m, (n, 1))
    p_trs = TRUTH.apply(p_cam)
    uv = CAMERA.project(p_cam) + rng.normal(0.0, 1.0, (n, 2)) * sigma_px
    p_trs[:n_wrong] = np.roll(p_trs[:n_wrong], 1, axis=0)
    return Correspondences(uv, CAMERA.rays(uv), p_trs, np.ones(n))


def numerical_jacobian_px(matches: Correspondences) -> np.ndarray:
    """Derivatives of the projection by the pose at the truth, shape (2 n, 6), by differences."""
    columns = [
        (
            residuals_px(perturb(TRUTH, -h), matches, CAMERA)
            - residuals_px(perturb(TRUTH, h), matches, CAMERA)
        ).ravel()
        / 2e-6
        for h in np.eye(6) * 1e-6
    ]
    return np.column_stack(columns)
