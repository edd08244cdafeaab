"""The scan simulator: what it adds is what it says."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from scipy.optimize import least_squares
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.terrain import scan as scan_module
from tronlab.terrain.heightmap import HeightMap, TerrainError
from tronlab.terrain.scan import ScanConfig, scan

SPACING_M = 0.004


def smooth(shape=(120, 160), origin=(0.1, -0.2, -0.05)):
    """Waves of 0.15 m and more, 60 mm high: slopes up to 1."""
    x, y = np.mgrid[: shape[0], : shape[1]] * SPACING_M
    heights = 0.02 * np.sin(40 * x + 10 * y) + 0.01 * np.cos(30 * y - 12 * x) + 0.05
    return HeightMap(heights.astype(np.float32), SPACING_M, np.array(origin))


def flat(shape=(400, 500)):
    return HeightMap(np.zeros(shape, np.float32), SPACING_M, np.array([0.1, -0.2, -0.05]))


def test_a_perfect_scan_is_the_terrain():
    truth = smooth()
    found = scan(truth, ScanConfig())
    np.testing.assert_allclose(found.heightmap.height_m, truth.height_m, atol=1e-7)
    assert found.heightmap.spacing_m == truth.spacing_m
    np.testing.assert_array_equal(found.heightmap.origin_trs_m, truth.origin_trs_m)
    np.testing.assert_array_equal(found.scan_from_true.as_matrix(), np.eye(4))
    assert (found.n_holes_filled, found.n_outside) == (0, 0)


def test_another_spacing_samples_the_same_triangles():
    truth = smooth()
    coarse = scan(truth, ScanConfig(spacing_m=2 * SPACING_M)).heightmap
    np.testing.assert_allclose(coarse.height_m, truth.height_m[::2, ::2], atol=1e-7)
    fine = scan(truth, ScanConfig(spacing_m=SPACING_M / 2)).heightmap
    assert fine.height_m.shape == (239, 319)
    corners = truth.height_m[:-1, :-1] + truth.height_m[1:, 1:]  # the diagonal's ends
    np.testing.assert_allclose(fine.height_m[1::2, 1::2], corners / 2, atol=1e-7)


def test_the_noise_has_the_level_asked_for_and_no_memory():
    noise = scan(flat(), ScanConfig(noise_sigma_m=2e-4)).heightmap.height_m
    assert noise.std() == pytest.approx(2e-4, rel=0.01)
    assert abs(np.mean(noise[1:] * noise[:-1])) < 0.01 * noise.var()


def test_shared_noise_is_correlated_as_asked():
    """A Gauss curve: 1/e at the correlation length, 1/e^4 at twice of it."""
    config = ScanConfig(correlated_sigma_m=3e-4, correlation_length_m=5 * SPACING_M)
    noise = scan(flat(), config).heightmap.height_m.astype(float)
    assert noise.std() == pytest.approx(3e-4, rel=0.06)
    for axis in (0, 1):
        lanes = np.moveaxis(noise, axis, 0)
        for lag, expected in [(5, np.exp(-1)), (10, np.exp(-4))]:
            found = np.mean(lanes[lag:] * lanes[:-lag]) / noise.var()
            assert found == pytest.approx(expected, abs=0.06)


def test_the_spot_blurs_as_a_gauss_curve_does():
    """A wave is damped by exp(-(2 pi sigma / wave)^2 / 2), sigma a quarter of the diameter."""
    wave_m = 20 * SPACING_M
    y = np.arange(400) * SPACING_M
    heights = np.tile(np.cos(2 * np.pi * y / wave_m), (50, 1)).astype(np.float32)
    truth = HeightMap(heights, SPACING_M, np.zeros(3))
    found = scan(truth, ScanConfig(spot_diameter_m=0.06)).heightmap.height_m
    damping = np.exp(-((2 * np.pi * 0.015 / wave_m) ** 2) / 2)
    np.testing.assert_allclose(found[:, 100:300], damping * heights[:, 100:300], atol=2e-3)


def test_the_registration_error_is_recovered_by_a_fit():
    """The inverse of the motion brings the scan's points back onto the true surface."""
    truth = smooth()
    config = ScanConfig(registration_sigma_m=0.003, registration_sigma_deg=0.5, seed=4)
    found = scan(truth, config)
    scanned = found.heightmap
    inside = np.s_[10:-10:2, 10:-10:2]
    x, y = np.mgrid[:120, :160] * SPACING_M
    points = np.stack([x[inside], y[inside], scanned.height_m[inside]], axis=-1).reshape(-1, 3)
    points = points + truth.origin_trs_m

    def off_surface(motion):
        turn = Rotation.from_rotvec(motion[:3])
        scan_from_true = RigidTransform.from_components(motion[3:], turn)
        p = scan_from_true.inv().apply(points) - truth.origin_trs_m
        height = map_coordinates(truth.height_m, p[:, :2].T / SPACING_M, order=1, mode="nearest")
        return p[:, 2] - height

    fitted = least_squares(off_surface, np.zeros(6), x_scale=[1e-2] * 3 + [1e-3] * 3).x
    actual = found.scan_from_true
    np.testing.assert_allclose(fitted[:3], actual.rotation.as_rotvec(), atol=2e-5)
    # The turn is about the model's middle, so nothing moves by more than some millimetres.
    np.testing.assert_allclose(fitted[3:], actual.translation, atol=2e-5)
    moved = actual.apply(points) - points
    assert 0.001 < np.linalg.norm(moved, axis=1).mean() < 0.02
    assert found.n_outside > 0
    assert np.abs(scanned.height_m - truth.height_m).max() > 1e-3


