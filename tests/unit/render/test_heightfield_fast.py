"""The fast renderer against the reference, which follows each ray by itself."""

from dataclasses import replace

import numpy as np
import pytest

from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import pose_along_boresight
from tronlab.render.heightfield import HeightfieldRenderer
from tronlab.render.reference import ReferenceRenderer
from tronlab.render.renderer import Lamp, RenderError, SpotCone
from tronlab.render.settings import RenderSettings
from tronlab.terrain.heightmap import HeightMap

RAYS = RenderSettings(shadows="rays")
POINTS = RenderSettings(prefilter=False)
LAMP = Lamp(np.array([-0.5, -0.3, 0.6]), 1.0)
DOWN = pose_along_boresight((0.2, 0.27, 0.5), boresight=(0, 0, -1), right=(0, 1, 0))
VIEWS = {  # position, boresight, right
    "nadir": ((0.2, 0.27, 0.5), (0, 0, -1), (0, 1, 0)),
    "oblique": ((-0.3, 0.3, 0.25), (0.8, 0.02, -0.45), (0, 1, 0)),
    "over a corner": ((0.5, -0.2, 0.1), (-0.7, 0.7, -0.2), (1, 1, 0)),
    "far": ((0.2, 0.27, 3.0), (0.01, 0.02, -1), (1, 0, 0)),
    "grazing, in a crater's air": ((0.2, 0.27, 0.045), (0.1, 1, -0.03), (1, 0, 0)),
    "level with the border": ((-1.2, 0.27, 0.02), (1, 0, 0), (0, 1, 0)),
    "from below the border": ((0.2, -0.2, -0.01), (0, 1, 0.02), (1, 0, 0)),
}


def view(name):
    position, boresight, right = VIEWS[name]
    return pose_along_boresight(position, boresight=boresight, right=right)


def rough(seed, shape=(75, 58)):
    rng = np.random.default_rng(seed)
    heights = rng.normal(scale=0.01, size=shape) + rng.normal(scale=0.02, size=(shape[0], 1))
    return HeightMap(heights.astype(np.float32), 0.005, np.array([0.0, 0.0, 0.1]))


def assert_same(fast, reference, *, n_edge_px=0):
    """The same but for pixels that just graze an edge, of the surface or of a shadow."""
    is_hit, expected = np.isfinite(fast.depth_m), np.isfinite(reference.depth_m)
    assert np.count_nonzero(is_hit != expected) <= n_edge_px
    both = is_hit & expected
    error = np.abs(fast.depth_m - reference.depth_m)[both]
    aside = np.abs(fast.points_trs_m - reference.points_trs_m)[both]
    assert np.count_nonzero(error > 1e-5) <= n_edge_px
    assert np.count_nonzero(aside > 1e-5) <= 3 * n_edge_px
    np.testing.assert_array_equal(np.isnan(fast.points_trs_m).any(axis=-1), ~is_hit)
    assert np.count_nonzero(fast.is_lit != reference.is_lit) <= n_edge_px
    tolerance = 1e-4 * max(float(reference.radiance.max()), 1e-6)
    differs = np.abs(fast.radiance - reference.radiance) > tolerance
    assert np.count_nonzero(differs) <= n_edge_px


@pytest.fixture(scope="module")
def fast(heightmap):
    return HeightfieldRenderer(heightmap)


@pytest.fixture(scope="module")
def reference(heightmap):
    return ReferenceRenderer(heightmap)


@pytest.mark.parametrize("name", VIEWS)
def test_it_sees_what_the_reference_sees(fast, reference, camera, name):
    expected = reference.render(camera, view(name), LAMP)
    assert np.isfinite(expected.depth_m).any()
    assert_same(fast.render(camera, view(name), LAMP, RAYS), expected, n_edge_px=4)


