import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.campaign.brightness import LightModel
from tronlab.geometry.camera import CameraModel
from tronlab.render.heightfield import HeightfieldRenderer
from tronlab.render.mask import model_mask
from tronlab.render.renderer import Lamp
from tronlab.terrain.heightmap import HeightMap

CAMERA = CameraModel(512, 384, 500.0, 500.0, 250.0, 195.0, distortion=(-0.05, 0.01))
DOWN = Rotation.from_euler("x", 180, degrees=True)


def light_model(heights_m: np.ndarray, *, lamp_trs_m: tuple[float, float, float]) -> LightModel:
    heightmap = HeightMap(heights_m.astype(np.float32), 0.02, np.array([-1.0, -1.0, 0.0]))
    return LightModel(
        HeightfieldRenderer(heightmap, n_threads=1),
        heightmap,
        CAMERA,
        Lamp(p_trs_m=np.array(lamp_trs_m), intensity=3.0),
        "lambert",
    )


def test_flat_ground_is_as_bright_as_lambert_says() -> None:
    camera_m, lamp_m = 1.5, 4.0
    model = light_model(np.zeros((101, 101)), lamp_trs_m=(0.0, 0.0, lamp_m))
    pose = RigidTransform.from_components([0, 0, camera_m], DOWN)
    # a surface at a distance of r, tilted by theta: intensity * cos(theta) / r^2
    ground_m = camera_m * CAMERA.ray_table()
    cube = (lamp_m**2 + (ground_m**2).sum(axis=-1)) ** 1.5
    assert model.mean_radiance(pose) == pytest.approx((3.0 * lamp_m / cube).mean(), rel=2e-3)


def test_small_rendering_is_as_bright_as_a_whole_one() -> None:
    rng = np.random.default_rng(0)
    steps = np.cumsum(rng.normal(0.0, 0.003, (101, 101)), axis=0)
    model = light_model(steps, lamp_trs_m=(-3.0, 1.0, 1.2))
    turned = Rotation.from_euler("xy", [165, 10], degrees=True)
    pose = RigidTransform.from_components([0.1, -0.3, 1.8], turned)
    whole = model.renderer.render(CAMERA, pose, model.lamp).radiance
    mask = model_mask(model.heightmap, CAMERA, pose)
    assert 0.3 < mask.mean() < 0.95  # an edge of the model is in view
    assert model.mean_radiance(pose) == pytest.approx(whole[mask].mean(), rel=0.05)


def test_nothing_is_predicted_where_nothing_lit_is_seen() -> None:
    model = light_model(np.zeros((101, 101)), lamp_trs_m=(0.0, 0.0, 4.0))
    away = RigidTransform.from_translation([0, 0, 2.0])
    assert model.mean_radiance(away) is None
    dark = light_model(np.zeros((101, 101)), lamp_trs_m=(0.0, 0.0, -1.0))
    assert dark.mean_radiance(RigidTransform.from_components([0, 0, 2.0], DOWN)) is None
