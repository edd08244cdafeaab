"""Statistics of surfaces whose answer is known."""

import numpy as np
import pytest

from tronlab.terrain.config import ProceduralTerrain
from tronlab.terrain.crater_counts import count_craters, craters_of, law_per_m2
from tronlab.terrain.craters import Craters, stamp_craters
from tronlab.terrain.overview import overview
from tronlab.terrain.procedural import make_terrain, rough_surface
from tronlab.terrain.statistics import (
    SelfAffine,
    deviogram,
    facet_gradients,
    fit_power_law,
    hurst_fit,
    profile_spectrum,
    rms_slope,
    root_mean_square,
)

SPACING = (0.001, 0.001)


def plane(rise_x, rise_y, shape=(60, 90)):
    x, y = (0.001 * np.arange(n) for n in shape)
    return 1000.0 + rise_x * x[:, None] + rise_y * y


def self_affine(hurst, *, slope=0.1, shape=(700, 2000), seed=5):
    """Make a surface far shorter than its longest wave, as theory has it: endless."""
    return rough_surface(
        np.random.default_rng(seed),
        shape,
        spacing_m=0.001,
        hurst_exponent=hurst,
        slope=slope,
        longest_wave_m=10.0,
    )


def test_a_plane_has_its_slope_and_no_roughness():
    tilted = plane(0.3, 0.4)
    gradients = facet_gradients(tilted, SPACING)
    assert gradients.size == 2 * 59 * 89
    np.testing.assert_allclose(gradients, 0.5, rtol=1e-4)
    for axis in (0, 1):
        assert np.all(deviogram(tilted, SPACING, axis=axis).deviation_m < 1e-9)
    assert hurst_fit([deviogram(np.zeros((200, 200)), SPACING, axis=1)], 0.001) is None


def test_facets_are_divided_as_the_renderer_divides_cells():
    """One raised corner tilts only the triangle it belongs to, if it is off the diagonal."""
    off_diagonal, on_diagonal = np.zeros((2, 2)), np.zeros((2, 2))
    off_diagonal[0, 1] = 0.002
    on_diagonal[0, 0] = 0.002
    np.testing.assert_allclose(
        sorted(facet_gradients(off_diagonal, SPACING)), [0.0, np.hypot(2, 2)], rtol=1e-6
    )
    np.testing.assert_allclose(facet_gradients(on_diagonal, SPACING), [2.0, 2.0], rtol=1e-6)


def test_unequal_spacing_and_holes():
    heights = plane(0.3, 0.4)
    heights[20:23, 30] = np.nan
    gradients = facet_gradients(heights, (0.002, 0.001))
    np.testing.assert_allclose(gradients, np.hypot(0.15, 0.4), rtol=1e-4)
    # Three holes in a column: six cells have a corner in them twice or once.
    assert gradients.size == 2 * 59 * 89 - 3 * 6 + 2 * 2
    assert np.all(np.isfinite(deviogram(heights, SPACING, axis=0).deviation_m))


def test_many_facets_are_represented_by_some():
    rough = self_affine(0.8, shape=(400, 500))
    every = root_mean_square(facet_gradients(rough, SPACING))
    some = facet_gradients(rough, SPACING, most=40_000)
    assert some.size <= 41_000
    assert root_mean_square(some) == pytest.approx(every, rel=0.03)


def test_the_deviogram_of_a_sine_is_known():
    """sqrt(mean (z(x + s) - z(x))^2) = A sqrt(1 - cos(2 pi s / L)) over whole waves."""
    wave, amplitude = 0.02, 0.003
    y = 0.001 * np.arange(4001)
    heights = np.tile(amplitude * np.sin(2 * np.pi * y / wave), (12, 1))
    found = deviogram(heights, SPACING, axis=1)
    expected = amplitude * np.sqrt(1 - np.cos(2 * np.pi * found.step_m / wave))
    np.testing.assert_allclose(found.deviation_m, expected, atol=0.02 * amplitude)
    assert np.all(deviogram(heights, SPACING, axis=0).deviation_m == 0)


@pytest.mark.parametrize("hurst", [0.3, 0.5, 0.8])
def test_a_self_affine_surface_has_the_exponent_it_was_made_with(hurst):
    surface = self_affine(hurst)
    both = [deviogram(surface, SPACING, axis=axis) for axis in (0, 1)]
    fit = hurst_fit(both, 0.001)
    assert fit is not None
    assert fit.exponent == pytest.approx(hurst, abs=0.06)
    assert rms_slope(surface, SPACING, 0.01, axis=1) == pytest.approx(0.1, rel=0.03)
    spectrum = profile_spectrum(surface, SPACING)
    assert spectrum is not None
    middle = (spectrum.wavenumber_per_m > 5) & (spectrum.wavenumber_per_m < 100)
    slope = fit_power_law(spectrum.wavenumber_per_m[middle], spectrum.density_m3[middle]).exponent
    assert slope == pytest.approx(-(2 * hurst + 1), abs=0.15)


