"""What the commands ``tronlab terrain`` work on: a file of heights, or the terrain of a rig."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tronlab.geometry.poses import FloatArray
    from tronlab.terrain.config import ProceduralTerrain, TerrainConfig
    from tronlab.terrain.formats.model import Raster, Window
    from tronlab.terrain.heightmap import HeightMap

YAML_SUFFIXES = (".yaml", ".yml")
ORIGIN = (0.0, 0.0, 0.0)
"""Where a map that no model has been made of yet is taken to lie."""


@dataclass(frozen=True, slots=True)
class TerrainSource:
    """A terrain that was opened."""

    name: str
    raster: "Raster"
    """Its heights; of a terrain model in metres above its origin, with the model's spacing."""
    origin_trs_m: "FloatArray"
    """Where sample (0, 0) would lie at height 0, shape (3,)."""
    made_by: Mapping[str, Any]
    """How the heights were made, as far as it is known."""
    asked: "ProceduralTerrain | None" = None
    """The settings of a terrain made from a seed."""
    p_lamp_trs_m: "FloatArray | None" = None
    """Where the lamp of the rig is meant to be, shape (3,)."""


@dataclass(frozen=True, slots=True)
class NamedTerrain:
    """The section ``terrain`` of a YAML file."""

    name: str
    config: "TerrainConfig"
    base_dir: Path
    """Where the paths in it start from."""
    p_lamp_trs_m: "FloatArray | None" = None


def read_yaml(path: Path) -> NamedTerrain:
    """Read the terrain of a rig file, or of a file that has only the section ``terrain``.

    Raises:
        ConfigError: It cannot be read, has no such section, or says something that cannot be.
    """
    import numpy as np

    from tronlab.campaign.rig import load_rig
    from tronlab.terrain.section import TerrainSection
    from tronlab.yaml_variants import read_document

    document = read_document(path)
    keys = document.values.keys()
    if "laboratory" in keys:
        rig = load_rig(path)
        p_lamp_trs_m = np.array(rig.config.laboratory.lamp.p_trs_m, dtype=np.float64)
        return NamedTerrain(
            f"rig {rig.name}",
            rig.config.terrain,
            rig.path.parent,
            p_lamp_trs_m=p_lamp_trs_m,
        )
    if "rig" in keys:
        raise document.error("the file is a campaign; give the rig file that stands here", "rig")
    section = document.read_as(TerrainSection)
    return NamedTerrain(path.stem, section.terrain, path.parent)


def open_source(
    path: Path,
    *,
    window: "Window | None" = None,
    height_unit_m: float | None = None,
    announce: Callable[[str], None],
) -> TerrainSource:
    """Open a file of heights, or make the terrain of a rig.

    Args:
        path: .npy with or without a description beside it, .png, .tif, .img, .lbl, or .yaml.
        window: First row, first column, rows and columns of the part to use; None: all of it.
        height_unit_m: Height of 1 in a file that does not say its unit; of another it is refused.
        announce: Is told what takes time and what was settled.

    Raises:
        TerrainError: It cannot be read.
        ConfigError: A YAML file says something that cannot be.
    """
    from dataclasses import replace

    from tronlab.terrain.conversion import with_unit

    source = _opened(path, window, announce)
    if height_unit_m is None:
        return source
    return replace(source, raster=with_unit(source.raster, height_unit_m))


def _opened(path: Path, window: "Window | None", announce: Callable[[str], None]) -> TerrainSource:
    from tronlab.terrain.dem import description_path

    if path.suffix.lower() in YAML_SUFFIXES:
        return _of_yaml(path, window, announce)
    if path.suffix.lower() == ".npy" and description_path(path).is_file():
        return _of_dem(path, window)
    return _of_raster(path, window, announce)


def _of_yaml(path: Path, window: "Window | None", announce: Callable[[str], None]) -> TerrainSource:
    from tronlab.terrain.config import DemTerrain
    from tronlab.terrain.dem import describe_dem
    from tronlab.terrain.load import load_terrain

    named = read_yaml(path)
    heightmap = load_terrain(named.config, base_dir=named.base_dir, announce=announce)
    tell_of_albedo(named.config, announce)
    made_by = named.config.model_dump(mode="json")
    if isinstance(named.config, DemTerrain):
        made_by = describe_dem(named.base_dir / named.config.path).made_by
    raster, origin_trs_m = _part(heightmap, window, path)
    asked = procedural_settings(made_by) if window is None else None
    return TerrainSource(named.name, raster, origin_trs_m, made_by, asked, named.p_lamp_trs_m)


def tell_of_albedo(config: "TerrainConfig", announce: Callable[[str], None]) -> None:
    """Say that these commands work on heights alone, if the terrain is painted."""
    if config.albedo_map is not None:
        announce(f"only heights are used: the albedo map {config.albedo_map} belongs to the rig")


def _of_dem(path: Path, window: "Window | None") -> TerrainSource:
    from tronlab.terrain.dem import describe_dem, open_dem

    made_by = describe_dem(path).made_by
    raster, origin_trs_m = _part(open_dem(path), window, path)
    asked = procedural_settings(made_by) if window is None else None
    return TerrainSource(path.stem, raster, origin_trs_m, made_by, asked)


def _part(
    heightmap: "HeightMap", window: "Window | None", path: Path
) -> "tuple[Raster, FloatArray]":
    """Give a part of a terrain model, and its origin."""
    import numpy as np

    from tronlab.terrain.formats.model import Raster, window_slices

    rows, columns = window_slices(window, heightmap.height_m.shape, path)
    spacing_m = heightmap.spacing_m
    corner_m = np.array([rows.start * spacing_m, columns.start * spacing_m, 0.0])
    raster = Raster(heightmap.height_m[rows, columns], (spacing_m, spacing_m))
    return raster, heightmap.origin_trs_m + corner_m


def _of_raster(
    path: Path, window: "Window | None", announce: Callable[[str], None]
) -> TerrainSource:
    import numpy as np

    from tronlab.terrain.raster import read_raster

    raster = read_raster(path, window=window, announce=announce)
    return TerrainSource(path.stem, raster, np.array(ORIGIN), {})


def procedural_settings(made_by: Mapping[str, Any]) -> "ProceduralTerrain | None":
    """Give the settings of a terrain made from a seed, from what its description says.

    Returns:
        None if it was made otherwise, or by a version whose settings are not known here.
    """
    from pydantic import ValidationError

    from tronlab.terrain.config import ProceduralTerrain

    if made_by.get("kind") != "procedural":
        return None
    known = {key: made_by[key] for key in ProceduralTerrain.model_fields if key in made_by}
    try:
        return ProceduralTerrain.model_validate(known)
    except ValidationError:
        return None
