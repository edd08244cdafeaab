"""What the campaign and rig files inside a dataset say, as far as truth is made from it.

Only the sections needed are read: files of another version may have others that are unknown here.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from tronlab.calib.record import CalibrationRecord
from tronlab.campaign.config import DatabaseConfig
from tronlab.campaign.reference import database_images
from tronlab.campaign.rig import load_rig
from tronlab.dataset.records import Provenance
from tronlab.devices.laboratory import LampSpec
from tronlab.errors import ConfigError
from tronlab.geometry.poses import FloatArray
from tronlab.render.renderer import Lamp, lamp_as_designed
from tronlab.render.settings import RenderedImages
from tronlab.terrain.config import TerrainConfig
from tronlab.terrain.heightmap import HeightMap
from tronlab.yaml_models import Model, parse_mapping
from tronlab.yaml_variants import recorded_values


class _TerrainSection(Model):
    terrain: TerrainConfig


class _LampSection(Model):
    lamp: LampSpec


def recorded_database(provenance: Provenance, calibration: CalibrationRecord) -> RenderedImages:
    """Give how the reference views of a dataset are rendered; where from is in the dataset.

    Args:
        provenance: Of the dataset; its campaign says how.
        calibration: Has the photometric function, if it shall be the calibrated one.

    Raises:
        ConfigError: The recorded campaign says something else than this version knows.
        CalibrationError: The record has no photometric function.
    """
    section = _section(provenance.campaign_yaml, "database", where="the recorded campaign") or {}
    how = {key: value for key, value in section.items() if key != "trajectory"}
    return database_images(parse_mapping(how, DatabaseConfig, key="database"), calibration)


def recorded_lamp(provenance: Provenance, p_lamp_trs_m: FloatArray) -> Lamp:
    """Give the lamp of a dataset, of intensity 1, where it was measured.

    Args:
        provenance: Of the dataset; its rig says what the lamp is like.
        p_lamp_trs_m: Centre of the light, shape (3,).

    Raises:
        ConfigError: The recorded rig says something else than this version knows.
    """
    laboratory = _section(provenance.rig_yaml, "laboratory", where="the recorded rig")
    lamp = laboratory.get("lamp") if isinstance(laboratory, Mapping) else None
    spec = parse_mapping({"lamp": lamp}, _LampSection, key="laboratory").lamp
    return lamp_as_designed(spec, p_lamp_trs_m)


def recorded_heightmap(
    provenance: Provenance, rig_path: Path | None, *, announce: Callable[[str], None]
) -> HeightMap:
    """Make the terrain model that a dataset was recorded with.

    Args:
        provenance: Of the dataset.
        rig_path: Rig file with the same terrain, to find the file of a terrain that is one.
        announce: Told of slow steps.

    Raises:
        ConfigError: The rig has another terrain, or the terrain is a file and no rig was named.
        TerrainError: The terrain's file cannot be read.
    """
    from tronlab.terrain.load import load_terrain

    recorded = recorded_terrain(provenance.rig_yaml)
    if rig_path is not None:
        rig = load_rig(rig_path)
        if _heights_of(rig.config.terrain) != _heights_of(recorded):
            raise ConfigError(
                "is not the terrain that the dataset was recorded with",
                path=rig_path,
                key="terrain",
            )
        return rig.load_heightmap(announce)
    if recorded.files:
        raise ConfigError(
            f"the dataset was recorded with a terrain from the file {recorded.files[0].name};"
            " name the rig file that leads to it: --rig RIG.yaml"
        )
    return load_terrain(recorded, base_dir=Path(), announce=announce)


def recorded_terrain(rig_yaml: str) -> TerrainConfig:
    """Give the terrain of a recorded rig.

    Raises:
        ConfigError: There is none, or not one that this version knows.
    """
    section = _section(rig_yaml, "terrain", where="the recorded rig")
    if section is None:
        raise ConfigError("the recorded rig has no terrain; name the rig file: --rig RIG.yaml")
    return parse_mapping({"terrain": section}, _TerrainSection, key="rig").terrain


def _section(whole_text: str, name: str, *, where: str) -> Any:
    try:
        return recorded_values(whole_text).get(name)
    except ConfigError as error:
        raise ConfigError(f"{where} is no YAML: {error}") from error


def _heights_of(terrain: TerrainConfig) -> dict[str, Any]:
    names = {"path", "albedo_map"}
    return terrain.model_dump(mode="json", exclude={**dict.fromkeys(names, True), "of": names})
