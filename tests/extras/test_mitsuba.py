"""The renderer mitsuba against geometry, the formulas and the reference renderer."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest

from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import pose_along_boresight
from tronlab.render import photometry
from tronlab.render.photometry import Hapke, Lambert, LommelSeeliger, LunarLambert
from tronlab.render.reference import ReferenceRenderer
from tronlab.render.registry import open_renderer
from tronlab.render.renderer import Lamp, RenderError, SpotCone
from tronlab.render.settings import RenderSettings
from tronlab.terrain.heightmap import HeightMap

# Not importorskip: imported before the renderer says where LLVM is, Dr.Jit takes the system's.
pytestmark = pytest.mark.skipif(find_spec("mitsuba") is None, reason="needs the extra 'mitsuba'")

CAMERA = CameraModel(90, 70, 100.0, 101.0, 44.0, 36.0, (-0.15, 0.05, 0.001, -0.0008))
SPACING_M = 0.01
ORIGIN_M = np.array([1.2, -0.7, 0.3])
SLOPE = np.array([0.2, -0.1])
LAMP = Lamp(np.array([0.2, -1.5, 2.0]), 3.0)
OBLIQUE = pose_along_boresight((1.7, -0.1, 1.3), boresight=(0.3, 0.1, -1), right=(0, 1, 0))


def height_map(height_m) -> HeightMap:
    return HeightMap(np.asarray(height_m, dtype=np.float32), SPACING_M, ORIGIN_M)


@pytest.fixture(scope="module")
def plane() -> HeightMap:
    """A tilted plane of 2 x 1.6 m."""
    i, j = np.ogrid[:201, :161]
    return height_map((i * SLOPE[0] + j * SLOPE[1]) * SPACING_M)


@pytest.fixture(scope="module")
def rough() -> HeightMap:
    """Steps and waves of 1 x 1.2 m, with shadows at all scales."""
    i, j = np.ogrid[:101, :121]
    waves = 0.04 * np.sin(i * 0.21 + 0.1 * j) * np.cos(j * 0.17) + 0.05 * ((i // 20 + j // 30) % 2)
    return height_map(waves + 0.004 * np.random.default_rng(3).random((101, 121)))


def plane_points(camera, pose, plane):
    """Give where the pixels' rays meet the plane, and their depth."""
    rays = np.dstack([camera.ray_table(), np.ones(camera.shape)]) @ pose.rotation.as_matrix().T
    normal = np.array([*-SLOPE, 1.0])
    depth = ((ORIGIN_M - pose.translation) @ normal) / (rays @ normal)
    return pose.translation + depth[..., None] * rays, depth


@pytest.mark.parametrize(
    "function", [Lambert(), LommelSeeliger(), LunarLambert(), Hapke()], ids=lambda f: f.kind
)
def test_plane_has_the_light_of_the_formula(plane, function):
    albedo = np.full(plane.height_m.shape, 13107, dtype=np.uint16)
    albedo += np.arange(0, 201 * 200, 200, dtype=np.uint16)[:, None]
    axis = np.array([1.9, 1.5, -1.6])
    cone = SpotCone(axis / np.linalg.norm(axis), np.radians(3), np.radians(9))
    lamp = replace(LAMP, cone=cone)
    settings = RenderSettings(photometry=function, ambient=0.01, vignetting_power=4)
    seen = open_renderer("mitsuba", plane.painted(albedo)).render(CAMERA, OBLIQUE, lamp, settings)

    points, depth = plane_points(CAMERA, OBLIQUE, plane)
    assert np.abs(seen.depth_m - depth).max() < 3e-6
    assert np.abs(seen.points_trs_m - points).max() < 3e-6
    assert seen.is_lit.all()
    to_lamp, to_eye = LAMP.p_trs_m - points, OBLIQUE.translation - points
    distance = np.linalg.norm(to_lamp, axis=-1)
    to_lamp, to_eye = (
        to_lamp / distance[..., None],
        to_eye / np.linalg.norm(to_eye, axis=-1)[..., None],
    )
    normal = np.array([*-SLOPE, 1.0]) / np.sqrt(1 + SLOPE @ SLOPE)
    phase_rad = np.arccos(np.sum(to_lamp * to_eye, axis=-1))
    factor = photometry.reflected(function, to_lamp @ normal, to_eye @ normal, phase_rad)
    inner, outer = np.cos([cone.inner_half_angle_rad, cone.outer_half_angle_rad])
    step = np.clip((-to_lamp @ cone.axis_trs - outer) / (inner - outer), 0, 1)
    beam = lamp.intensity * step**2 * (3 - 2 * step) / distance**2
    shade = 0.2 + (points[..., 0] - ORIGIN_M[0]) / SPACING_M * 200 / 65535
    cos_off = OBLIQUE.rotation.as_matrix()[:, 2] @ -np.moveaxis(to_eye, -1, 1)
    expected = shade * (beam * factor + 0.01 * lamp.intensity) * cos_off**4
    assert np.ptp(step) > 0.9  # the cone's border is in the image
    assert seen.radiance == pytest.approx(expected, rel=1e-4)


