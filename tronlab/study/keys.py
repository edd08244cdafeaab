"""Keys of steps: digests of everything that their results depend on."""

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from tronlab.study.steps import Step

RECORDING_CODE = (
    "campaign",
    "calib",
    "planning",
    "twin",
    "render",
    "terrain",
    "trajectory",
    "dataset",
    "devices",
    "kinematics",
    "geometry",
    "yaml_variants.py",
)
"""Packages that shape a calibration record or a dataset."""
SCORING_CODE = ("nav", "score", "geometry", "dataset")
"""Packages that shape scores."""
REPORT_CODE = ("report", "score")
"""Packages that shape figures and pages."""

_PACKAGE = Path(__file__).parent.parent
_LIBRARIES = (
    "numpy",
    "scipy",
    "numba",
    "clarabel",
    "opencv-python-headless",
    "opencv-python",
    "poselib",
)
_YAML_SUFFIXES = (".yaml", ".yml")


def key_of(
    *,
    files: Iterable[Path] = (),
    code: Sequence[str] = (),
    after: Iterable[Step] = (),
    **settings: object,
) -> str:
    """Give a key of everything that a step depends on.

    Args:
        files: Files it reads, each with those that it names; comments in YAML files do not count.
        code: Names of packages of tronlab (``nav``), or of modules of them (``study/load.py``).
        after: Steps whose results it uses.
        settings: What else it depends on, as JSON can have it.

    Raises:
        OSError: A file cannot be read.
    """
    parts = {
        "files": [_digest_of_file(path.resolve()) for path in files],
        "code": [_digest_of_code(name) for name in code],
        "libraries": _libraries() if code else "",
        "after": [step.key for step in after],
        "settings": settings,
    }
    text = json.dumps(parts, sort_keys=True, default=str)
    return _new_digest(text.encode()).hexdigest()


def forget_files() -> None:
    """Read files anew from here on: somebody may have edited them."""
    _read.cache_clear()
    _digest_of_code.cache_clear()


def _digest_of_file(path: Path) -> str:
    """Give a digest of what a file says, and of the files it names, and those they name."""
    files = [path]
    for file in files:
        files += [named for named in _read(file).named if named not in files]
    return " ".join(_read(file).digest for file in files)


@dataclass(frozen=True, slots=True)
class _Contents:
    """What a file says."""

    digest: str
    named: tuple[Path, ...] = ()


@cache
def _read(path: Path) -> _Contents:
    if path.suffix not in _YAML_SUFFIXES:
        with path.open("rb") as file:
            return _Contents(hashlib.file_digest(file, _new_digest).hexdigest())
    text = path.read_text(encoding="utf-8", errors="replace")
    try:
        document = YAML(typ="safe", pure=True).load(text)
    except YAMLError:  # others complain about it
        document = text
    digest = _new_digest(json.dumps(document, sort_keys=True, default=str).encode())
    return _Contents(digest.hexdigest(), tuple(_files_named(document, path.parent)))


def _new_digest(content: bytes = b"") -> "hashlib.blake2b":
    return hashlib.blake2b(content, digest_size=16)


def _files_named(value: Any, folder: Path) -> Iterator[Path]:
    """Give the files that values of a YAML file name, relative to its folder."""
    if isinstance(value, Mapping):
        for part in value.values():
            yield from _files_named(part, folder)
    elif isinstance(value, list):
        for part in value:
            yield from _files_named(part, folder)
    elif isinstance(value, str) and Path(value).suffix and "\n" not in value:
        path = (folder / Path(value).expanduser()).resolve()
        if path.is_file():
            yield path


@cache
def _digest_of_code(name: str) -> str:
    """Give a digest of the sources of a package, or of one module."""
    root = _PACKAGE / name
    if not root.exists():
        raise FileNotFoundError(f"tronlab has no {name}")
    digest = _new_digest()
    for path in [root] if root.is_file() else sorted(root.rglob("*")):
        if path.is_file() and path.suffix in {".py", ".j2"}:
            content = path.read_bytes()
            digest.update(f"{path.relative_to(_PACKAGE)} {len(content)}\n".encode())
            digest.update(content)
    return digest.hexdigest()


@cache
def _libraries() -> str:
    """Give the versions of the libraries that shape the numbers."""
    return ", ".join(f"{name} {_version(name)}" for name in _LIBRARIES)


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "none"