@pytest.mark.parametrize(
    ("position_m", "boresight"),
    [((0.2, 0.27, 0.2), (0.1, 0.2, 1)), ((0.2, 0.27, -0.1), (0, 0.2, -1)), ((5, 5, 1), (1, 0, 0))],
    ids=["up", "in the ground", "away"],
)
def test_nothing_is_seen(fast, camera, position_m, boresight):
    pose = pose_along_boresight(position_m, boresight=boresight, right=(0, 1, 0))
    rendering = fast.render(camera, pose, LAMP)
    assert np.isnan(rendering.depth_m).all()
    assert np.isnan(rendering.points_trs_m).all()
    assert not rendering.radiance.any()
    assert not rendering.is_lit.any()


@pytest.mark.parametrize("seed", range(12))
def test_it_sees_what_the_reference_sees_on_rough_ground(seed):
    """From over the model and from aside, from within its relief, looking down and up."""
    rng = np.random.default_rng(seed)
    heightmap = rough(seed)
    position = [0.185, 0.14, 0.2] + rng.normal(size=3) * [0.12, 0.1, 0.05]
    pose = pose_along_boresight(position, boresight=rng.normal(size=3) - [0, 0, 1], right=(1, 1, 0))
    lamp = Lamp([0.2, 0.1, 0.2] + rng.normal(size=3) * [0.4, 0.4, 0.2], 1.0)
    narrow = CameraModel(43, 41, 45.0, 45.0, 21.0, 20.0)
    settings = RAYS.model_copy(update={"rays_per_pixel": 4})
    expected = ReferenceRenderer(heightmap).render(narrow, pose, lamp, settings)
    found = HeightfieldRenderer(heightmap).render(narrow, pose, lamp, settings)
    assert_same(found, expected, n_edge_px=3)


@pytest.mark.parametrize("shape", [(2, 2), (2, 9), (8, 8), (17, 3)])
@pytest.mark.parametrize("prefilter", [False, True])
def test_small_maps(shape, prefilter):
    """Flat as a plane on average: even one level of squares has to give a light like it."""
    heights = np.random.default_rng(1).normal(scale=1e-5, size=shape).astype(np.float32)
    heightmap = HeightMap(heights, 0.05, np.zeros(3))
    x, y = heightmap.size_m
    pose = pose_along_boresight((x / 2, y / 2, 0.5), boresight=(0, 0, -1), right=(0, 1, 0))
    lamp = Lamp(np.array([-1.0, -1.0, 2.0]), 1.0)
    camera = CameraModel(37, 1, 30.0, 30.0, 18.0, 0.0)
    settings = RenderSettings(prefilter=prefilter)
    found = HeightfieldRenderer(heightmap).render(camera, pose, lamp, settings)
    expected = ReferenceRenderer(heightmap).render(camera, pose, lamp)
    assert np.isfinite(expected.depth_m).any()
    np.testing.assert_array_equal(np.isnan(found.depth_m), np.isnan(expected.depth_m))
    np.testing.assert_allclose(found.depth_m, expected.depth_m, atol=1e-6)
    np.testing.assert_allclose(found.radiance, expected.radiance, rtol=2e-3)
    np.testing.assert_array_equal(found.is_lit, expected.is_lit)


@pytest.mark.parametrize("photometry", ["lambert", "lommel_seeliger", "lunar_lambert", "hapke"])
def test_light_from_the_map_is_that_of_the_reference(heightmap, camera, photometry):
    """With all that changes it; away from the edges of shadows, which the map rounds off."""
    albedo = np.random.default_rng(3).integers(20_000, 65_535, heightmap.height_m.shape)
    albedo = albedo.astype(np.uint16)
    axis = np.array([0.6, 0.5, -0.6]) / np.linalg.norm([0.6, 0.5, -0.6])
    lamp = replace(LAMP, cone=SpotCone(axis, 0.2, 0.5))
    settings = RenderSettings(
        photometry=photometry, prefilter=False, ambient=0.05, vignetting_power=4, rays_per_pixel=4
    )
    found = HeightfieldRenderer(heightmap.painted(albedo)).render(camera, DOWN, lamp, settings)
    expected = ReferenceRenderer(heightmap.painted(albedo)).render(camera, DOWN, lamp, settings)
    error = np.abs(found.radiance - expected.radiance)
    assert np.quantile(error, 0.98) < 1e-5 * expected.radiance.max()
    assert np.mean(found.is_lit != expected.is_lit) < 0.005


