"""What a core keeps of its stages from one scoring to the next: features, matches, databases."""

import hashlib
import json
from collections.abc import Mapping
from typing import Any, Protocol

from numpy.typing import NDArray

Arrays = Mapping[str, NDArray[Any]]


class StageStore(Protocol):
    """Keeps arrays by key. What is lost is computed again: a store may forget at any time."""

    def load(self, stage: str, key: str) -> Arrays | None:
        """Give what was saved, or None."""
        ...

    def save(self, stage: str, key: str, arrays: Arrays) -> None:
        """Keep arrays. A store that cannot, for a full disk say, keeps quiet."""
        ...


class _NothingKept:
    def load(self, stage: str, key: str) -> Arrays | None:
        return None

    def save(self, stage: str, key: str, arrays: Arrays) -> None:
        pass


NOTHING_KEPT: StageStore = _NothingKept()


def stage_key(**what: object) -> str:
    """Give a key for everything the result of a stage depends on; values as JSON has them."""
    text = json.dumps(what, sort_keys=True, allow_nan=False)
    return hashlib.blake2b(text.encode(), digest_size=20).hexdigest()
