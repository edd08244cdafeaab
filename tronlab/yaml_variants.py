"""YAML files that extend others: whatever they do not say themselves, the others say for them.

A file with the key ``extends`` takes over the file named there. A key of its own replaces the
other's whole; what stands under ``changes`` is merged into it, as ``merged`` says. The other file
may extend a third one.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from pydantic import BaseModel
from ruamel.yaml.comments import CommentedMap

from tronlab.errors import ConfigError
from tronlab.yaml_models import (
    Location,
    Place,
    dotted,
    line_in,
    parse_root,
    read_text,
    validate,
)

EXTENDS = "extends"
CHANGES = "changes"
EXTENDS_MARK = "\n# --- extends: "
"""Begins the line between a file's text and that of the one it extends."""

M = TypeVar("M", bound=BaseModel)
OnWritten: TypeAlias = Callable[[Location, bool], None]
_KIND = "kind"
_RELATIVE_PATH = re.compile(r"(?!/|\w+://).*/")


def merged(
    base: Mapping[str, Any],
    changes: Mapping[str, Any],
    *,
    on_written: OnWritten = lambda location, is_merged: None,
    at: Location = (),
) -> dict[str, Any]:
    """Change nested values.

    A mapping is merged into a mapping, key by key, unless it has another ``kind``: the keys of one
    kind are not those of another. Everything else, lists too, takes the place of what was there.

    Args:
        base: The values to change; they stay as they are.
        changes: Keys with the values they get instead.
        on_written: Told the location of each key that the changes have, and whether it was merged
            into what was there.
        at: Location of both.
    """
    result = dict(base)
    for key, value in changes.items():
        before = base.get(key)
        is_merged = _are_merged(before, value)
        on_written((*at, str(key)), is_merged)
        if isinstance(value, Mapping):
            inner = before if is_merged else {}
            result[key] = merged(inner, value, on_written=on_written, at=(*at, str(key)))  # pyright: ignore[reportArgumentType]  # a mapping if it is merged
        else:
            result[key] = value
    return result


def _are_merged(before: Any, value: Any) -> bool:
    if not (isinstance(before, Mapping) and isinstance(value, Mapping)):
        return False
    return _KIND not in value or value[_KIND] == before.get(_KIND)


@dataclass(frozen=True, slots=True)
class YamlFile:
    """A YAML file as it is written."""

    path: Path
    text: str
    root: CommentedMap

    @property
    def is_variant(self) -> bool:
        """Get whether it extends another file."""
        return EXTENDS in self.root

    @property
    def own(self) -> dict[str, Any]:
        """Get the keys that replace those of the file it extends, or all if it extends none."""
        if not self.is_variant:
            return dict(self.root)
        return {key: value for key, value in self.root.items() if key not in {EXTENDS, CHANGES}}

    @property
    def changes(self) -> Mapping[str, Any]:
        """Get what is merged into the file it extends.

        Raises:
            ConfigError: They are no keys and values.
        """
        changes = self.root.get(CHANGES) if self.is_variant else None
        if changes is None:
            return {}
        if not isinstance(changes, Mapping):
            raise self.error("must be keys with their new values", CHANGES)
        return changes

    def error(self, message: str, *location: int | str) -> ConfigError:
        """Make an error about a key of this file."""
        line = line_in(self.root, location)
        return ConfigError(message, path=self.path, line=line, key=dotted(location))

    def extended_path(self) -> Path:
        """Give the path of the file it extends.

        Raises:
            ConfigError: There is no such file.
        """
        named = self.root[EXTENDS]
        if not isinstance(named, str):
            raise self.error("must be the path of a YAML file", EXTENDS)
        path = self.path.parent / Path(named).expanduser()
        if not path.is_file():
            raise self.error(f"no such file: {path}", EXTENDS)
        return path


@dataclass(frozen=True, slots=True)
class _Part:
    """Keys of a file that are laid over those of the files it extends."""

    file: YamlFile
    prefix: Location
    """Of the keys, as they stand in the file."""
    values: Mapping[str, Any]

    def place_of(self, keys: Location) -> Place:
        written = (*self.prefix, *keys)
        return self.file.path, written, line_in(self.file.root, written)


