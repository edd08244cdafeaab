from pathlib import Path

import cv2
import numpy as np
import pytest

from tronlab.terrain.albedo import read_albedo
from tronlab.terrain.heightmap import WHITE, TerrainError

pytestmark = pytest.mark.opencv


def picture(folder: Path, pixels: np.ndarray) -> Path:
    path = folder / "paint.png"
    cv2.imwrite(str(path), pixels)
    return path


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_white_is_one_and_places_stay(tmp_path: Path, dtype: type) -> None:
    white = np.iinfo(dtype).max
    pixels = np.zeros((20, 40), dtype)
    pixels[:10, :20] = white
    pixels[10:, 20:] = white // 2
    albedo = read_albedo(picture(tmp_path, pixels), (101, 201))
    assert (albedo.shape, albedo.dtype) == ((101, 201), np.uint16)
    assert (albedo[10, 10], albedo[10, 190], albedo[90, 10]) == (WHITE, 0, 0)
    assert albedo[90, 190] == pytest.approx(WHITE / 2, rel=0.01)


def test_finer_picture_is_averaged(tmp_path: Path) -> None:
    chequered = (np.indices((400, 800)).sum(axis=0) % 2 * 255).astype(np.uint8)
    albedo = read_albedo(picture(tmp_path, chequered), (51, 101))
    np.testing.assert_allclose(albedo / WHITE, 0.5, atol=0.05)


@pytest.mark.parametrize(
    ("pixels", "message"),
    [
        (np.zeros((20, 20), np.uint8), "20 x 20 pixels, the model is 2.000 times as wide as high"),
        (np.zeros((20, 40, 3), np.uint8), r"is uint8 of shape .*allowed: grey PNG"),
    ],
)
def test_unfit_picture_says_why(tmp_path: Path, pixels: np.ndarray, message: str) -> None:
    with pytest.raises(TerrainError, match=message):
        read_albedo(picture(tmp_path, pixels), (101, 201))


def test_missing_or_damaged_file(tmp_path: Path) -> None:
    with pytest.raises(TerrainError, match=r"none\.png does not exist"):
        read_albedo(tmp_path / "none.png", (101, 201))
    (tmp_path / "text.png").write_text("no picture")
    with pytest.raises(TerrainError, match="cannot be read as a picture"):
        read_albedo(tmp_path / "text.png", (101, 201))
