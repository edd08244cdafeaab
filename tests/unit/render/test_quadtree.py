"""The quadtrees: every square holds the highest sample it covers, in memory as in a file."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hypothesis_numpy

from tronlab.render import quadtree
from tronlab.render.quadtree import grid_of, make_grid
from tronlab.terrain.dem import open_dem, save_dem
from tronlab.terrain.heightmap import HeightMap, TerrainError
from tronlab.terrain.new_file import check_disk_space


def highest_within(heights, rows, columns):
    """The highest sample of the cells in a range of rows and columns; -inf without any cell."""
    (top, bottom), (left, right) = (
        (max(begin, 0), min(end, n - 1))
        for (begin, end), n in zip((rows, columns), heights.shape, strict=True)
    )
    has_cells = top < bottom and left < right
    return heights[top : bottom + 1, left : right + 1].max() if has_cells else -np.inf


@settings(max_examples=40, deadline=None)
@given(
    hypothesis_numpy.arrays(
        np.float32,
        st.tuples(st.integers(2, 21), st.integers(2, 21)),
        elements=st.floats(-1, 1, width=32),
    )
)
def test_every_square_holds_its_highest_sample(heights):
    grid = make_grid(heights, 0.01)
    n_rows, n_columns = heights.shape
    for level in range(1, grid.level_columns.size):
        width = 1 << level
        columns = grid.level_columns[level]
        rows = -(-(n_rows - 1) // width)
        assert columns == -(-(n_columns - 1) // width)
        for i in range(rows):
            for j in range(columns):
                found = grid.node_max_m[grid.level_start[level] + i * columns + j]
                assert found == highest_within(
                    heights, (i * width, (i + 1) * width), (j * width, (j + 1) * width)
                )
    for level in range(2, grid.wide_columns.size):
        width, half = 1 << level, 1 << (level - 1)
        for i in range(-1, -(-(n_rows - 1) // width) + 1):
            for j in range(-1, grid.wide_columns[level] - 1):
                found = grid.wide_max_m[grid.wide_start[level] + i * grid.wide_columns[level] + j]
                assert found == highest_within(
                    heights,
                    (i * width - half, (i + 1) * width + half),
                    (j * width - half, (j + 1) * width + half),
                )
    assert (grid.top_m, grid.bottom_m) == (heights.max(), heights.min())


@pytest.fixture
def mapped(tmp_path, monkeypatch):
    """A height map in a file, which counts as too large for memory."""
    monkeypatch.setattr(quadtree, "MAX_SAMPLES_IN_MEMORY", 1000)
    monkeypatch.setattr(quadtree, "_BAND_BYTES", 5000)
    monkeypatch.setattr(quadtree, "cache_folder", lambda: tmp_path / "cache")
    heights = np.random.default_rng(2).random((133, 79), dtype=np.float32)
    save_dem(tmp_path / "model.npy", HeightMap(heights, 0.01, np.zeros(3)), made_by={})
    return open_dem(tmp_path / "model.npy")


def assert_equal(found, expected):
    for name, value, wanted in zip(expected._fields, found, expected, strict=True):
        np.testing.assert_array_equal(value, wanted, err_msg=name)
        assert type(value) is type(wanted), name


def test_a_large_maps_quadtree_is_kept_in_a_file(mapped, tmp_path, monkeypatch, caplog):
    expected = make_grid(mapped.height_m, 0.01)
    assert_equal(grid_of(mapped), expected)
    (kept,) = (tmp_path / "cache").iterdir()
    with monkeypatch.context() as patch:
        patch.setattr(quadtree, "_write_maxima", lambda *_: pytest.fail("was built again"))
        assert_equal(grid_of(mapped), expected)
    kept.write_bytes(kept.read_bytes()[:-4])
    assert_equal(grid_of(mapped), expected)
    assert "is damaged and is made again" in caplog.text
    kept.write_bytes(bytes(kept.stat().st_size))
    assert_equal(grid_of(mapped), expected)


def test_a_small_maps_quadtree_is_built_in_memory(mapped, tmp_path, monkeypatch):
    monkeypatch.setattr(quadtree, "MAX_SAMPLES_IN_MEMORY", 1_000_000)
    assert_equal(grid_of(mapped), make_grid(mapped.height_m, 0.01))
    assert not (tmp_path / "cache").exists()


def test_without_room_for_the_file_it_says_so(mapped, monkeypatch):
    monkeypatch.setattr(quadtree.NewFile, "__enter__", lambda self: full(self.path.parent))
    with pytest.raises(TerrainError, match="are needed"):
        grid_of(mapped)


def full(folder):
    check_disk_space(folder, 10**18)
