"""A textured hilly plane seen by a distorted camera: exact images, depth and poses."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.dataset.records import ReferenceView
from tronlab.geometry.camera import CameraModel

LOOKING_DOWN = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
CAMERA = CameraModel(320, 288, 250.0, 251.0, 158.3, 144.9, (-0.11, 0.04, 4e-4, -3e-4, 0.0))
SIDE_M = 3.0


class Scene:
    """A square of SIDE_M around the origin of trs, brightness and height smooth functions of it."""

    def __init__(self, seed: int = 3) -> None:
        rng = np.random.default_rng(seed)
        fine = cv2.GaussianBlur(rng.normal(size=(1200, 1200)).astype(np.float32), (0, 0), 4)
        coarse = cv2.GaussianBlur(rng.normal(size=(1200, 1200)).astype(np.float32), (0, 0), 12)
        self._texture = fine / fine.std() + coarse / coarse.std()

    def height_m(self, x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
        return 0.08 * np.sin(3.0 * x_m) * np.cos(2.5 * y_m)

    def see(
        self, trs_from_cam: RigidTransform, camera: CameraModel = CAMERA
    ) -> tuple[np.ndarray, np.ndarray]:
        """Give grey values (float, about 0 to 255) and depth (NaN beside the square)."""
        rays = camera.ray_table()
        directions = np.concatenate([rays, np.ones((*camera.shape, 1))], axis=-1)
        directions = directions @ trs_from_cam.rotation.as_matrix().T
        start = trs_from_cam.translation
        depth = np.full(camera.shape, start[2])
        for _ in range(25):
            p = start + directions * depth[..., None]
            depth += (p[..., 2] - self.height_m(p[..., 0], p[..., 1])) / -directions[..., 2]
        p = start + directions * depth[..., None]
        texel = ((p[..., :2] / SIDE_M + 0.5) * 1199).astype(np.float32)
        bright = cv2.remap(
            self._texture, texel[..., 1], texel[..., 0], cv2.INTER_CUBIC, borderValue=-9
        )
        inside = (np.abs(p[..., :2]) < SIDE_M / 2).all(axis=-1)
        grey = np.where(inside, np.clip(120 + 40 * bright, 0, 255), 0)
        return grey, np.where(inside, depth, np.nan)


@pytest.fixture(scope="session")
def scene() -> Scene:
    return Scene()


@pytest.fixture(scope="session")
def camera() -> CameraModel:
    return CAMERA


@pytest.fixture(scope="session")
def pose() -> Callable[..., RigidTransform]:
    """``pose(z_m, x_m=0, y_m=0, tilt=(0, 0, 0))`` looks down on the scene."""

    def make(
        z_m: float, *, x_m: float = 0.0, y_m: float = 0.0, tilt: tuple[float, ...] = (0, 0, 0)
    ) -> RigidTransform:
        rotation = Rotation.from_rotvec(tilt) * LOOKING_DOWN
        return RigidTransform.from_components([x_m, y_m, z_m], rotation)

    return make


@pytest.fixture(scope="session")
def references(scene: Scene, pose: Callable[..., RigidTransform]) -> tuple[ReferenceView, ...]:
    views: list[ReferenceView] = []
    for i, z_m in enumerate((2.4, 2.0, 1.7)):
        grey, depth = scene.see(pose(z_m))
        image = np.rint(grey).astype(np.uint8)
        mask = np.isfinite(depth)
        views.append(ReferenceView(i, pose(z_m), image, depth.astype(np.float32), mask))
    return tuple(views)