def test_a_large_lamp_has_soft_shadows(fast, reference, camera):
    lamp = replace(LAMP, radius_m=0.2)
    found = fast.render(camera, DOWN, lamp, POINTS).radiance
    expected = reference.render(camera, DOWN, lamp).radiance
    assert np.abs(found - expected).mean() < 0.01 * expected.mean()
    hard = fast.render(camera, DOWN, LAMP, POINTS).radiance
    assert np.abs(found - expected).mean() < 0.75 * np.abs(hard - expected).mean()


@pytest.mark.parametrize("radius_m", [0.0, 0.05])
def test_triangles_that_face_away_from_the_lamp_are_dark(radius_m):
    """Steps of 45 degrees, their edges in the light of a lamp 40 degrees up."""
    profile = np.tile([0.0, 0.0, 0.002, 0.002], 12).astype(np.float32)
    heightmap = HeightMap(np.tile(profile[:, None], (1, 30)), 0.002, np.zeros(3))
    lamp = Lamp(np.array([1.24, 0.03, 1.0]), 1.0, radius_m=radius_m)
    pose = pose_along_boresight((0.047, 0.029, 0.1), boresight=(0, 0, -1), right=(0, 1, 0))
    narrow = CameraModel(160, 160, 320.0, 320.0, 79.5, 79.5)
    found = HeightfieldRenderer(heightmap).render(narrow, pose, lamp, POINTS)
    r = found.points_trs_m[..., 0] / heightmap.spacing_m
    faces_away = (np.diff(profile) > 0)[np.floor(r).astype(int)]
    assert 0.1 < faces_away.mean() < 0.4
    assert not found.is_lit[faces_away].any()
    assert found.radiance[faces_away].max() < 1e-6
    assert found.is_lit[~faces_away].mean() > 0.7


@pytest.mark.parametrize("spacing_m", [2.0**-13, 2.0**-8, 16.0])
@pytest.mark.parametrize("slope", [0.0, 2.0], ids=["level", "steep"])
@pytest.mark.parametrize("height_m", [0.0, 1738.5])
def test_no_place_of_a_plane_shades_another(spacing_m, slope, height_m):
    """Whatever the size of model and heights, which 32 bits hold; the lamp grazes the plane."""
    x = np.arange(40) * spacing_m
    heights = np.tile((height_m + slope * x)[:, None], (1, 40)).astype(np.float32)
    heightmap = HeightMap(heights, spacing_m, np.zeros(3))
    middle = np.array([0.5 * x[-1], 0.5 * x[-1], height_m + 0.5 * slope * x[-1]])
    normal = np.array([-slope, 0.0, 1.0]) / np.hypot(slope, 1.0)
    lamp = Lamp(middle + x[-1] * (np.array([0.3, 3.0, 0.3 * slope]) + 0.03 * normal), 1.0)
    eye = middle + np.array([0.0, 0.0, 2.0 * x[-1]])
    pose = pose_along_boresight(eye, boresight=(0, 0, -1), right=(0, 1, 0))
    narrow = CameraModel(60, 60, 110.0, 110.0, 29.5, 29.5)
    fast = HeightfieldRenderer(heightmap)
    for rendering in (
        ReferenceRenderer(heightmap).render(narrow, pose, lamp),
        fast.render(narrow, pose, lamp, RAYS),
        fast.render(narrow, pose, lamp, POINTS),
    ):
        is_seen = np.isfinite(rendering.depth_m)
        assert is_seen.sum() > 1000
        np.testing.assert_array_equal(rendering.is_lit, is_seen)