def test_wall_casts_the_shadow_and_penumbra_of_geometry():
    height_m = np.zeros((201, 161))
    height_m[100] = top_m = 0.1
    camera = CameraModel(260, 10, 1500.0, 1500.0, 129.5, 4.5)
    pose = pose_along_boresight((2.33, 0.1, 1.8), boresight=(0, 0, -1), right=(1, 0, 0))
    lamp = Lamp(np.array([1.2, 0.1, 1.3]), 1.0)
    renderer = open_renderer("mitsuba", height_map(height_m))
    seen = renderer.render(camera, pose, lamp)
    behind_m = seen.points_trs_m[5, :, 0] - 2.2
    floor = behind_m > SPACING_M
    # From 1 m over the floor and 1 m before the wall, the shadow ends 1/9 m behind it.
    clear = floor & (np.abs(behind_m - 1 / 9) > 2e-4)
    assert (seen.is_lit[5] == (behind_m > 1 / 9))[clear].all()

    # Along the lamp's disk, by its radius: where the edge of the wall cuts it, seen from the floor.
    soft = renderer.render(camera, pose, replace(lamp, radius_m=0.05))
    to_lamp = np.stack([-1 - behind_m, np.ones_like(behind_m)], axis=-1)
    to_top = np.stack([-behind_m, np.full_like(behind_m, top_m)], axis=-1)
    across = np.stack([to_lamp[:, 1], -to_lamp[:, 0]], axis=-1)
    cut = np.sum(to_top * across, axis=-1) / np.sum(to_top * to_lamp, axis=-1)
    cut = np.clip(cut * np.linalg.norm(to_lamp, axis=-1) / 0.05, -1, 1)
    share = (np.arccos(cut) - cut * np.sqrt(1 - cut**2)) / np.pi
    cos_incidence = 1 / np.linalg.norm(to_lamp, axis=-1)
    found = soft.radiance[5] / cos_incidence**3
    assert np.abs(found - share)[floor].max() < 0.07  # of 32 points
    assert np.count_nonzero(np.abs(share - 0.5)[floor] < 0.4) > 8
    assert (soft.is_lit[5] == (share > 0.5))[floor & (np.abs(share - 0.5) > 0.06)].all()


