"""The mean light of squares against the mean of the light of their nodes."""

import numpy as np
import pytest

from tronlab.render.lamp.prefilter import filtered_at, make_pyramid
from tronlab.render.photometry import Hapke, Lambert, LommelSeeliger, LunarLambert
from tronlab.render.photometry_kernel import numbers_of, reflected
from tronlab.render.quadtree import make_grid
from tronlab.render.surface import NO_ALBEDO

LAMP = np.array([-400.0, -300.0, 0.45])
EYE = np.array([150.0, 200.0, 1.5])


@pytest.fixture(scope="module")
def scene(heightmap):
    """Grid, visibility, albedo and, by node, the normals' vectors and weights of a lit terrain."""
    grid = make_grid(heightmap.height_m, heightmap.spacing_m)
    rng = np.random.default_rng(3)
    visibility = rng.choice(np.array([0, 100, 255, 255], dtype=np.uint8), grid.height_m.shape)
    albedo = rng.integers(20000, 65536, grid.height_m.shape, dtype=np.uint16)
    slopes = np.gradient(np.float64(grid.height_m), grid.spacing_m)
    normals = np.stack([-slopes[0], -slopes[1], np.ones_like(slopes[0])], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1)[..., None]
    return grid, visibility, albedo, normals


def directions_to(grid, place):
    i, j = np.indices(grid.height_m.shape)
    to_place = np.stack(
        [
            (place[0] - i) * grid.spacing_m,
            (place[1] - j) * grid.spacing_m,
            place[2] - grid.height_m.astype(np.float64),
        ],
        axis=-1,
    )
    return to_place / np.linalg.norm(to_place, axis=-1)[..., None]


def expected_means(scene, weights):
    grid, _, _, normals = scene
    facing = np.sum(normals * directions_to(grid, LAMP), axis=-1) > 0
    weights = weights * facing
    return np.dstack([normals * weights[..., None], weights])


def squares_of(values, size):
    """Means over squares of size x size values, those at the far border over what there is."""
    rows, columns = np.arange(0, values.shape[0], size), np.arange(0, values.shape[1], size)
    sums = np.add.reduceat(np.add.reduceat(values, rows, axis=0), columns, axis=1)
    counts = np.outer(
        np.diff([*rows, values.shape[0]]), np.diff([*columns, values.shape[1]])
    ).astype(float)
    return sums / counts.reshape(counts.shape + (1,) * (values.ndim - 2))


def level_of(pyramid, level):
    start = pyramid.level_start[level]
    shape = pyramid.level_rows[level], pyramid.level_columns[level]
    return pyramid.means[start : start + shape[0] * shape[1]].reshape(*shape, 4) / 32767


@pytest.mark.parametrize("has_albedo", [False, True])
def test_levels_are_the_means_of_their_nodes(scene, has_albedo):
    grid, visibility, albedo, _ = scene
    albedo = albedo if has_albedo else NO_ALBEDO
    pyramid = make_pyramid(grid, visibility, albedo, LAMP, n_threads=2)
    weights = visibility / 255 * (albedo / 65535 if has_albedo else 1)
    nodes = expected_means(scene, weights)
    assert pyramid.level_rows.tolist()[:4] == [301, 151, 76, 38]
    for level in range(1, pyramid.level_rows.size):
        error = np.abs(level_of(pyramid, level) - squares_of(nodes, 1 << level)).max()
        # Each level is rounded to half a part in 32767; float32 may turn a node away at grazing.
        assert error < (0.5 * level + 1) / 32767, level


def test_the_pyramid_does_not_depend_on_threads(scene):
    grid, visibility, albedo, _ = scene
    one, two = (make_pyramid(grid, visibility, albedo, LAMP, n_threads=n) for n in (1, 2))
    np.testing.assert_array_equal(one.means, two.means)


def test_a_lookup_is_interpolated_in_place_and_level(scene):
    grid, visibility, albedo, _ = scene
    pyramid = make_pyramid(grid, visibility, albedo, LAMP, n_threads=1)
    means = level_of(pyramid, 3)
    r, c = 8 * 10 + 3.5, 8 * 20 + 3.5

    def look_up(*place):
        return np.array(filtered_at(pyramid, *place))

    np.testing.assert_allclose(look_up(r, c, 3.0), means[10, 20], atol=1e-12)
    between = 0.75 * means[10, 20] + 0.25 * means[11, 20]
    np.testing.assert_allclose(look_up(r + 2.0, c, 3.0), between, atol=1e-12)
    blend = 0.4 * look_up(r, c, 3.0) + 0.6 * look_up(r, c, 4.0)
    np.testing.assert_allclose(look_up(r, c, 3.6), blend, atol=1e-12)
    np.testing.assert_allclose(look_up(0.0, 0.0, 1.0), level_of(pyramid, 1)[0, 0], atol=1e-12)
    np.testing.assert_allclose(look_up(300.0, 400.0, 99.0), pyramid.means[-1] / 32767, atol=1e-12)
    np.testing.assert_array_equal(look_up(r, c, -2.0), look_up(r, c, 1.0))


@pytest.mark.parametrize(
    ("photometry", "most_rms"),
    [
        (Lambert(), 0.002),
        (LommelSeeliger(), 0.04),
        (LunarLambert(), 0.02),
        (Hapke(), 0.04),
    ],
)
@pytest.mark.parametrize("level", [2, 4])
def test_mean_cosines_give_the_mean_light(scene, photometry, most_rms, level):
    grid, visibility, _, normals = scene
    visibility = np.full_like(visibility, 255)
    pyramid = make_pyramid(grid, visibility, NO_ALBEDO, LAMP, n_threads=1)
    to_lamp, to_eye = directions_to(grid, LAMP), directions_to(grid, EYE)
    numbers = numbers_of(photometry)

    def light(mean, lamp_direction, eye_direction, weight):
        weight = np.maximum(weight, 1e-9)
        cos_incidence = np.maximum(np.sum(mean * lamp_direction, axis=-1) / weight, 0)
        cos_emission = np.maximum(np.sum(mean * eye_direction, axis=-1) / weight, 1e-3)
        cos_phase = np.sum(lamp_direction * eye_direction, axis=-1)
        return weight * reflected(numbers, cos_incidence, cos_emission, cos_phase)

    of_nodes = light(normals, to_lamp, to_eye, np.ones(normals.shape[:2]))
    expected = squares_of(of_nodes, 1 << level)
    means = level_of(pyramid, level)
    middle = [squares_of(v, 1 << level) for v in (to_lamp, to_eye)]
    middle = [v / np.linalg.norm(v, axis=-1)[..., None] for v in middle]
    found = light(means[..., :3], *middle, means[..., 3])
    error = (found - expected) / expected.mean()
    of_one_node = (of_nodes[:: 1 << level, :: 1 << level] - expected) / expected.mean()
    assert np.sqrt(np.mean(error**2)) < min(most_rms, 0.35 * np.sqrt(np.mean(of_one_node**2)))
