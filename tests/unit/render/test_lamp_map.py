"""The map of a lamp against geometry and against rays."""

import os
import threading

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tronlab.render import raycast
from tronlab.render.lamp import kept
from tronlab.render.lamp.map import LampMaps
from tronlab.render.lamp.sweep import DARK, LIT, sweep
from tronlab.render.lighting import SHADOW_OFFSET_M
from tronlab.render.quadtree import make_grid
from tronlab.render.renderer import Lamp, RenderError
from tronlab.terrain.heightmap import HeightMap

SPACING_M = 0.01


def swept(height_m, lamp, *, radius_m=0.0, n_threads=1, spacing_m=SPACING_M):
    visibility = np.full(height_m.shape, 77, dtype=np.uint8)
    grid = make_grid(np.float32(height_m), spacing_m)
    sweep(grid, np.array(lamp, dtype=float), radius_m, visibility, n_threads=n_threads)
    return visibility


def sees_lamp(grid, lamp, i, j):
    slopes = np.array([grid.height_m[i, j] - grid.height_m[max(i - 1, 0), j]]) / grid.spacing_m
    z = float(grid.height_m[i, j]) + SHADOW_OFFSET_M * float(np.hypot(1.0, slopes[0]))
    towards = lamp - [i, j, z]
    t = raycast.first_hit(grid, float(i), float(j), z, *towards, 1.0, np.int64(1))
    return t == raycast.MISSED


@pytest.fixture(scope="module")
def grid(heightmap: HeightMap):
    return make_grid(heightmap.height_m, heightmap.spacing_m)


@pytest.mark.parametrize(
    "lamp",
    [
        (-500.0, -400.0, 0.7),
        (-300.0, 200.5, 0.15),
        (400.0, 150.0, 0.12),
        (160.3, 190.7, 0.1),
        (100.0, 900.0, 0.25),
        (-2e6, 1e6, 1000.0),
    ],
)
def test_nodes_see_what_rays_see(grid, lamp):
    lamp = np.array(lamp)
    visibility = np.zeros(grid.height_m.shape, dtype=np.uint8)
    sweep(grid, lamp, 0.0, visibility, n_threads=2)
    nodes = np.random.default_rng(5).integers(0, visibility.shape, size=(4000, 2))
    by_rays = np.array([sees_lamp(grid, lamp, int(i), int(j)) for i, j in nodes])
    by_sweep = visibility[nodes[:, 0], nodes[:, 1]] == LIT
    assert 0.1 < by_rays.mean() < 0.999
    assert np.mean(by_rays != by_sweep) < 0.006


@pytest.mark.parametrize("is_transposed", [False, True])
@pytest.mark.parametrize("is_turned", [False, True])
def test_a_wall_throws_a_shadow_of_the_length_of_geometry(is_transposed, is_turned):
    height_m = np.zeros((300, 40))
    height_m[100] = 0.1
    lamp = (-50.0, 20.0, 1.0)
    # The line from the lamp over the wall's crest reaches the floor a ninth of its way later.
    expected = np.full(300, LIT)
    expected[101 : int(100 + 150 / 9) + 1] = DARK
    if is_turned:
        height_m, lamp, expected = height_m[::-1], (349.0, 20.0, 1.0), expected[::-1]
    if is_transposed:
        height_m, lamp = height_m.T, (20.0, lamp[0], 1.0)
    visibility = swept(height_m, lamp)
    middle = visibility[20] if is_transposed else visibility[:, 20]
    assert np.flatnonzero(middle != expected).size == 0


@settings(max_examples=60, deadline=None)
@given(
    shape=st.tuples(st.integers(2, 30), st.integers(2, 30)),
    place=st.tuples(*[st.one_of(st.integers(-5, 35), st.floats(-40, 70)) for _ in range(2)]),
    height_m=st.floats(0.01, 5),
)
@example(shape=(19, 3), place=(-9.537775395048822, -9.537775395048822), height_m=1.0)
@example(shape=(3, 3), place=(0, 0), height_m=1.0)
@example(shape=(9, 5), place=(-3, 4), height_m=1.0)
@example(shape=(28, 17), place=(18, -3e-275), height_m=1.0)
def test_every_node_of_a_plain_is_lit_from_above_and_dark_from_below(shape, place, height_m):
    plain = np.zeros(shape)
    assert np.all(swept(plain, (*place, height_m)) == LIT)
    below = swept(plain, (*place, -height_m))
    # A lamp beside the model reaches the rim.
    assert np.all(below[2:-2, 2:-2] == DARK)
    assert not np.any(below == 77)


def test_the_result_does_not_depend_on_threads(grid):
    lamp = (-300.0, 200.5, 0.15)
    one, two = (
        swept(grid.height_m, lamp, radius_m=0.02, n_threads=n, spacing_m=grid.spacing_m)
        for n in (1, 2)
    )
    np.testing.assert_array_equal(one, two)
    assert np.unique(one).size > 20