def test_rough_terrain_agrees_with_the_reference(rough):
    pose = pose_along_boresight((1.7, -0.2, 1.3), boresight=(0, 0.1, -1), right=(0, 1, 0))
    lamp = Lamp(np.array([0.4, -1.6, 1.0]), 2.0, radius_m=0.03)
    albedo = np.random.default_rng(5).integers(10000, 65535, rough.height_m.shape, dtype=np.uint16)
    settings = RenderSettings(photometry=Hapke(), rays_per_pixel=4, shadows="rays", prefilter=False)
    other = open_renderer("mitsuba", rough.painted(albedo)).render(CAMERA, pose, lamp, settings)
    ours = ReferenceRenderer(rough.painted(albedo)).render(CAMERA, pose, lamp, settings)
    seen = np.isfinite(ours.depth_m)
    assert np.mean(seen != np.isfinite(other.depth_m)) < 0.001
    assert 0.2 < ours.is_lit[seen].mean() < 0.9
    assert np.quantile(np.abs(ours.depth_m - other.depth_m)[seen], 0.99) < 2e-6
    assert np.mean(ours.is_lit != other.is_lit) < 0.01
    lit = ours.is_lit & other.is_lit & (other.radiance > 0)
    assert np.median(ours.radiance[lit] / other.radiance[lit]) == pytest.approx(1, abs=0.002)


def test_every_nth_sample_is_a_coarser_terrain(rough):
    albedo = np.random.default_rng(5).integers(10000, 65535, rough.height_m.shape, dtype=np.uint16)
    coarse = HeightMap(rough.height_m[::3, ::3].copy(), 3 * SPACING_M, ORIGIN_M)
    told: list[str] = []
    thinned = open_renderer("mitsuba", rough.painted(albedo), every_n=3, announce=told.append)
    painted = coarse.painted(albedo[::3, ::3].copy())
    expected = open_renderer("mitsuba", painted).render(CAMERA, OBLIQUE, LAMP)
    np.testing.assert_array_equal(thinned.render(CAMERA, OBLIQUE, LAMP).radiance, expected.radiance)
    assert "0.0 million triangles, about 0.0 GB" in told[0]


def test_terrain_is_seen_from_above_alone(plane):
    renderer = open_renderer("mitsuba", plane)
    up = pose_along_boresight((2.2, 0.1, 0.0), boresight=(0, 0, 1), right=(0, 1, 0))
    under_the_border = pose_along_boresight((0.9, 0.1, 0.1), boresight=(1, 0, 0.3), right=(0, 1, 0))
    for pose in (up, under_the_border):
        seen = renderer.render(CAMERA, pose, LAMP, RenderSettings(ambient=1))
        assert np.isnan(seen.depth_m).all()
        assert np.isnan(seen.points_trs_m).all()
        assert not seen.radiance.any()
        assert not seen.is_lit.any()


def test_batch_and_threads_give_the_single_images(rough):
    renderer = open_renderer("mitsuba", rough)
    poses = [
        pose_along_boresight((1.7, y_m, 1.0), boresight=(0, 0, -1), right=(0, 1, 0))
        for y_m in (-0.3, -0.1, 0.2)
    ]
    singles = [renderer.render(CAMERA, pose, LAMP) for pose in poses]
    batch = renderer.render_batch(CAMERA, poses, LAMP)
    with ThreadPoolExecutor(3) as pool:
        threads = pool.map(lambda pose: renderer.render(CAMERA, pose, LAMP), poses)
        for single, of_batch, of_thread in zip(singles, batch, threads, strict=True):
            np.testing.assert_array_equal(single.radiance, of_batch.radiance)
            np.testing.assert_array_equal(single.points_trs_m, of_thread.points_trs_m)
    assert not np.array_equal(singles[0].radiance, singles[1].radiance)


def test_lamp_and_pose_that_are_nowhere_are_refused(plane):
    renderer = open_renderer("mitsuba", plane)
    with pytest.raises(RenderError, match="lamp: is not finite"):
        renderer.render(CAMERA, OBLIQUE, Lamp(np.array([np.nan, 0, 0]), 1.0))
    with pytest.raises(RenderError, match="radius_m is -1"):
        renderer.render(CAMERA, OBLIQUE, replace(LAMP, radius_m=-1.0))
