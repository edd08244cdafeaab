import numpy as np
import pytest

from tronlab.terrain.heightmap import HeightMap, TerrainError

ORIGIN = np.array([1.0, 2.0, 3.0])


def test_extent_relief_and_mean_height():
    heights = np.zeros((11, 21), np.float32)
    heights[:, 10] = 0.21
    heightmap = HeightMap(heights, 0.1, ORIGIN)
    assert heightmap.size_m == pytest.approx((1.0, 2.0))
    assert heightmap.relief_m == pytest.approx(0.21)
    assert heightmap.mean_height_trs_m == pytest.approx(3.01)


def with_hole():
    heights = np.zeros((5, 5), np.float32)
    heights[2, 3] = np.nan
    return heights


@pytest.mark.parametrize(
    ("heights", "spacing_m", "message"),
    [
        (np.zeros((1, 9), np.float32), 0.1, r"shape is \(1, 9\)"),
        (np.zeros((3, 3, 3), np.float32), 0.1, r"shape is \(3, 3, 3\)"),
        (with_hole(), 0.1, "1 samples are not finite; fill the holes first"),
        (np.zeros((3, 3), np.float32), 0.0, r"spacing is 0\.0 m, must be positive"),
        (np.zeros((3, 3), np.float32), float("nan"), "spacing is nan m, must be positive"),
    ],
)
def test_what_is_no_height_map_is_refused(heights, spacing_m, message):
    with pytest.raises(TerrainError, match=message):
        HeightMap(heights, spacing_m, ORIGIN)
