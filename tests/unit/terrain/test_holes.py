import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.lib.stride_tricks import sliding_window_view

from tronlab.terrain.heightmap import TerrainError
from tronlab.terrain.holes import fill_holes


def harmonic(shape, datum=0.0):
    """Give a surface that satisfies the five-point Laplace equation exactly."""
    x, y = np.arange(shape[0])[:, None] / 10, np.arange(shape[1]) / 10
    return datum + x**2 - y**2 + 0.3 * x * y - 2 * x


def with_holes(height, *holes):
    height = height.copy()
    for rows, columns in holes:
        height[rows, columns] = np.nan
    return height


@pytest.mark.parametrize("datum", [0.0, 1737400.0])
def test_a_harmonic_surface_comes_back(datum):
    true = harmonic((60, 80), datum)
    holes = [(slice(5, 30), slice(10, 40)), (slice(35, 55), 60), (50, slice(5, 55)), (2, 2)]
    given_m = with_holes(true, *holes)
    filled, n_filled = fill_holes(given_m, widest_px=25)
    assert n_filled == np.count_nonzero(np.isnan(given_m))
    np.testing.assert_allclose(filled, true, atol=1e-8)
    known = ~np.isnan(given_m)
    np.testing.assert_array_equal(filled[known], given_m[known])


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.05, 0.9))
def test_nothing_is_higher_or_lower_than_what_is_around(seed, share):
    rng = np.random.default_rng(seed)
    height = rng.standard_normal((20, 24)).astype(np.float32)
    height[rng.random(height.shape) < share] = [np.nan, np.inf, -np.inf][seed % 3]
    known = height[np.isfinite(height)]
    filled, _ = fill_holes(height, widest_px=24)
    assert filled.dtype == np.float32
    assert filled.min() >= known.min() - 1e-6
    assert filled.max() <= known.max() + 1e-6


def widest_square(is_hole):
    """Try every square on the map and its mirror images."""
    rows, columns = is_hole.shape
    mirrored = np.pad(is_hole, max(rows, columns), mode="symmetric")
    middle = np.s_[: rows + 1, : columns + 1]
    for width in range(2 * max(rows, columns), 0, -1):
        reach = max(rows, columns) - width // 2
        squares = sliding_window_view(mirrored, (width, width)).all(axis=(2, 3))
        if squares[reach:, reach:][middle].any():
            return width
    return 0


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.integers(0, 6))
def test_what_is_too_wide_is_so_by_its_widest_square(seed, n_boxes):
    rng = np.random.default_rng(seed)
    is_hole = np.zeros((9, 12), dtype=bool)
    for _ in range(n_boxes):
        row, column, height, width = rng.integers((0, 0, 1, 1), (9, 12, 6, 6))
        is_hole[row : row + height, column : column + width] = True
    height = np.where(is_hole, np.nan, 1.0)
    widest_px = widest_square(is_hole)
    assert fill_holes(height, widest_px=widest_px)[1] == np.count_nonzero(is_hole)
    if widest_px:
        with pytest.raises(TerrainError, match=f"is wider than {widest_px - 1} samples"):
            fill_holes(height, widest_px=widest_px - 1)


def test_a_hole_at_the_border_is_mirrored():
    true = np.repeat(np.linspace(0, 1, 30)[:, None], 20, axis=1)
    filled, n_filled = fill_holes(with_holes(true, (slice(10, 20), slice(0, 5))), widest_px=10)
    assert n_filled == 50
    np.testing.assert_allclose(filled, true, atol=1e-9)


def test_without_holes_nothing_is_done():
    height = harmonic((9, 9))
    filled, n_filled = fill_holes(height, widest_px=0)
    assert filled is height
    assert n_filled == 0


@pytest.mark.parametrize(
    ("hole", "widest_px"),
    [
        ((slice(20, 27), slice(3, 13)), 6),
        ((slice(50, 60), slice(40, 43)), 2),
        ((slice(0, 60), slice(70, 80)), 19),
        ((slice(52, 60), slice(0, 7)), 13),
    ],
)
def test_a_wide_hole_is_refused_by_place(hole, widest_px):
    height = with_holes(harmonic((60, 80)), (5, 5), hole)
    rows, columns = hole
    where = (
        f"rows {rows.start} to {rows.stop - 1}, columns {columns.start} to {columns.stop - 1} is"
        f" wider than {widest_px} samples.* in 2 holes"
    )
    with pytest.raises(TerrainError, match=where):
        fill_holes(height, widest_px=widest_px)
    filled, _ = fill_holes(height, widest_px=widest_px + 1)
    assert np.isfinite(filled).all()


def test_no_height_at_all():
    with pytest.raises(TerrainError, match="all samples are holes"):
        fill_holes(np.full((9, 9), np.nan), widest_px=3)
