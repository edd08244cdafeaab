"""What the campaign and rig files inside a dataset say, as far as truth is made from it.

Only the sections needed are read: files of another version may have others that are unknown here.
"""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from tronlab.campaign.config import DatabaseConfig
from tronlab.campaign.rig import EXTENDS_MARK, load_rig
from tronlab.dataset.records import Provenance
from tronlab.errors import ConfigError
from tronlab.terrain.config import TerrainConfig
from tronlab.terrain.heightmap import HeightMap
from tronlab.yaml_models import Model, parse_mapping


class _TerrainSection(Model):
    terrain: TerrainConfig


def recorded_database(provenance: Provenance) -> DatabaseConfig:
    """Give how the reference views of a dataset were rendered.

    Raises:
        ConfigError: The recorded campaign says something else than this version knows.
    """
    section = _section(provenance.campaign_yaml, "database", where="the recorded campaign")
    return parse_mapping(section or {}, DatabaseConfig, key="database")


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
    if recorded.kind == "file":
        raise ConfigError(
            f"the dataset was recorded with a terrain from the file {recorded.path.name};"
            " name the rig file that leads to it: --rig RIG.yaml"
        )
    return load_terrain(recorded, base_dir=Path(), announce=announce)


def recorded_terrain(rig_yaml: str) -> TerrainConfig:
    """Give the terrain of a recorded rig: a variant's own, else that of the rig it extends.

    Raises:
        ConfigError: There is none, or not one that this version knows.
    """
    for text in re.split(rf"{EXTENDS_MARK}.*\n", rig_yaml):
        section = _section(text, "terrain", where="the recorded rig")
        if section is not None:
            return parse_mapping({"terrain": section}, _TerrainSection, key="rig").terrain
    raise ConfigError("the recorded rig has no terrain; name the rig file: --rig RIG.yaml")


def _section(text: str, name: str, *, where: str) -> Any:
    try:
        root = YAML(typ="safe", pure=True).load(text)
    except YAMLError as error:
        raise ConfigError(f"{where} is no YAML: {error}") from error
    return root.get(name) if isinstance(root, dict) else None


def _heights_of(terrain: TerrainConfig) -> dict[str, Any]:
    return terrain.model_dump(mode="json", exclude={"path"})
