"""Rig and campaign files that a study writes: another file, with changes."""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tronlab.study.keys import key_of
from tronlab.study.writing import replace_text


@dataclass(frozen=True, slots=True)
class Variant:
    """A rig or campaign file, and what of it shall be otherwise."""

    extends: Path
    changes: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Nested keys with the values they get instead."""

    @property
    def key(self) -> str:
        """Get a digest of what the variant says."""
        return key_of(files=[self.extends], changes=self.changes)


def write_variant(path: Path, variant: Variant) -> Path:
    """Write the file of a variant, which can be used by hand like any other.

    Args:
        path: Where to; its folder is made.
        variant: What it says.

    Returns:
        The path.

    Raises:
        ConfigError: It cannot be written.
    """
    extended = os.path.relpath(variant.extends, path.parent)
    lines = [
        "# Written by tronlab study; changed by hand it is written anew.",
        f"extends: {json.dumps(extended)}",
    ]
    if variant.changes:
        # JSON is YAML, and numbers keep every digit.
        lines.append(f"changes: {json.dumps(variant.changes, indent=2, default=str)}")
    replace_text(path, "\n".join(lines) + "\n")
    return path
