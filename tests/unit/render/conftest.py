import numpy as np
import pytest

from tronlab.geometry.camera import CameraModel
from tronlab.terrain.config import ProceduralTerrain
from tronlab.terrain.heightmap import HeightMap
from tronlab.terrain.procedural import make_terrain


@pytest.fixture(scope="session")
def heightmap() -> HeightMap:
    """A cratered terrain of 0.45 x 0.6 m, 301 x 401 samples, relief 50 mm."""
    config = ProceduralTerrain(
        size_m=(0.45, 0.6),
        spacing_m=0.0015,
        relief_m=0.05,
        crater_largest_m=0.2,
        origin_trs_m=(-0.02, -0.03, -0.02),
    )
    return HeightMap(make_terrain(config), config.spacing_m, np.array(config.origin_trs_m))


@pytest.fixture(scope="session")
def camera() -> CameraModel:
    """A small camera of 67 degrees with barrel and tangential distortion."""
    return CameraModel(320, 300, 230.0, 232.0, 161.0, 148.0, (-0.15, 0.05, 0.001, -0.0008, 0.0))