@pytest.mark.parametrize("hurst", [0.3, 0.5, 0.8])
def test_the_spectrum_of_theory_has_the_deviation_of_theory(hurst):
    """Integrated numerically: variance of a difference = 2 * integral S(k) (1 - cos 2 pi k s)."""
    theory = SelfAffine(hurst, slope=0.12, base_m=0.01)
    k = np.geomspace(1e-5, 1e7, 400_001)
    for step_m in (0.003, 0.01, 0.1):
        integrand = 2 * theory.density_m3(k) * 2 * np.sin(np.pi * k * step_m) ** 2
        variance = np.trapezoid(integrand, k)
        assert np.sqrt(variance) == pytest.approx(theory.deviation_m(np.array(step_m)), rel=0.01)


def test_the_spectrum_is_that_of_the_variance():
    noise = np.random.default_rng(1).normal(0, 0.002, (300, 1024))
    spectrum = profile_spectrum(noise, SPACING)
    assert spectrum is not None
    # White noise: its variance spread evenly up to the Nyquist wave number.
    np.testing.assert_allclose(spectrum.density_m3, 0.002**2 / 500, rtol=0.12)
    noise[:, 7] = np.nan
    assert profile_spectrum(noise, SPACING) is None


def test_the_rms_slope_between_samples_follows_the_power_law():
    surface = self_affine(0.7)
    exact = rms_slope(surface, SPACING, 0.012, axis=1)
    odd = rms_slope(surface[:, ::5], (0.001, 0.005), 0.012, axis=1)
    assert odd == pytest.approx(exact, rel=0.03)
    assert np.isnan(rms_slope(surface, SPACING, 0.0005, axis=1))
    assert np.isnan(rms_slope(surface, SPACING, 5.0, axis=1))


def test_the_overview_averages_and_leaves_holes():
    heights = np.arange(7 * 11, dtype=np.float32).reshape(7, 11)
    heights[0, 0] = np.nan
    heights[2:4, 4:6] = np.nan
    steps: list[tuple[int, int]] = []
    shown, n = overview(heights, most_samples=20, on_progress=lambda *step: steps.append(step))
    assert (n, shown.shape) == (2, (3, 5))
    assert shown[0, 0] == pytest.approx(np.mean([1, 11, 12]))
    assert shown[2, 4] == pytest.approx(heights[4:6, 8:10].mean())
    assert np.isnan(shown[1, 2])
    assert np.count_nonzero(np.isnan(shown)) == 1
    assert steps[-1] == (3, 3)
    whole, n = overview(heights, most_samples=77)
    assert n == 1
    np.testing.assert_array_equal(whole, heights)


def test_craters_are_those_of_the_terrain():
    """Without roughness, and with too little relief for hills, there is nothing else."""
    config = ProceduralTerrain(
        size_m=(0.3, 0.4),
        spacing_m=0.002,
        relief_m=0.001,
        roughness_slope=0,
        crater_largest_m=0.1,
        seed=3,
    )
    alone = np.zeros(config.shape, dtype=np.float32)
    stamp_craters(alone, config.spacing_m, craters_of(config))
    assert np.corrcoef(make_terrain(config).ravel(), alone.ravel())[0, 1] > 0.99999


def test_craters_on_the_model_are_counted_from_each_diameter_on():
    craters = Craters(
        diameter_m=np.array([0.5, 0.2, 0.1, 0.1, 0.05]),
        x_m=np.array([1.0, -0.1, 2.0, 0.0, 0.3]),
        y_m=np.array([1.0, 0.5, 3.0, 0.0, 3.1]),
        wear=np.zeros(5),
    )
    counts = count_craters(craters, (2.0, 3.0), 0.05)
    np.testing.assert_allclose(counts.diameter_m, 0.05 * np.sqrt(2) ** np.arange(7))
    np.testing.assert_array_equal(counts.n_craters, [3, 3, 3, 1, 1, 1, 1])
    assert counts.density_per_m2[0] == pytest.approx(0.5)
    assert counts.standard_error_per_m2[0] == pytest.approx(np.sqrt(3) / 6)


def test_no_crater_on_the_model_is_a_count_of_zero():
    none = Craters(np.empty(0), np.empty(0), np.empty(0), np.empty(0))
    counts = count_craters(none, (2.0, 3.0), 0.05)
    np.testing.assert_array_equal(counts.n_craters, [0])


def test_counts_of_many_terrains_agree_with_the_law():
    configs = [
        ProceduralTerrain(size_m=(2, 3), spacing_m=0.01, crater_smallest_m=0.02, seed=seed)
        for seed in range(30)
    ]
    diameter = np.array([0.02, 0.04, 0.08, 0.16])
    counted = np.zeros(4)
    for config in configs:
        counts = count_craters(craters_of(config), config.size_m, 0.02)
        counted += counts.n_craters[[0, 2, 4, 6]]
    expected = law_per_m2(configs[0], diameter) * 6 * len(configs)
    assert np.all(np.abs(counted - expected) < 4 * np.sqrt(expected))
    assert law_per_m2(configs[0], np.array([2.0])) == 0
