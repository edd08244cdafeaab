"""YAML files as pydantic models, with every mistake reported by file, line and key."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import MarkedYAMLError

from tronlab.errors import ConfigError

M = TypeVar("M", bound=BaseModel)


class Model(BaseModel):
    """Base of all configuration models: immutable, and no key that is not known."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, use_attribute_docstrings=True, allow_inf_nan=False
    )