def mean_of_64(renderer, camera, pose):
    shifts = (np.arange(8) - 3.5) / 8
    moved = [
        replace(camera, cx_px=camera.cx_px - du, cy_px=camera.cy_px - dv)
        for du in shifts
        for dv in shifts
    ]
    return np.mean([renderer.render(c, pose, LAMP, POINTS).radiance for c in moved], axis=0)


@pytest.mark.parametrize(
    ("boresight", "least_gain"),
    [((0, 0, -1), 3.0), ((0.3, 1, -0.6), 1.5)],
    ids=["nadir", "oblique"],
)
def test_the_prefilter_takes_the_mean_of_what_a_pixel_covers(fast, boresight, least_gain):
    """At 4 to 8 samples a pixel."""
    boresight = np.array(boresight) / np.linalg.norm(boresight)
    pose = pose_along_boresight(
        (0.2, 0.27, 0.0) - 1.2 * boresight,
        boresight=boresight,
        right=np.cross(boresight, (1, 0, 0)),
    )
    camera = CameraModel(40, 40, 170.0, 170.0, 19.5, 19.5)
    mean = mean_of_64(fast, camera, pose)
    inside = np.isfinite(fast.render(camera, pose, LAMP).depth_m)
    inside[1:-1, 1:-1] &= (
        inside[:-2, 1:-1] & inside[2:, 1:-1] & inside[1:-1, :-2] & inside[1:-1, 2:]
    )

    def error(settings):
        found = fast.render(camera, pose, LAMP, settings).radiance
        return np.sqrt(np.mean((found - mean)[inside] ** 2))

    assert np.count_nonzero(inside) > 500
    assert error(RenderSettings()) * least_gain < error(POINTS)
    four = RenderSettings(rays_per_pixel=4)
    assert error(four) < error(RenderSettings())
    assert error(four) < error(four.model_copy(update={"prefilter": False}))


def test_from_near_the_prefilter_changes_nothing(fast, camera):
    pose = pose_along_boresight((0.2, 0.27, 0.2), boresight=(0, 0, -1), right=(0, 1, 0))
    np.testing.assert_array_equal(
        fast.render(camera, pose, LAMP).radiance, fast.render(camera, pose, LAMP, POINTS).radiance
    )


@pytest.mark.parametrize("rays_per_pixel", [1, 4])
def test_the_number_of_threads_changes_nothing(heightmap, camera, rays_per_pixel):
    settings = RenderSettings(rays_per_pixel=rays_per_pixel)
    one, two = (
        HeightfieldRenderer(heightmap, n_threads=n).render(camera, view("oblique"), LAMP, settings)
        for n in (1, 2)
    )
    np.testing.assert_array_equal(one.radiance, two.radiance)
    np.testing.assert_array_equal(one.depth_m, two.depth_m)
    np.testing.assert_array_equal(one.points_trs_m, two.points_trs_m)
    np.testing.assert_array_equal(one.is_lit, two.is_lit)


def test_a_batch_is_its_images_one_by_one(fast, camera):
    poses = [view(name) for name in ("nadir", "oblique")]
    batch = list(fast.render_batch(camera, poses, LAMP))
    assert len(batch) == 2
    for rendering, pose in zip(batch, poses, strict=True):
        np.testing.assert_array_equal(rendering.radiance, fast.render(camera, pose, LAMP).radiance)


def test_what_cannot_be_rendered_is_refused(fast, camera):
    with pytest.raises(RenderError, match="lamp: is not finite"):
        fast.render(camera, DOWN, Lamp(np.array([0.0, np.inf, 1.0]), 1.0))
    with pytest.raises(RenderError, match="radius_m is -1"):
        fast.render(camera, DOWN, replace(LAMP, radius_m=-1.0))
