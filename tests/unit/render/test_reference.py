"""The reference renderer against theory: planes, steps, borders, and rays of every kind."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform

from tronlab.errors import FrameError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import pose_along_boresight
from tronlab.render.quadtree import make_grid
from tronlab.render.raycast import first_hit
from tronlab.render.rays import centre_rays
from tronlab.render.reference import ReferenceRenderer
from tronlab.render.renderer import Lamp
from tronlab.render.settings import RenderSettings
from tronlab.render.shadow_reach import block_shape
from tronlab.terrain.heightmap import HeightMap

DOWN = pose_along_boresight((0.2, 0.3, 0.5), boresight=(0, 0, -1), right=(0, 1, 0))
LAMP = Lamp(np.array([-0.6, -0.4, 0.9]), 2.0)
FOUR_RAYS = RenderSettings(rays_per_pixel=4)


def flat(height_m=0.0, *, rows=81, columns=121, spacing_m=0.005, origin=(0.0, 0.0, 0.1)):
    heights = np.full((rows, columns), height_m, dtype=np.float32)
    return HeightMap(heights, spacing_m, np.array(origin))


def points_of(rays, trs_from_cam, depth):
    p_cam = np.dstack([rays, np.ones(rays.shape[:2])]) * depth[..., None]
    return trs_from_cam.apply(p_cam.reshape(-1, 3)).reshape(p_cam.shape)


@pytest.fixture(scope="module")
def renderer(heightmap):
    return ReferenceRenderer(heightmap)


def test_a_plane_has_the_analytic_depth(camera):
    pose = pose_along_boresight((0.1, 0.2, 0.6), boresight=(0.2, 0.3, -1), right=(0, 1, 0.2))
    rendering = ReferenceRenderer(flat()).render(camera, pose, LAMP)
    rays = np.dstack([centre_rays(camera), np.ones(camera.shape)])
    down = rays @ pose.rotation.as_matrix()[2]
    expected = (0.1 - 0.6) / down
    points = points_of(centre_rays(camera), pose, expected)
    is_on_it = (points[..., :2] >= 0).all(axis=-1) & (points[..., :2] <= [0.4, 0.6]).all(axis=-1)
    np.testing.assert_array_equal(np.isfinite(rendering.depth_m), is_on_it)
    assert 0.1 < is_on_it.mean() < 0.9
    assert np.nanmax(np.abs(rendering.depth_m - expected)[is_on_it]) < 2e-7
    assert np.all(rendering.radiance[~is_on_it] == 0)
    assert not rendering.is_lit[~is_on_it].any()
    assert np.isnan(rendering.points_trs_m[~is_on_it]).all()


def test_a_sloping_plane_has_the_analytic_depth(camera):
    slope = 0.2 * np.arange(81)[:, None] - 0.1 * np.arange(121)
    heightmap = replace(flat(), height_m=(slope * 0.005 + 0.1).astype(np.float32))
    rendering = ReferenceRenderer(heightmap).render(camera, DOWN, LAMP)
    p = rendering.points_trs_m.astype(np.float64)
    error = p[..., 2] - (0.1 + 0.2 * p[..., 0] - 0.1 * p[..., 1] + 0.1)
    assert np.isfinite(error).any()
    assert np.nanmax(np.abs(error)) < 2e-7


def test_points_lie_where_depth_and_rays_say(renderer, camera):
    pose = pose_along_boresight((-0.2, 0.2, 0.3), boresight=(0.8, 0.1, -0.5), right=(0, 1, 0))
    rendering = renderer.render(camera, pose, LAMP)
    expected = points_of(centre_rays(camera), pose, rendering.depth_m.astype(np.float64))
    seen = np.isfinite(rendering.depth_m)
    np.testing.assert_array_equal(np.isnan(rendering.points_trs_m).any(axis=-1), ~seen)
    assert np.abs(rendering.points_trs_m - expected)[seen].max() < 3e-7
    uv = camera.project(pose.inv().apply(rendering.points_trs_m[seen].astype(np.float64)))
    rows, columns = np.nonzero(seen)
    assert np.abs(uv - np.c_[columns, rows]).max() < 1e-3


def plane_geometry(points, pose, lamp):
    to_lamp = lamp.p_trs_m - points
    distance = np.linalg.norm(to_lamp, axis=-1)
    to_eye = pose.translation - points
    range_ = np.linalg.norm(to_eye, axis=-1)
    cos_phase = np.sum(to_lamp * to_eye, axis=-1) / distance / range_
    return distance, to_lamp[..., 2] / distance, to_eye[..., 2] / range_, cos_phase


@pytest.mark.parametrize("rays_per_pixel", [1, 4])
def test_lambert_on_a_plane(camera, rays_per_pixel):
    rendering = ReferenceRenderer(flat(columns=401, rows=401, origin=(-0.8, -0.8, 0.1))).render(
        camera, DOWN, LAMP, RenderSettings(rays_per_pixel=rays_per_pixel)
    )
    distance, cos_incidence, _, _ = plane_geometry(rendering.points_trs_m, DOWN, LAMP)
    assert rendering.is_lit.all()
    np.testing.assert_allclose(
        rendering.radiance,
        2.0 * cos_incidence / distance**2,
        rtol=1e-6 if rays_per_pixel == 1 else 1e-4,
    )


def test_four_rays_are_the_mean_of_four_shifted_cameras(renderer, camera):
    four = renderer.render(camera, DOWN, LAMP, FOUR_RAYS)
    shifted = [
        renderer.render(
            replace(camera, cx_px=camera.cx_px - du, cy_px=camera.cy_px - dv), DOWN, LAMP
        ).radiance
        for du in (-0.25, 0.25)
        for dv in (-0.25, 0.25)
    ]
    np.testing.assert_allclose(four.radiance, np.mean(shifted, axis=0), rtol=1e-5, atol=1e-6)
    one = renderer.render(camera, DOWN, LAMP)
    np.testing.assert_array_equal(four.depth_m, one.depth_m)
    np.testing.assert_array_equal(four.points_trs_m, one.points_trs_m)
    np.testing.assert_array_equal(four.is_lit, one.is_lit)


@pytest.mark.parametrize("seed", range(12))
def test_the_table_of_shadow_reaches_changes_nothing(seed):
    """On rough ground, from over the model and from aside, with lamps high and low and within."""
    rng = np.random.default_rng(seed)
    heights = rng.normal(scale=0.01, size=(75, 58)) + rng.normal(scale=0.02, size=(75, 1))
    heightmap = replace(flat(), height_m=heights.astype(np.float32))
    position = [0.185, 0.14, 0.3] + rng.normal(size=3) * [0.1, 0.08, 0.05]
    pose = pose_along_boresight(position, boresight=rng.normal(size=3) - [0, 0, 3], right=(1, 1, 0))
    lamp = Lamp([0.2, 0.1, 0.0] + rng.normal(size=3) * [0.4, 0.4, 0.3], 1.0)
    narrow = CameraModel(43, 41, 45.0, 45.0, 21.0, 20.0)
    fast = ReferenceRenderer(heightmap)
    plain: Any = ReferenceRenderer(heightmap)
    shape = block_shape(plain._grid)
    plain._shadow_reaches[lamp.p_trs_m.tobytes()] = np.ones(shape, dtype=np.float32)
    rendering = fast.render(narrow, pose, lamp, FOUR_RAYS)
    expected = plain.render(narrow, pose, lamp, FOUR_RAYS)
    np.testing.assert_array_equal(rendering.is_lit, expected.is_lit)
    np.testing.assert_array_equal(rendering.radiance, expected.radiance)
    directions = np.dstack([centre_rays(narrow), np.ones(narrow.shape)]).reshape(-1, 3)
    seen = np.isfinite(rendering.depth_m).ravel()
    assert seen.any()
    some = np.union1d(np.flatnonzero(seen)[::5], np.arange(0, seen.size, 11))
    depth = [
        fast.range_along_m(position, pose.rotation.apply(d)) / np.linalg.norm(d)
        for d in directions[some]
    ]
    np.testing.assert_allclose(rendering.depth_m.ravel()[some], depth, atol=1e-7)


def test_a_moved_lamp_has_its_own_shadows(heightmap, renderer, camera):
    lamps = [Lamp(np.array([x, 0.1, 0.12]), 1.0) for x in (-0.6, 0.9, -0.6, 0.2, 0.9)]
    for lamp in lamps:
        again = renderer.render(camera, DOWN, lamp)
        once = ReferenceRenderer(heightmap).render(camera, DOWN, lamp)
        np.testing.assert_array_equal(again.radiance, once.radiance)
        assert 0.05 < once.is_lit.mean() < 0.95


def test_the_number_of_threads_changes_nothing(heightmap, camera):
    one, three = (
        ReferenceRenderer(heightmap, n_threads=n).render(camera, DOWN, LAMP, FOUR_RAYS)
        for n in (1, 3)
    )
    np.testing.assert_array_equal(one.radiance, three.radiance)
    np.testing.assert_array_equal(one.depth_m, three.depth_m)


def test_a_step_throws_its_shadow_to_the_analytic_place(camera):
    """A step down of 50 mm between x = 0.2 and 0.205 m, the lamp on its high side."""
    heights = np.zeros((81, 121), dtype=np.float32)
    heights[:41] = 0.05
    lamp = Lamp(np.array([-0.4, 0.3, 0.25]), 1.0)
    rendering = ReferenceRenderer(replace(flat(origin=(0, 0, 0)), height_m=heights)).render(
        camera, DOWN, lamp
    )
    # From the lamp over the edge at x = 0.2, z = 0.05 down to z = 0: similar triangles.
    shadow_end = -0.4 + 0.6 * 0.25 / (0.25 - 0.05)
    points = rendering.points_trs_m
    on_floor = points[..., 2] < 1e-6
    is_dark = on_floor & ~rendering.is_lit
    pixel_m = 0.5 / camera.fx_px
    assert points[is_dark][:, 0].max() == pytest.approx(shadow_end, abs=pixel_m)
    assert points[on_floor & rendering.is_lit][:, 0].min() == pytest.approx(shadow_end, abs=pixel_m)
    assert np.all(rendering.radiance[is_dark] == 0)
    assert rendering.is_lit[(points[..., 0] < 0.19) & ~on_floor].all()


@pytest.mark.parametrize("p_lamp", [(0.2, 0.3, -5.0), (0.2, 0.3, 0.05), (3.0, 0.3, 0.09)])
def test_a_lamp_below_the_surface_lights_nothing(camera, p_lamp):
    rendering = ReferenceRenderer(flat()).render(camera, DOWN, Lamp(np.array(p_lamp), 1.0))
    assert np.isfinite(rendering.depth_m).any()
    assert not rendering.is_lit.any()
    assert np.all(rendering.radiance == 0)


@pytest.mark.parametrize(
    ("position_m", "boresight"),
    [
        ((0.2, 0.3, 0.5), (0, 0, 1)),
        ((0.2, 0.3, -0.5), (0, 0, 1)),
        ((0.2, 0.3, 0.05), (0, 1, 0.0)),
        ((0.2, 5.0, 0.3), (0, 1, -0.1)),
        ((-1.0, 0.3, 0.05), (1, 0, 0.05)),
    ],
    ids=["up", "up from below", "inside the ground", "away", "in through the side"],
)
def test_nothing_is_seen(position_m, boresight):
    narrow = CameraModel(40, 40, 400.0, 400.0, 19.5, 19.5)
    pose = pose_along_boresight(position_m, boresight=boresight, right=(1, 1, 0))
    rendering = ReferenceRenderer(flat()).render(narrow, pose, LAMP, FOUR_RAYS)
    assert np.isnan(rendering.depth_m).all()
    assert np.isnan(rendering.points_trs_m).all()
    assert np.all(rendering.radiance == 0)
    assert not rendering.is_lit.any()


def test_the_model_has_no_skirt(heightmap, renderer, camera):
    """From outside and low, no point lies beyond the border nor under the surface."""
    pose = pose_along_boresight((0.2, -0.4, 0.12), boresight=(0, 1, -0.25), right=(1, 0, 0))
    points = renderer.render(camera, pose, LAMP).points_trs_m
    points = points[np.isfinite(points[..., 0])].astype(np.float64)
    assert len(points) > 1000
    place = points - heightmap.origin_trs_m
    assert place[:, :2].min() >= -1e-7
    assert np.all(place[:, :2].max(axis=0) <= np.array(heightmap.size_m) + 1e-7)
    heights = heightmap.height_m
    i, j = np.minimum((place[:, :2] / heightmap.spacing_m).astype(int), [299, 399]).T
    corners = np.stack([heights[i + k, j + m] for k in (0, 1) for m in (0, 1)])
    assert np.all(place[:, 2] >= corners.min(axis=0) - 1e-6)
    assert np.all(place[:, 2] <= corners.max(axis=0) + 1e-6)


def test_where_the_map_lies_does_not_matter(heightmap, renderer, camera):
    shift = RigidTransform.from_translation([3.0, -2.0, 1.0])
    moved = replace(heightmap, origin_trs_m=shift.apply(heightmap.origin_trs_m))
    here = renderer.render(camera, DOWN, LAMP)
    there = ReferenceRenderer(moved).render(
        camera, shift * DOWN, replace(LAMP, p_trs_m=shift.apply(LAMP.p_trs_m))
    )
    np.testing.assert_allclose(there.depth_m, here.depth_m, atol=2e-7)
    assert np.mean(there.is_lit != here.is_lit) < 1e-3


angle = st.floats(0, 2 * np.pi)


@settings(max_examples=300, deadline=None)
@given(
    start=st.tuples(st.floats(-20, 320), st.floats(-20, 420), st.floats(-0.01, 0.06)),
    azimuth=st.one_of(angle, st.sampled_from([0.0, np.pi / 2, np.pi, np.pi / 4, 3 * np.pi / 2])),
    fall=st.one_of(st.floats(-1e-3, 1e-3), st.just(0.0), st.floats(-0.1, 0.1)),
    level=st.integers(0, 20),
)
def test_every_ray_ends_and_the_first_level_does_not_matter(renderer, start, azimuth, fall, level):
    direction = (np.cos(azimuth), np.sin(azimuth), fall)
    grid = renderer._grid
    t = first_hit(grid, *start, *direction, np.inf, level)
    t_fine = first_hit(grid, *start, *direction, np.inf, 0)
    assert t == pytest.approx(t_fine, abs=1e-9)
    if t >= 0:
        r, c, z = np.array(start) + t * np.array(direction)
        assert -1e-9 <= r <= 300 + 1e-9
        assert -1e-9 <= c <= 400 + 1e-9
        assert -1e-6 <= z <= grid.top_m + 1e-6
        assert first_hit(grid, *start, *direction, t * 0.999, level) < 0


@pytest.mark.parametrize("shape", [(2, 2), (2, 9), (3, 3), (8, 5), (33, 64)])
def test_small_and_odd_shapes(shape):
    heights = np.random.default_rng(1).random(shape).astype(np.float32)
    grid = make_grid(heights, 0.01)
    assert grid.node_max_m[-1] == heights.max()
    for i in range(shape[0] - 1):
        for j in range(shape[1] - 1):
            t = first_hit(grid, i + 0.25, j + 0.25, 5.0, 0.0, 0.0, -1.0, np.inf, 9)
            expected = 0.75 * heights[i, j] + 0.25 * heights[i + 1, j + 1]
            assert 5.0 - t == pytest.approx(expected, abs=1e-6)


def test_range_along_a_ray():
    renderer = ReferenceRenderer(flat())
    assert renderer.range_along_m([0.2, 0.3, 0.5], [0, 0, -2]) == pytest.approx(0.4)
    slant = renderer.range_along_m([0.0, 0.3, 0.5], [0.3, 0, -0.4])
    assert slant == pytest.approx(0.5)
    assert np.isnan(renderer.range_along_m([0.2, 0.3, 0.5], [0, 0, 1]))
    assert np.isnan(renderer.range_along_m([0.2, 0.3, 0.0], [0, 0, 1]))
    with pytest.raises(FrameError, match="direction: is zero"):
        renderer.range_along_m([0, 0, 0], [0, 0, 0])
    with pytest.raises(FrameError, match="not finite"):
        renderer.range_along_m([0, 0, 0], [0, np.nan, 0])


def test_the_rays_are_the_cameras(camera):
    np.testing.assert_array_equal(centre_rays(camera), camera.ray_table())
    assert not centre_rays(camera).flags.writeable