def test_a_moved_plane_is_a_plane_elsewhere():
    """Exact: z of a turned plane, and the shift along its normal."""
    truth = flat((100, 120))
    config = ScanConfig(registration_sigma_m=0.01, registration_sigma_deg=2.0, seed=2)
    found = scan(truth, config)
    motion = found.scan_from_true
    p_trs_m = motion.apply([0.1, -0.2, -0.05])
    normal = motion.rotation.apply([0, 0, 1])
    x, y = np.mgrid[:100, :120] * SPACING_M + np.array([0.1, -0.2])[:, None, None]
    along_normal = normal[0] * (x - p_trs_m[0]) + normal[1] * (y - p_trs_m[1])
    expected = p_trs_m[2] - along_normal / normal[2]
    np.testing.assert_allclose(found.heightmap.height_m - 0.05, expected, atol=2e-6)


def with_a_wall():
    """A wall 60 mm high across the model at rows 40 to 42."""
    heights = np.zeros((120, 100), np.float32)
    heights[40:43] = 0.06
    return HeightMap(heights, SPACING_M, np.zeros(3))


def test_what_the_scanner_does_not_see_is_filled():
    """From 0.4 m up at row -100, a wall of 60 mm at row 42 hides (142 rows) x 60 / 340 = 25."""
    truth = with_a_wall()
    scanner = (-100 * SPACING_M, 50 * SPACING_M, 0.4)
    found = scan(truth, ScanConfig(scanners_trs_m=(scanner,), noise_sigma_m=1e-6))
    middle = found.heightmap.height_m[:, 50]
    assert np.all(middle[44:66] > 1e-3)  # bridged from the wall to the ground
    assert np.all(np.diff(middle[43:66]) < 0)
    np.testing.assert_allclose(middle[69:], 0.0, atol=1e-5)
    assert found.n_holes_filled == pytest.approx(25 * 100, rel=0.1)
    other_side = (220 * SPACING_M, 50 * SPACING_M, 0.4)
    both = scan(truth, ScanConfig(scanners_trs_m=(scanner, other_side)))
    assert both.n_holes_filled == 0
    np.testing.assert_allclose(both.heightmap.height_m, truth.height_m, atol=1e-7)


def test_a_hole_too_wide_to_be_filled_is_told():
    scanner = (-100 * SPACING_M, 50 * SPACING_M, 0.4)
    config = ScanConfig(scanners_trs_m=(scanner,), widest_hole_m=0.02)
    with pytest.raises(TerrainError, match="wider than 5 samples"):
        scan(with_a_wall(), config)


def test_a_scanner_that_sees_nothing_is_told():
    config = ScanConfig(scanners_trs_m=((0.2, 0.2, -1.0),))
    with pytest.raises(TerrainError, match=r"seen from \(0.2, 0.2, -1.0\).*Z = 0\.06 m"):
        scan(with_a_wall(), config)


def test_the_same_seed_makes_the_same_scan():
    config = ScanConfig(noise_sigma_m=1e-4, registration_sigma_m=1e-3, correlated_sigma_m=1e-4)
    first, same = scan(smooth(), config), scan(smooth(), config)
    np.testing.assert_array_equal(first.heightmap.height_m, same.heightmap.height_m)
    other = scan(smooth(), config.model_copy(update={"seed": 2}))
    assert not np.array_equal(first.scan_from_true.as_matrix(), other.scan_from_true.as_matrix())


def test_what_cannot_be_scanned_is_refused(monkeypatch):
    with pytest.raises(TerrainError, match=r"spacing_m 0\.1 gives 5 x 7 samples, must give 8 x 8"):
        scan(smooth(), ScanConfig(spacing_m=0.1))
    monkeypatch.setattr(scan_module, "MAX_SAMPLES_IN_MEMORY", 1000)
    with pytest.raises(TerrainError, match="the terrain has 120 x 160 samples"):
        scan(smooth(), ScanConfig())
