import numpy as np
import pytest

from tronlab.terrain.craters import (
    FRESH_DEPTH,
    FRESH_RIM,
    REACH,
    Craters,
    crater_profiles,
    draw_craters,
    stamp_craters,
)


def draw(seed, *, exponent=2.0, density=0.2):
    return draw_craters(
        np.random.default_rng(seed),
        (2.0, 3.0),
        exponent=exponent,
        density_per_m2=density,
        smallest_m=0.01,
        largest_m=0.5,
    )


@pytest.mark.parametrize(("exponent", "n_models"), [(1.8, 20), (2.0, 20), (3.0, 4)])
def test_counts_follow_the_law(exponent, n_models):
    drawn = [draw(seed, exponent=exponent, density=0.02) for seed in range(n_models)]
    area = 2.0 * 3.0 * len(drawn)
    for d in (0.01, 0.02, 0.05, 0.1):
        count = 0
        for craters in drawn:
            is_inside = (np.abs(craters.x_m - 1) < 1) & (np.abs(craters.y_m - 1.5) < 1.5)
            count += np.count_nonzero(is_inside & (craters.diameter_m > d))
        expected = 0.02 * area * (d**-exponent - 0.5**-exponent)
        assert abs(count - expected) < 4 * np.sqrt(expected) + 1


def test_craters_come_widest_first_within_limits_and_touch_the_map():
    craters = draw(1)
    assert np.all(np.diff(craters.diameter_m) <= 0)
    assert craters.diameter_m.min() >= 0.01
    assert craters.diameter_m.max() <= 0.5
    reach = REACH * craters.diameter_m / 2
    assert np.all((craters.x_m > -reach) & (craters.x_m < 2 + reach))
    assert np.any(craters.x_m < 0), "craters outside whose ejecta reach in belong to the terrain"


def test_profiles_start_fresh_and_wear_down():
    profiles = crater_profiles()
    assert profiles[0, 0] == pytest.approx(-FRESH_DEPTH)
    assert profiles[0].max() == pytest.approx(FRESH_RIM, rel=0.1)
    assert np.all(np.diff(profiles[:, 0]) > 0), "the floor rises"
    assert np.all(np.diff(profiles.max(axis=1)) < 0), "the rim falls"
    assert np.all(profiles[:, -1] == 0)


def test_wear_moves_material_but_keeps_it():
    profiles = crater_profiles().astype(np.float64)
    r = np.linspace(0, REACH, profiles.shape[1])
    volumes = np.trapezoid(profiles * r, r, axis=1)
    bowl = np.trapezoid(np.minimum(profiles[0], 0) * r, r)
    assert np.all(np.abs(volumes - volumes[0]) < 0.1 * abs(bowl)), "little leaves at the edge"


def test_a_stamped_crater_has_its_profile():
    height = np.zeros((201, 251), dtype=np.float32)
    one = Craters(np.array([0.05]), np.array([0.1]), np.array([0.12]), np.array([0.0]))
    stamp_craters(height, 0.001, one)
    assert height[100, 120] == pytest.approx(-FRESH_DEPTH * 0.05, rel=1e-3)
    assert height[100, 145] == pytest.approx(FRESH_RIM * 0.05, rel=0.15)
    np.testing.assert_allclose(height[100, 120:160], height[100, 120:80:-1], atol=1e-7)
    np.testing.assert_allclose(height[100:140, 120], height[100, 120:160], atol=1e-7)
    assert height[0, 0] == 0


def test_stamping_outside_the_map_is_cut_at_its_border():
    height = np.zeros((60, 70), dtype=np.float32)
    craters = Craters(
        np.array([0.05, 0.02, 0.02]),
        np.array([-0.01, 0.065, 5.0]),
        np.array([0.03, -0.005, 5.0]),
        np.array([0.0, 0.5, 1.0]),
    )
    stamp_craters(height, 0.001, craters)
    assert height[0, 30] < -0.005
    assert np.isfinite(height).all()
