import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import pose_along_boresight
from tronlab.render.heightfield import HeightfieldRenderer
from tronlab.render.mask import model_mask
from tronlab.render.renderer import Lamp
from tronlab.terrain.heightmap import HeightMap

POSES = {
    "nadir": pose_along_boresight((0.2, 0.3, 0.9), boresight=(0, 0, -1), right=(0, 1, 0)),
    "oblique": pose_along_boresight((-0.3, 0.1, 0.4), boresight=(0.8, 0.3, -0.5), right=(0, 1, 0)),
    "horizon in view": pose_along_boresight((-0.2, 0.3, 0.2), boresight=(1, 0, 0), right=(0, 1, 0)),
}


@pytest.mark.parametrize("pose", POSES.values(), ids=POSES)
def test_the_mask_is_what_a_flat_model_covers(heightmap, camera, pose):
    height = np.float32(heightmap.mean_height_trs_m - heightmap.origin_trs_m[2])
    flat = HeightMap(
        np.full_like(heightmap.height_m, height), heightmap.spacing_m, heightmap.origin_trs_m
    )
    seen = HeightfieldRenderer(flat).render(camera, pose, Lamp(np.array([0, 0, 9.0]), 1.0)).depth_m
    mask = model_mask(heightmap, camera, pose)
    assert mask.shape == camera.shape
    assert mask.dtype == np.bool_
    assert 0.02 < mask.mean() < 0.98
    np.testing.assert_array_equal(mask, np.isfinite(seen))


def test_corners_of_the_outline_are_where_the_camera_projects_them(heightmap, camera):
    pose = POSES["nadir"]
    mask = model_mask(heightmap, camera, pose)
    x, y = heightmap.size_m
    corners = np.array([[0, 0, 0], [0, y, 0], [x, y, 0], [x, 0, 0]]) + heightmap.origin_trs_m
    corners[:, 2] = heightmap.mean_height_trs_m
    uv = camera.project(pose.inv().apply(corners))
    towards_middle = np.sign(uv.mean(axis=0) - uv)
    for corner, inward in zip(uv, towards_middle, strict=True):
        inside, outside = np.round(corner + 2 * inward), np.round(corner - 2 * inward)
        assert mask[int(inside[1]), int(inside[0])]
        assert not mask[int(outside[1]), int(outside[0])]


@pytest.mark.parametrize("boresight", [(0, 0, 1), (-1, 0, 0.5)])
def test_a_camera_that_looks_away_sees_nothing(heightmap, boresight):
    narrow = CameraModel(50, 40, 200.0, 200.0, 24.5, 19.5)
    pose = pose_along_boresight((0.2, 0.3, 0.9), boresight=boresight, right=(0, 1, 0))
    assert not model_mask(heightmap, narrow, pose).any()


def test_a_camera_in_the_plane_of_the_model_sees_nothing(heightmap, camera):
    pose = RigidTransform.from_translation([0.0, 0.0, heightmap.mean_height_trs_m])
    assert not model_mask(heightmap, camera, pose).any()
