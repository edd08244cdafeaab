"""The reference renderer's light: photometry, albedo, lamps with a size and a cone, the lens."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import pose_along_boresight
from tronlab.render import first_use
from tronlab.render.lighting import disk_points
from tronlab.render.photometry import Hapke, Lambert, LommelSeeliger, LunarLambert, reflected
from tronlab.render.reference import ReferenceRenderer
from tronlab.render.renderer import Lamp, RenderError, SpotCone
from tronlab.render.settings import RenderSettings
from tronlab.terrain.heightmap import HeightMap

DOWN = pose_along_boresight((0.2, 0.3, 0.5), boresight=(0, 0, -1), right=(0, 1, 0))
LAMP = Lamp(np.array([-0.6, -0.4, 0.9]), 2.0)
ORIGIN_M = np.array([-0.8, -0.8, 0.1])


@pytest.fixture(scope="module")
def plain():
    """A plane at z = 0.1, larger than what the camera sees."""
    return ReferenceRenderer(plane())


def plane():
    return HeightMap(np.zeros((401, 401), dtype=np.float32), 0.005, ORIGIN_M)


def geometry(points, lamp=LAMP):
    """Give distance to the lamp, cosines of incidence and emission, and phase on the plane."""
    to_lamp, to_eye = lamp.p_trs_m - points, DOWN.translation - points
    distance, range_ = np.linalg.norm(to_lamp, axis=-1), np.linalg.norm(to_eye, axis=-1)
    cos_phase = np.sum(to_lamp * to_eye, axis=-1) / distance / range_
    return distance, to_lamp[..., 2] / distance, to_eye[..., 2] / range_, np.arccos(cos_phase)


@pytest.mark.parametrize(
    "function",
    [Lambert(), LommelSeeliger(), LunarLambert(), LunarLambert(weight=0.4), Hapke()],
    ids=["lambert", "lommel_seeliger", "moon", "lunar_lambert", "hapke"],
)
def test_a_plane_has_the_light_of_the_formula(plain, camera, function):
    rendering = plain.render(camera, DOWN, LAMP, RenderSettings(photometry=function))
    distance, mu0, mu, phase = geometry(rendering.points_trs_m.astype(np.float64))
    assert np.ptp(np.degrees(phase)) > 30
    expected = 2.0 / distance**2 * reflected(function, mu0, mu, phase)
    np.testing.assert_allclose(rendering.radiance, expected, rtol=2e-6)


def test_albedo_is_interpolated_between_the_samples(plain, camera):
    albedo = np.random.default_rng(3).integers(0, 65536, size=(401, 401), dtype=np.uint16)
    rendering = ReferenceRenderer(plane().painted(albedo)).render(
        camera, DOWN, LAMP, RenderSettings(ambient=0.1)
    )
    place = (rendering.points_trs_m[..., :2].astype(np.float64) - ORIGIN_M[:2]) / 0.005
    at_place = map_coordinates(albedo / 65535, np.moveaxis(place, -1, 0), order=1)
    white = plain.render(camera, DOWN, LAMP, RenderSettings(ambient=0.1)).radiance
    np.testing.assert_allclose(rendering.radiance, white * at_place, rtol=1e-3, atol=1e-5)


def test_ambient_light_is_on_all_terrain_seen_and_nowhere_else(heightmap, camera):
    renderer = ReferenceRenderer(heightmap)
    low = Lamp(np.array([-0.6, 0.1, 0.12]), 2.0)
    dark = renderer.render(camera, DOWN, low)
    ambient = renderer.render(camera, DOWN, low, RenderSettings(ambient=0.05))
    seen = np.isfinite(dark.depth_m)
    assert 0.05 < dark.is_lit.mean() < 0.95 * seen.mean()
    np.testing.assert_allclose(
        ambient.radiance, dark.radiance + np.where(seen, 0.05 * 2.0, 0), rtol=1e-6
    )
    np.testing.assert_array_equal(ambient.is_lit, dark.is_lit)


@pytest.mark.parametrize(("rays_per_pixel", "tolerance"), [(1, 1e-6), (4, 1e-5)])
def test_vignetting_is_a_power_of_the_cosine_off_the_axis(plain, camera, rays_per_pixel, tolerance):
    settings = RenderSettings(ambient=0.2, rays_per_pixel=rays_per_pixel)
    even = plain.render(camera, DOWN, LAMP, settings).radiance
    dim = plain.render(
        camera, DOWN, LAMP, settings.model_copy(update={"vignetting_power": 4.0})
    ).radiance
    rays = camera.ray_table()
    cosine = 1 / np.sqrt(1 + np.sum(rays**2, axis=-1))
    assert cosine.min() < 0.8
    np.testing.assert_allclose(dim / even, cosine**4, rtol=tolerance)


def test_a_cone_fades_smoothly_from_its_inner_to_its_outer_angle(plain, camera):
    axis = np.array([0.2, 0.3, 0.1]) - LAMP.p_trs_m
    axis /= np.linalg.norm(axis)
    inner, outer = 0.06, 0.12
    spot = replace(LAMP, cone=SpotCone(axis, inner, outer))
    ratio = (
        plain.render(camera, DOWN, spot).radiance
        / (rendering := plain.render(camera, DOWN, LAMP)).radiance
    )
    from_lamp = rendering.points_trs_m - LAMP.p_trs_m
    off = np.arccos(from_lamp @ axis / np.linalg.norm(from_lamp, axis=-1))
    assert np.all(ratio[off < inner - 1e-6] == 1)
    assert np.all(ratio[off > outer + 1e-6] == 0)
    step = (np.cos(off) - np.cos(outer)) / (np.cos(inner) - np.cos(outer))
    expected = np.where(off < inner, 1, np.where(off > outer, 0, step**2 * (3 - 2 * step)))
    assert np.count_nonzero((expected > 0) & (expected < 1)) > 1000
    np.testing.assert_allclose(ratio, expected, atol=1e-4)
    hard = replace(LAMP, cone=SpotCone(axis, outer, outer))
    is_lit = plain.render(camera, DOWN, hard).radiance > 0
    np.testing.assert_array_equal(
        is_lit[np.abs(off - outer) > 1e-5], (off < outer)[np.abs(off - outer) > 1e-5]
    )


def test_a_lamp_with_a_size_throws_the_penumbra_of_geometry(camera):
    """A straight edge, 50 mm over the floor, before a sphere of 20 mm radius 0.63 m away."""
    heights = np.zeros((81, 121), dtype=np.float32)
    heights[:41] = 0.05
    renderer = ReferenceRenderer(HeightMap(heights, 0.005, np.zeros(3)))
    lamp = Lamp(np.array([-0.4, 0.3, 0.25]), 1.0, radius_m=0.02)
    rendering = renderer.render(camera, DOWN, lamp)
    points = rendering.points_trs_m.astype(np.float64)
    to_lamp = lamp.p_trs_m - points
    # How far the lamp's centre is over the plane through the point and the edge, which is along y.
    x, z = 0.2 - points[..., 0], 0.05 - points[..., 2]
    over = (-z * to_lamp[..., 0] + x * to_lamp[..., 2]) / np.hypot(x, z) * np.where(x < 0, -1, 1)
    s = np.clip(over / lamp.radius_m, -1, 1)
    share = 1 - (np.arccos(s) - s * np.sqrt(1 - s**2)) / np.pi
    distance = np.linalg.norm(to_lamp, axis=-1)
    full = to_lamp[..., 2] / distance**3
    floor = (points[..., 2] < 1e-6) & (points[..., 0] > 0.21)
    error = (rendering.radiance / full - share)[floor]
    penumbra = floor & (share > 0) & (share < 1)
    assert np.count_nonzero(penumbra) > 3000
    assert np.abs(error).max() < 0.04
    assert np.sqrt(np.mean(error[penumbra[floor]] ** 2)) < 0.01
    clear = np.abs(share - 0.5) > 0.04
    np.testing.assert_array_equal(rendering.is_lit[floor & clear], share[floor & clear] > 0.5)
    # Its width on the floor: tangents to the sphere over the edge, along the middle column.
    middle = floor & (np.abs(points[..., 1] - 0.3) < 0.002)
    half = (rendering.radiance / full > 0.005) & (rendering.radiance / full < 0.995)
    lamp_x, lamp_z = -0.6, 0.2
    slope = np.arctan2(lamp_z, -lamp_x) + np.array([1, -1]) * np.arcsin(
        0.02 / np.hypot(lamp_x, lamp_z)
    )
    near, far = 0.2 + 0.05 / np.tan(slope)
    found = points[middle & half][:, 0]
    assert found.min() == pytest.approx(near, abs=0.004)
    assert found.max() == pytest.approx(far, abs=0.004)
    assert far - near > 0.02


def test_the_points_of_the_disk_stand_for_equal_parts_of_it():
    """What straight edges, in all directions and at all distances, leave of the disk."""
    points = disk_points(0.5)
    assert np.linalg.norm(points, axis=1).max() < 0.5
    edge = np.linspace(-1, 1, 401)
    exact = (np.arccos(-edge) + edge * np.sqrt(1 - edge**2)) / np.pi
    errors = [
        np.mean(points @ [np.cos(a), np.sin(a)] < 0.5 * edge[:, None], axis=1) - exact
        for a in np.linspace(0, 2 * np.pi, 90)
    ]
    assert np.abs(errors).max() < 0.037
    assert np.sqrt(np.mean(np.square(errors))) < 0.0074
    np.testing.assert_array_equal(disk_points(0.0), [[0, 0]])


def test_a_tiny_lamp_is_a_point(heightmap):
    renderer = ReferenceRenderer(heightmap)
    small = CameraModel(90, 80, 65.0, 65.0, 44.5, 39.5)
    low = Lamp(np.array([-0.6, 0.1, 0.12]), 2.0)
    point = renderer.render(small, DOWN, low)
    tiny = renderer.render(small, DOWN, replace(low, radius_m=1e-9))
    assert 0.1 < point.is_lit.mean() < 0.9
    np.testing.assert_array_equal(point.is_lit, tiny.is_lit)
    np.testing.assert_allclose(point.radiance, tiny.radiance, rtol=1e-6)


def test_shadows_and_prefilter_change_nothing(heightmap, camera):
    renderer = ReferenceRenderer(heightmap)
    one = renderer.render(camera, DOWN, LAMP)
    other = renderer.render(camera, DOWN, LAMP, RenderSettings(shadows="rays", prefilter=False))
    np.testing.assert_array_equal(one.radiance, other.radiance)


def test_a_batch_is_one_image_after_another(heightmap):
    small = CameraModel(20, 16, 15.0, 15.0, 9.5, 7.5)
    renderer = ReferenceRenderer(heightmap)
    poses = [RigidTransform.from_translation([0, 0.05 * k, 0]) * DOWN for k in range(3)]
    settings = RenderSettings(rays_per_pixel=4)
    batch = list(renderer.render_batch(small, poses, LAMP, settings))
    assert len(batch) == 3
    for pose, rendering in zip(poses, batch, strict=True):
        alone = renderer.render(small, pose, LAMP, settings)
        np.testing.assert_array_equal(rendering.radiance, alone.radiance)
        np.testing.assert_array_equal(rendering.points_trs_m, alone.points_trs_m)


@pytest.mark.parametrize(
    ("lamp", "match"),
    [
        (Lamp(np.array([0.0, np.inf, 1.0]), 1.0), "lamp: is not finite"),
        (Lamp(np.array([0.0, 0.0, 1.0]), np.nan), "lamp: is not finite"),
        (replace(LAMP, intensity=-1.0), "intensity is -1.0, must not be negative"),
        (replace(LAMP, radius_m=-0.01), "radius_m is -0.01, must be 0"),
        (replace(LAMP, radius_m=np.nan), "radius_m is nan"),
        (replace(LAMP, cone=SpotCone(np.array([0, 0, -2.0]), 0.1, 0.2)), "must have length 1"),
        (replace(LAMP, cone=SpotCone(np.array([0, 0, -1.0]), 0.3, 0.2)), "inner <= outer"),
        (replace(LAMP, cone=SpotCone(np.array([0, 0, -1.0]), -0.1, 0.2)), "0 <= inner"),
        (replace(LAMP, cone=SpotCone(np.array([0, 0, -1.0]), 0.1, 4.0)), "outer <= pi"),
    ],
)
def test_lamps_that_make_no_sense_are_refused(plain, camera, lamp, match):
    with pytest.raises(RenderError, match=match):
        plain.render(camera, DOWN, lamp)


def test_a_camera_that_is_nowhere_is_refused(plain, camera):
    with pytest.raises(RenderError, match="camera pose: is not finite"):
        plain.render(camera, RigidTransform.from_translation([0, 0, np.nan]), LAMP)


class Kernel:
    """What numba's compiled functions tell of themselves."""

    def __init__(self, *, in_process=(), on_disk=None):
        self.signatures = list(in_process)
        self._cache = self
        if on_disk is not None:
            self._cache_file = self
            self._load_index = lambda: on_disk


def test_a_first_compilation_is_announced_before_it_starts():
    compiled, kept = Kernel(in_process=["int64"]), Kernel(on_disk={"key": "file"})
    told = []
    first_use.announce_first_use(told.append, compiled, kept)
    assert told == []
    for new in (Kernel(on_disk={}), Kernel()):
        first_use.announce_first_use(told.append, compiled, new)
    assert (
        told
        == ["compiling the renderer for this machine: its first use ever takes some seconds"] * 2
    )
    first_use.announce_first_use(None, Kernel())


def test_the_renderer_announces(heightmap):
    """The real kernel, not yet run in a fresh process: told or kept on disk, never an error."""
    told = []
    tiny = CameraModel(4, 4, 4.0, 4.0, 1.5, 1.5)
    renderer = ReferenceRenderer(heightmap, announce=told.append)
    renderer.render(tiny, DOWN, LAMP)
    told.clear()
    renderer.render(tiny, DOWN, LAMP)
    assert told == []
