import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tronlab.terrain import resampling
from tronlab.terrain.heightmap import TerrainError
from tronlab.terrain.resampling import resample, resample_to_spacing

SPACING_M = (0.001, 0.001)


def waves(shape, wave_px, axis):
    phase = 2 * np.pi * np.arange(shape[axis]) / wave_px
    return np.broadcast_to(np.cos(phase) if axis else np.cos(phase)[:, None], shape).copy()


@settings(max_examples=25, deadline=None)
@given(
    slopes=st.tuples(st.floats(-2, 2), st.floats(-2, 2)),
    shape=st.tuples(st.integers(8, 70), st.integers(8, 70)),
)
def test_a_cubic_surface_is_met_exactly_by_a_finer_grid(slopes, shape):
    rows, columns = 8 + shape[0] // 10, 8 + shape[1] // 10
    new = (rows + shape[0], columns + shape[1])

    def surface(n_rows, n_columns):
        x, y = np.linspace(0, 1, n_rows)[:, None], np.linspace(0, 1, n_columns)
        return slopes[0] * x**3 + slopes[1] * y**2 * x - y

    height, loss = resample(surface(rows, columns), SPACING_M, new)
    np.testing.assert_allclose(height, surface(*new), atol=1e-12)
    assert loss.largest_m < 1e-12
    assert abs(loss.lost_relief_share) < 0.2


@pytest.mark.parametrize(
    ("wave_in_new_samples", "kept"),
    [(32, np.exp(-(np.pi**2) / 2 / 32**2)), (8, 0.926), (4, 0.735), (2.5, 0.454)],
)
@pytest.mark.parametrize("axis", [0, 1])
def test_a_coarser_grid_damps_waves_as_stated(wave_in_new_samples, kept, axis):
    """exp(-2 pi^2 sigma^2 / wave^2) is a Gaussian's transfer function."""
    old = waves((361, 361), 4 * wave_in_new_samples, axis)
    height, _ = resample(old, SPACING_M, (91, 91))
    expected = waves((91, 91), wave_in_new_samples, axis)[10:-10, 10:-10]
    share = np.sum(height[10:-10, 10:-10] * expected) / np.sum(expected**2)
    assert share == pytest.approx(kept, abs=0.003)


def test_waves_too_short_for_the_grid_do_not_alias():
    height, loss = resample(waves((301, 301), 4.3, 1), SPACING_M, (76, 76))
    assert np.abs(height[5:-5, 5:-5]).max() == pytest.approx(0.0140, abs=3e-4)
    assert loss.rms_m == pytest.approx(np.sqrt(0.5), rel=0.02)
    assert loss.lost_relief_share > 0.7


def test_the_loss_is_what_the_way_back_shows():
    old = waves((161, 201), 23.0, 0) * waves((161, 201), 31.0, 1)
    height, loss = resample(old, SPACING_M, (81, 101))
    back, _ = resample(height, (0.002, 0.002), old.shape)
    assert loss.rms_m == pytest.approx(np.sqrt(np.mean((back - old) ** 2)), rel=1e-6)
    assert loss.largest_m == pytest.approx(np.abs(back - old).max(), rel=1e-6)
    assert loss.shortest_wave_m == pytest.approx((0.004, 0.004))
    assert loss.lost_relief_share == pytest.approx(1 - np.ptp(height) / np.ptp(old))
    assert str(loss.scaled(1e-3)).startswith("resampling changed heights by ")
    assert str(loss).endswith("the shortest waves left are 4 mm long")


def test_bands_leave_no_seam(monkeypatch):
    old = np.random.default_rng(5).standard_normal((500, 60)).cumsum(axis=0).astype(np.float32)
    whole, loss = resample(old, SPACING_M, (330, 91))
    monkeypatch.setattr(resampling, "_SAMPLES_AT_ONCE", 60 * 150)
    told = []
    banded, banded_loss = resample(
        old, SPACING_M, (330, 91), on_progress=lambda done, n: told.append((done, n))
    )
    np.testing.assert_allclose(banded, whole, rtol=0, atol=np.spacing(np.abs(whole).max()))
    assert banded_loss.rms_m == pytest.approx(loss.rms_m, rel=1e-9)
    assert len(told) > 6
    assert told[-1] == (830, 830)
    assert banded.dtype == np.float32


def test_a_grid_too_large_is_refused_before_it_is_made():
    for grid in (resample, resample_to_spacing):
        wanted = (10**6, 10**6) if grid is resample else 1e-9
        with pytest.raises(TerrainError, match=r"new grid would have .*at most 2147483647"):
            grid(np.zeros((20, 30)), SPACING_M, wanted)


def test_squares_of_a_new_size_begin_at_the_same_corner():
    x, y = 0.001 * np.arange(41)[:, None], 0.002 * np.arange(31)
    height, loss = resample_to_spacing(3 * x - y, (0.001, 0.002), 0.003)
    assert height.shape == (14, 21)
    new_x, new_y = 0.003 * np.arange(14)[:, None], 0.003 * np.arange(21)
    inside = np.s_[1:-1, 1:-1]
    np.testing.assert_allclose(height[inside], (3 * new_x - new_y)[inside], atol=3e-4)
    assert loss.shortest_wave_m == pytest.approx((0.006, 0.006))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda h: resample(h, SPACING_M, (7, 20)), "the new grid is 7 x 20, needed are at least"),
        (lambda h: resample(h[:5], SPACING_M, (20, 20)), "the old grid is 5 x 20"),
        (lambda h: resample(h * np.nan, SPACING_M, (20, 20)), "have holes; fill them first"),
        (lambda h: resample_to_spacing(h, SPACING_M, 0.0), "new spacing is 0.0 m, must be posit"),
        (lambda h: resample_to_spacing(h, SPACING_M, 9.0), "the new grid is 1 x 1"),
    ],
)
def test_what_cannot_be_resampled(make, message):
    with pytest.raises(TerrainError, match=message):
        make(np.ones((20, 20)))
