"""YAML files as pydantic models, with every mistake reported by file, line and key."""

import difflib
import json
from collections.abc import Callable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from pathlib import Path
from typing import Annotated, Any, TypeAlias, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError, ValidationInfo
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.constructor import DuplicateKeyError
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from tronlab.errors import ConfigError

M = TypeVar("M", bound=BaseModel)
Location: TypeAlias = tuple[int | str, ...]
Place: TypeAlias = tuple[Path, Location, int | None]
"""Where something is written: file, keys as they stand there, line."""

UNITS = {
    "s": "seconds",
    "m": "metres",
    "px": "pixels",
    "deg": "degrees",
    "rad": "radians",
    "db": "decibels",
    "k": "kelvin",
    "pa": "pascals",
    "pct": "per cent",
}
"""Suffixes that tronlab's keys carry."""
_OTHER_UNITS = ("ms", "us", "ns", "min", "h", "mm", "cm", "um", "km", "mrad", "hz", "c", "hpa")
_MAX_VALUE_CHARS = 60


class Model(BaseModel):
    """Base of all configuration models: immutable, and no key that is not known."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, use_attribute_docstrings=True, allow_inf_nan=False
    )


def existing_file(value: Path, info: ValidationInfo) -> Path:
    """Resolve a file named relative to the YAML file that names it.

    Raises:
        ValueError: It does not exist; pydantic adds where it is named.
    """
    context: dict[str, Any] = info.context or {}
    path = context.get("base_dir", Path()) / value.expanduser()
    if info.field_name in context.get("overridden", ()):
        return path
    if path.is_dir():
        raise ValueError(f"is a directory, not a file: {path}")
    if not path.is_file():
        raise ValueError(f"no such file: {path}")
    return path


ExistingFile: TypeAlias = Annotated[Path, AfterValidator(existing_file)]
"""A file named relative to the YAML file that names it; resolved and checked when loaded."""


def load_model(path: Path, model: type[M]) -> M:
    """Read a YAML 1.2 file as a model.

    Raises:
        ConfigError: The file cannot be read or does not fit the model. Its text has one line a
            problem, each with file, line, key, value and what is allowed.
    """
    return parse_model(read_text(path), model, path=path)


def read_text(path: Path) -> str:
    """Read a UTF-8 text file.

    Raises:
        ConfigError: There is no such file, or it is no UTF-8 text.
    """
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ConfigError("no such file", path=path) from None
    except IsADirectoryError:
        raise ConfigError("is a directory, expected a file", path=path) from None
    except UnicodeDecodeError as error:
        raise ConfigError(
            f"is not UTF-8 text (byte {error.start}); save the file as UTF-8", path=path
        ) from None
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", path=path) from error


def parse_model(
    text: str, model: type[M], *, path: Path, overridden: AbstractSet[str] = frozenset()
) -> M:
    """Read YAML 1.2 text as a model; values keep the type they are written in.

    Args:
        text: Contents of the file.
        model: What it must be.
        path: Where the text came from: named in errors, and base of the relative paths in it.
        overridden: Names of file keys that will not be used and so need not exist.

    Raises:
        ConfigError: As ``load_model``.
    """
    root = parse_root(text, path)
    return validate(
        root,
        model,
        base_dir=path.parent,
        overridden=overridden,
        place_of=lambda keys: (path, keys, line_in(root, keys)),
    )


def validate(
    values: Mapping[str, Any],
    model: type[M],
    *,
    base_dir: Path,
    place_of: Callable[[Location], Place],
    overridden: AbstractSet[str] = frozenset(),
) -> M:
    """Read values as a model; they keep the type they are written in.

    Args:
        values: What YAML says.
        model: What it must be.
        base_dir: Where relative paths start.
        place_of: Says where a key of the values is written.
        overridden: Names of file keys that will not be used and so need not exist.

    Raises:
        ConfigError: As ``load_model``.
    """
    # JSON mode is strict about types (no "1" for 1, no true for 1.0) yet reads lists as tuples.
    as_json = json.dumps(values, default=str)
    context = {"base_dir": base_dir, "overridden": overridden}
    try:
        return model.model_validate_json(as_json, strict=True, context=context)
    except ValidationError as error:
        schema = model.model_json_schema()
        problems = [_problem(dict(item), values, schema, place_of) for item in error.errors()]
    raise join_errors(sorted(problems, key=_place_in_files)) from None


def parse_mapping(values: Mapping[str, Any], model: type[M], *, key: str) -> M:
    """Read values that were already taken from a YAML file as a model.

    Args:
        values: The values.
        model: What they must be.
        key: Where in the file they stand, dotted.

    Raises:
        ConfigError: As ``load_model``, but nobody knows the file and the lines here.
    """
    try:
        return model.model_validate_json(json.dumps(values, default=str), strict=True)
    except ValidationError as error:
        schema = model.model_json_schema()
        problems: list[ConfigError] = []
        for item in map(dict[str, Any], error.errors()):
            location: Location = item["loc"]
            message = _MESSAGES.get(item["type"], _message_of_value)(
                item, _known_keys(schema, location[:-1])
            )
            where = dotted((*key.split("."), *location))
            problems.append(ConfigError(message, key=where))
    raise join_errors(problems) from None


def join_errors(errors: Sequence[ConfigError]) -> ConfigError:
    """Make one error of several: it has the place of the first and one line for each."""
    if len(errors) == 1:
        return errors[0]
    joined = ConfigError("", path=errors[0].path, line=errors[0].line, key=errors[0].key)
    joined.args = ("\n".join(str(error) for error in errors),)
    joined.parts = tuple(errors)
    return joined


def _place_in_files(error: ConfigError) -> tuple[str, int]:
    return str(error.path), error.line or 0


def line_of(text: str, location: Location) -> int | None:
    """Give the line, from 1, where a key of YAML text stands; None if it is not there."""
    try:
        root = parse_root(text, Path())
    except ConfigError:
        return None
    return line_in(root, location)


def parse_root(text: str, path: Path) -> CommentedMap:
    """Read YAML 1.2 text as keys and values, which know their lines.

    Raises:
        ConfigError: It is none.
    """
    try:
        root = YAML(typ="rt", pure=True).load(text)
    except DuplicateKeyError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else None
        what = (error.problem or "a key stands twice").splitlines()[0]
        raise ConfigError(f"{what}; remove one of them", path=path, line=line) from None
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark else None
        raise ConfigError(
            f"not valid YAML: {error.problem or error.context}", path=path, line=line
        ) from None
    except (YAMLError, ValueError) as error:
        raise ConfigError(f"not valid YAML: {str(error).splitlines()[0]}", path=path) from None
    if root is None:
        raise ConfigError("is empty, expected keys and values", path=path)
    if not isinstance(root, CommentedMap):
        raise ConfigError(
            f"expected keys and values at the top, got {_show(root)}", path=path, line=1
        )
    return root


def _problem(
    item: dict[str, Any],
    values: Mapping[str, Any],
    schema: dict[str, Any],
    place_of: Callable[[Location], Place],
) -> ConfigError:
    location: Location = item["loc"]
    kind: str = item["type"]
    keys = keys_in(values, location)
    if kind == "union_tag_invalid":
        keys = (*keys, item["ctx"]["discriminator"].strip("'"))
    path, keys, line = place_of(keys)
    if kind == "missing":
        keys = (*keys, location[-1])
    message = _MESSAGES.get(kind, _message_of_value)(item, _known_keys(schema, location[:-1]))
    return ConfigError(message, path=path, line=line, key=dotted(keys))


def keys_in(values: Mapping[str, Any], location: Location) -> Location:
    """Give those parts of a location that are there.

    pydantic's locations also name the member of a union, which is no key of the file.
    """
    node: Any = values
    keys: list[int | str] = []
    for part in location:
        known = _known_as(part, node)
        if known is not None:
            node = node[known]
            keys.append(part)
    return tuple(keys)


def line_in(root: CommentedMap, location: Location) -> int | None:
    """Give the line, from 1, of the last part of a location that is there; None if none is."""
    node: Any = root
    line: int | None = None
    for part in location:
        key = _known_as(part, node)
        if key is not None:
            line = _line(node.lc.data, key, line)
            node = node[key]
    return line


def _known_as(part: int | str, node: Any) -> Any:
    """Give the key under which a mapping or a list has a part of a location; None if it has not."""
    if isinstance(node, Mapping):
        # A key such as 1 is no text in YAML, but is in pydantic's location.
        return {str(key): key for key in node}.get(str(part))
    is_index = isinstance(node, CommentedSeq) and isinstance(part, int) and part < len(node)
    return part if is_index else None


def _line(marks: dict[int | str, Any] | None, part: int | str, default: int | None) -> int | None:
    mark = (marks or {}).get(part)
    return mark[0] + 1 if mark is not None else default


def dotted(keys: Location) -> str:
    """Give a location as people write it: a.b[0].c."""
    parts = [f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys]
    return "".join(parts).lstrip(".")


def _message_of_unknown_key(item: dict[str, Any], known: Sequence[str]) -> str:
    key = str(item["loc"][-1])
    allowed = f"; known keys: {', '.join(known)}" if known else ""
    same_quantity = [k for k in known if _stem(k) == _stem(key)]
    if same_quantity:
        match = same_quantity[0]
        unit = UNITS.get(match.rpartition("_")[2])
        in_unit = f" (in {unit})" if unit else ""
        return f"unknown key, did you mean {match}{in_unit}?"
    close = difflib.get_close_matches(key, known, n=1)
    return f"unknown key, did you mean {close[0]}?" if close else f"unknown key{allowed}"


def _message_of_missing(item: dict[str, Any], known: Sequence[str]) -> str:
    is_value = isinstance(item["loc"][-1], int)
    return "this value of the list is missing" if is_value else "required key is missing"


def _message_of_wrong_tag(item: dict[str, Any], known: Sequence[str]) -> str:
    return f"unknown value '{item['ctx']['tag']}', allowed: {item['ctx']['expected_tags']}"


def _message_of_missing_tag(item: dict[str, Any], known: Sequence[str]) -> str:
    return f"required key {item['ctx']['discriminator']} is missing"


def _message_of_value(item: dict[str, Any], known: Sequence[str]) -> str:
    message: str = item["msg"]
    if item["type"] in {"value_error", "assertion_error"}:
        return str(item["ctx"]["error"])
    message = message.replace("Input should be", "must be", 1)
    return f"{message}, got {_show(item['input'])}"


_MESSAGES = {
    "extra_forbidden": _message_of_unknown_key,
    "missing": _message_of_missing,
    "union_tag_invalid": _message_of_wrong_tag,
    "union_tag_not_found": _message_of_missing_tag,
}


def _stem(key: str) -> str:
    stem, _, suffix = key.rpartition("_")
    return stem if stem and (suffix in UNITS or suffix in _OTHER_UNITS) else key


def _show(value: object) -> str:
    text = json.dumps(value, default=str)
    return text if len(text) <= _MAX_VALUE_CHARS else text[: _MAX_VALUE_CHARS - 3] + "..."


def _known_keys(schema: dict[str, Any], location: Location) -> Sequence[str]:
    """Give the keys a JSON schema allows at a location."""
    node = _resolved(schema, schema)
    for part in location:
        node = _resolved(_child(node, part), schema)
    return tuple(node.get("properties", ()))


def _resolved(node: dict[str, Any], schema: dict[str, Any]) -> dict[str, Any]:
    """Follow a reference, and an optional value to what it is when present."""
    for option in node.get("anyOf", ()):
        if option.get("type") != "null":
            return _resolved(option, schema)
    if "$ref" in node:
        return schema["$defs"][node["$ref"].rpartition("/")[2]]
    return node


def _child(node: dict[str, Any], part: int | str) -> dict[str, Any]:
    if "discriminator" in node:
        reference = node["discriminator"]["mapping"].get(part)
        return {"$ref": reference} if reference else {}
    if isinstance(part, int):
        items = node.get("prefixItems", ())
        return items[part] if part < len(items) else node.get("items", {})
    if part in node.get("properties", {}):
        return node["properties"][part]
    # Values by names of the user's own: a schema, or whether any are allowed.
    named = next(iter(node.get("patternProperties", {}).values()), node.get("additionalProperties"))
    return named if isinstance(named, dict) else {}
