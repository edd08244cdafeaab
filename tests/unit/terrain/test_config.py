from pathlib import Path

import pytest
from pydantic import TypeAdapter, ValidationError

from tronlab.terrain.config import DemTerrain, FileTerrain, ProceduralTerrain, TerrainConfig


def test_the_default_is_the_laboratorys_model():
    config = ProceduralTerrain()
    assert config.shape == (4401, 8401)
    assert config.relief_m == pytest.approx(0.26)


def test_kind_chooses_the_model():
    adapter = TypeAdapter(TerrainConfig)
    assert isinstance(adapter.validate_python({"kind": "procedural", "seed": 3}), ProceduralTerrain)
    assert isinstance(adapter.validate_python({"kind": "file", "path": "a.png"}), FileTerrain)
    dem = adapter.validate_python({"kind": "dem", "path": "a.npy", "origin_trs_m": (0, 0, 1)})
    assert isinstance(dem, DemTerrain)
    with pytest.raises(ValidationError, match="'procedural', 'file', 'dem'"):
        adapter.validate_python({"kind": "mesh"})


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"size_m": (10, 10), "spacing_m": 0.0001},
            "100001 x 100001 samples are too many .*make spacing_m larger",
        ),
        ({"size_m": (0.05, 4.2), "spacing_m": 0.01}, "6 x 421 samples are too few"),
        ({"size_m": (2.2, 0.0)}, "greater than or equal to 0.02"),
        ({"size_m": (2.2,)}, "size_m"),
        ({"relief_m": 0.0}, "greater than 0"),
        ({"relief_m": float("nan")}, "finite number"),
        ({"spacing_m": 1.0}, "less than or equal to 0.01"),
        ({"seed": -1}, "greater than or equal to 0"),
        ({"crater_largest_m": 0.005}, "crater_largest_m is 0.005, must be more than"),
        ({"crater_density_per_m2": 0, "roughness_slope": 0}, "the terrain would be flat"),
        ({"relief_mm": 260}, "Extra inputs are not permitted"),
    ],
)
def test_what_cannot_be_is_refused(settings, message):
    with pytest.raises(ValidationError, match=message):
        ProceduralTerrain(**settings)


def test_only_a_terrain_that_can_stay_in_its_file_may_be_of_any_size():
    assert ProceduralTerrain(size_m=(20, 20)).shape == (40001, 40001)
    with pytest.raises(ValidationError, match="40001 x 40001 samples are too many"):
        FileTerrain(path=Path("a.png"), size_m=(20, 20), spacing_m=0.0005)


def test_a_crop_has_four_numbers():
    with pytest.raises(ValidationError, match="crop_px"):
        FileTerrain(path=Path("a.png"), crop_px=(0, 0, 100))  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValidationError, match="greater than or equal to 8"):
        FileTerrain(path=Path("a.png"), crop_px=(0, 0, 100, 7))
