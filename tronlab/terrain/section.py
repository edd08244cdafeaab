"""A YAML file that describes a terrain and nothing else."""

from tronlab.terrain.config import TerrainConfig
from tronlab.yaml_models import Model


class TerrainSection(Model):
    """The section ``terrain`` of a rig file, in a file of its own."""

    terrain: TerrainConfig
    """The terrain model."""