@pytest.mark.parametrize("radius_m", [0.1, 0.2])
def test_the_penumbra_of_a_wall_is_that_of_geometry(radius_m):
    height_m = np.zeros((400, 21))
    height_m[100] = 0.2
    lamp = np.array([-100.0, 10.0, 2.0])
    seen = swept(height_m, lamp, radius_m=radius_m)[101:, 10] / 255
    # In the vertical plane through the lamp: how far its centre is over the ray that grazes the
    # wall, across that ray's direction; the disk faces the node.
    x = np.arange(1, 300) * SPACING_M
    rise = 0.2 / x
    to_lamp = x + 2.0
    off = (2.0 - rise * to_lamp) / np.hypot(1.0, rise)
    share = np.clip(off / radius_m, -1, 1)
    expected = 1 - (np.arccos(share) - share * np.sqrt(1 - share**2)) / np.pi
    assert np.sum((expected > 0.02) & (expected < 0.98)) > 2
    assert np.abs(seen - expected).max() < 0.025


def test_a_lamp_inside_the_terrain_lights_nothing(grid):
    lamp = (150.2, 200.7, float(grid.bottom_m) - 0.01)
    assert np.mean(swept(grid.height_m, lamp, spacing_m=grid.spacing_m) == LIT) < 0.01


def test_maps_of_the_lamps_used_last_are_kept(heightmap, grid):
    maps = LampMaps(grid, heightmap.origin_trs_m, n_threads=1)
    lamps = [Lamp(np.array([-0.6, -0.4, 0.9 + k]), 1.0) for k in range(3)]
    first = maps.of(lamps[0])
    assert maps.of(Lamp(lamps[0].p_trs_m.copy(), 9.0)).visibility is first.visibility
    second = maps.of(lamps[1])
    maps.of(lamps[0])
    maps.of(lamps[2])
    assert maps.of(lamps[0]).visibility is first.visibility
    assert maps.of(lamps[1]).visibility is not second.visibility


def test_a_terrain_that_is_too_large_is_refused(grid):
    heights = np.broadcast_to(np.float32(0), (10001, 10001))
    maps = LampMaps(grid._replace(height_m=heights), np.zeros(3))
    with pytest.raises(RenderError, match=r"100020001 samples.*shadows: rays"):
        maps.of(Lamp(np.ones(3), 1.0))


@pytest.fixture
def kept_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr("tronlab.render.lamp.map.LEAST_SAMPLES", 0)
    return kept.cache_folder()


def map_in_new_process(grid, z_m=0.9, *, albedo=None, fingerprint="moon"):
    """Make or find the map of a lamp as a process does that has just begun."""
    maps = LampMaps(grid, np.zeros(3), albedo, fingerprint=fingerprint, n_threads=1)
    lamp_map = maps.of(Lamp(np.array([-0.6, -0.4, z_m]), 1.0))
    for thread in threading.enumerate():
        if thread.name == "keep lamp map":
            thread.join()
    return lamp_map


def forbid_sweeping(monkeypatch):
    def sweep_again(*_arguments, **_options):
        raise AssertionError("the map is made again")

    monkeypatch.setattr("tronlab.render.lamp.map.sweep", sweep_again)


def test_the_first_lamps_map_is_kept_for_the_next_process(grid, kept_folder, monkeypatch):
    made = map_in_new_process(grid)
    assert len(list(kept_folder.iterdir())) == 1
    forbid_sweeping(monkeypatch)
    found = map_in_new_process(grid)
    np.testing.assert_array_equal(found.visibility, made.visibility)
    for ours, theirs in zip(found.pyramid, made.pyramid, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    dark = np.zeros(grid.height_m.shape, dtype=np.uint16)
    for other in ({"z_m": 0.91}, {"albedo": dark}, {"fingerprint": "mars"}):
        with pytest.raises(AssertionError, match="made again"):
            map_in_new_process(grid, **other)


def test_maps_of_lamps_that_move_are_not_kept(grid, kept_folder):
    maps = LampMaps(grid, np.zeros(3), fingerprint="moon", n_threads=1)
    for z_m in (0.9, 0.91, 0.92):
        maps.of(Lamp(np.array([-0.6, -0.4, z_m]), 1.0))
    map_in_new_process(grid, 0.9)
    assert len(list(kept_folder.iterdir())) == 1


def test_a_damaged_map_is_made_again(grid, kept_folder, caplog):
    made = map_in_new_process(grid)
    (path,) = kept_folder.iterdir()
    path.write_bytes(path.read_bytes()[:-1])
    again = map_in_new_process(grid)
    np.testing.assert_array_equal(again.visibility, made.visibility)
    assert "is damaged and is made again" in caplog.text


def test_only_the_maps_used_last_stay_on_the_disk(grid, kept_folder):
    for k in range(4):
        map_in_new_process(grid, 0.9 + k)
    for k, path in enumerate(sorted(kept_folder.iterdir(), key=lambda path: path.stat().st_mtime)):
        os.utime(path, (k, k))
    map_in_new_process(grid, 0.9)
    used = max(kept_folder.iterdir(), key=lambda path: path.stat().st_mtime)
    map_in_new_process(grid, 9.0)
    assert len(list(kept_folder.iterdir())) == 4
    assert used.exists()


def test_a_folder_that_cannot_be_written_costs_only_the_keeping(grid, kept_folder, caplog):
    kept_folder.parent.mkdir(parents=True)
    kept_folder.write_text("in the way")
    assert map_in_new_process(grid).visibility.shape == grid.height_m.shape
    assert "the lamp map is not kept" in caplog.text