@dataclass(frozen=True)
class Document:
    """What a YAML file says, with all that it takes over from those it extends."""

    files: tuple[YamlFile, ...]
    """The file itself, the one it extends, and so on."""

    @property
    def path(self) -> Path:
        """Get the path of the file itself."""
        return self.files[0].path

    @property
    def text(self) -> str:
        """Get the file itself as it is written."""
        return self.files[0].text

    @property
    def whole_text(self) -> str:
        """Get everything that was read, for provenance; ``recorded_values`` reads it again."""
        rest = (f"{EXTENDS_MARK}{file.path.name}\n{file.text}" for file in self.files[1:])
        return "".join([self.text, *rest])

    @property
    def values(self) -> dict[str, Any]:
        """Get what all files together say; relative paths as they are written."""
        return _laid_over(self._parts())

    def read_as(self, model: type[M], *, overridden: AbstractSet[str] = frozenset()) -> M:
        """Read it as a model; a relative path starts from the file it is written in.

        Args:
            model: What it must be.
            overridden: Names of file keys that will not be used and so need not exist.

        Raises:
            ConfigError: It does not fit the model. One line a problem, each with the file it is
                written in, line, key, value and what is allowed.
        """
        home = self.path.parent.resolve()
        schema = model.model_json_schema() if len(self.files) > 1 else {}
        parts = (
            part
            if part.file.path.parent.resolve() == home
            else replace(part, values=_located(part.values, schema, schema, part.file.path.parent))
            for part in self._parts()
        )
        return validate(
            _laid_over(parts),
            model,
            base_dir=self.path.parent,
            place_of=self._place_of,
            overridden=overridden,
        )

    def error(self, message: str, *location: int | str) -> ConfigError:
        """Make an error about a key, with the file and the line it is written in."""
        path, keys, line = self._place_of(location)
        return ConfigError(message, path=path, line=line, key=dotted(keys))

    def _parts(self) -> Iterator[_Part]:
        for file in reversed(self.files):
            yield _Part(file, (), file.own)
            yield _Part(file, (CHANGES,), file.changes)

    def _place_of(self, keys: Location) -> Place:
        for n in range(len(keys), 0, -1):
            if part := self._homes.get(tuple(map(str, keys[:n]))):
                return part.place_of(keys)
        return self.path, keys, None

    @cached_property
    def _homes(self) -> Mapping[Location, _Part]:
        """Who wrote each key last."""
        homes: dict[Location, _Part] = {}

        def note(part: _Part, location: Location, is_merged: bool) -> None:
            if not is_merged:
                for other in [other for other in homes if other[: len(location)] == location]:
                    del homes[other]
            homes[location] = part

        _laid_over(self._parts(), on_written=note)
        return homes


def read_document(path: Path) -> Document:
    """Read a YAML file and those it extends.

    Raises:
        ConfigError: One cannot be read or is no YAML, or they extend each other in a circle.
    """
    return Document(tuple(_files(path, variants=())))


def recorded_values(whole_text: str) -> dict[str, Any]:
    """Give what a document said whose ``whole_text`` was recorded; nothing if that is empty.

    Raises:
        ConfigError: It is no YAML.
    """
    texts = re.split(rf"{EXTENDS_MARK}.*\n", whole_text) if whole_text else []
    files = (YamlFile(Path(), text, parse_root(text, Path())) for text in texts)
    return Document(tuple(files)).values


def _files(path: Path, *, variants: tuple[Path, ...]) -> Iterator[YamlFile]:
    """Read a file and those it extends; ``variants`` are the files that extend it."""
    text = read_text(path)
    file = YamlFile(path, text, parse_root(text, path))
    yield file
    if file.is_variant:
        extended, variants = file.extended_path(), (*variants, path.resolve())
        if extended.resolve() in variants:
            raise file.error(f"the file extends itself by way of {extended}", EXTENDS)
        yield from _files(extended, variants=variants)


def _laid_over(
    parts: Iterable[_Part],
    *,
    on_written: Callable[[_Part, Location, bool], None] = lambda part, location, is_merged: None,
) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for part in parts:
        # A file's own keys replace whole: nothing is left of what they could be merged into.
        base = values if part.prefix else {k: v for k, v in values.items() if k not in part.values}
        values = merged(base, part.values, on_written=partial(on_written, part))
    return values


def _located(value: Any, node: Any, schema: Mapping[str, Any], folder: Path) -> Any:
    """Make the relative paths in a value absolute.

    Args:
        value: The value, or some keys of it.
        node: Its JSON schema. What no schema is known of, as a driver's options, is a path if it
            has a slash and is no address such as ``socket://``.
        schema: The whole schema, for references.
        folder: Where relative paths start.
    """
    members = list(_members(node, schema))
    if isinstance(value, Mapping):
        return {
            key: _located(inner, {"anyOf": _children(members, str(key))}, schema, folder)
            for key, inner in value.items()
        }
    if isinstance(value, list):
        items = {"anyOf": [member.get("items", {}) for member in members]}
        return [_located(inner, items, schema, folder) for inner in value]
    if isinstance(value, str) and any(_is_path(value, member) for member in members):
        return str((folder / Path(value).expanduser()).absolute())
    return value


def _members(node: Any, schema: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """Give all that a value may be: unions taken apart, references followed."""
    if not isinstance(node, Mapping):  # true: anything
        yield {}
    elif "$ref" in node:
        yield from _members(schema["$defs"][node["$ref"].rpartition("/")[2]], schema)
    elif options := [*node.get("anyOf", ()), *node.get("oneOf", ())]:
        for option in options:
            yield from _members(option, schema)
    elif "anyOf" not in node:  # an empty union is nothing that is known
        yield node


def _children(members: Sequence[Mapping[str, Any]], key: str) -> list[Any]:
    nodes = (
        member.get("properties", {}).get(key, member.get("additionalProperties", not member))
        for member in members
    )
    return [node for node in nodes if node is not False]


def _is_path(value: str, member: Mapping[str, Any]) -> bool:
    if member:
        return member.get("format") == "path"
    return _RELATIVE_PATH.match(value) is not None
