"""What is generated from the models: JSON schemas for editors, and the pages of all keys.

``python -m tronlab.campaign.schema`` in a source checkout writes them anew.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from tronlab.campaign.config import CampaignConfig
from tronlab.campaign.rig import RigConfig
from tronlab.nav.settings import PRESETS, FeatureCoreSettings
from tronlab.score.sweep import Sweep
from tronlab.yaml_variants import CHANGES, EXTENDS

MODELS: Mapping[str, type[BaseModel]] = {
    "campaign": CampaignConfig,
    "rig": RigConfig,
    "sweep": Sweep,
}
VARIANTS = ("campaign", "rig")
"""Files that may extend another one of their kind."""
SCHEMA_DIR = Path("campaigns/schema")
CAMPAIGN_PAGE = Path("docs/reference/campaign.md")
SWEEP_PAGE = Path("docs/reference/sweep.md")
_VARIANT = (
    "A campaign or rig file with the key `extends` takes over everything from another one. A key of"
    " its own, such as `name` or a whole section, replaces the other's; `changes` reaches deeper."
    " The other file may extend a third one. A relative path starts from the file it is written in."
)
_EXTENDS = "The other file of the same kind, relative to this one."
_CHANGES = (
    "Keys, nested as in the other file, with the values they get instead; the others of their"
    " sections stay. Lists are replaced whole, and so is a section that gets another `kind`."
)
_VARIANT_EXAMPLE = """```yaml
extends: straight_line.yaml
name: dim                               # replaces the name
changes:
  camera: {exposure_s: 0.01}            # the rest of the section camera stays
  trajectory: {n_points: 13}
```"""
_WORDS = {"object": "section"}
_ANY = {"array": "[]", "object": ".NAME"}
_LIMITS = {
    "minimum": "at least",
    "exclusiveMinimum": "more than",
    "maximum": "at most",
    "exclusiveMaximum": "less than",
}


def generated_files() -> dict[Path, str]:
    """Give every generated file, by its path in a source checkout."""
    schemas = {name: schema_of(model) for name, model in MODELS.items()}
    schemas |= {f"{name}-variant": _variant_schema(schemas[name]) for name in VARIANTS}
    files = {
        SCHEMA_DIR / f"{name}.schema.json": json.dumps(schema, indent=2) + "\n"
        for name, schema in schemas.items()
    }
    files[CAMPAIGN_PAGE] = "\n".join(_campaign_page()) + "\n"
    files[SWEEP_PAGE] = "\n".join(_sweep_page()) + "\n"
    return files


def write_generated_files(checkout: Path) -> None:
    """Write every generated file below a source checkout."""
    for path, text in generated_files().items():
        (checkout / path).parent.mkdir(parents=True, exist_ok=True)
        (checkout / path).write_text(text, encoding="utf-8")


def schema_of(model: type[BaseModel]) -> dict[str, Any]:
    """Give the JSON schema of a file."""
    schema = model.model_json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def _variant_schema(schema: Mapping[str, Any]) -> dict[str, Any]:
    """Give the schema of a file that extends another one: it may leave out whatever it likes."""
    variant = _with_nothing_required(schema)
    properties = variant["properties"]
    changes = {
        "description": _CHANGES,
        "type": "object",
        "properties": properties,
        "additionalProperties": False,
    }
    extends = {"description": _EXTENDS, "type": "string", "format": "path"}
    return {
        **variant,
        "description": _VARIANT,
        "properties": {EXTENDS: extends, **properties, CHANGES: changes},
        "required": [EXTENDS],
    }


def _with_nothing_required(node: Any) -> Any:
    if isinstance(node, list):
        return [_with_nothing_required(item) for item in node]  # pyright: ignore[reportUnknownVariableType]
    if not isinstance(node, Mapping):
        return node
    # Without their kind, the members of a union cannot be told apart: one of them is enough.
    names = {"oneOf": "anyOf"}
    return {
        names.get(key, key): _with_nothing_required(value)
        for key, value in node.items()
        if not (key == "required" and isinstance(value, list))
    }


def _campaign_page() -> Iterator[str]:
    yield from page_head("Campaign and rig files: all keys")
    yield from page_section("Campaign file", CampaignConfig)
    yield from page_section("Rig file", RigConfig)
    yield from ("", "## Files that extend others", "", _VARIANT, "")
    yield from ("| key | type | default | |", "|---|---|---|---|")
    yield f"| `{EXTENDS}` | file | required | {_EXTENDS} |"
    yield f"| `{CHANGES}` | section | | {_CHANGES} |"
    yield from ("", _VARIANT_EXAMPLE)


def _sweep_page() -> Iterator[str]:
    yield from page_head("Sweep files, and the settings of the built-in cores: all keys")
    yield from page_section("Sweep file", Sweep)
    yield from page_section("Settings of the built-in cores", FeatureCoreSettings)
    yield from ("", "The built-in cores differ from these defaults by:", "")
    yield from ("| core | |", "|---|---|")
    defaults = _flat(FeatureCoreSettings().model_dump(mode="json"))
    for name, preset in PRESETS.items():
        settings = _flat(preset.model_dump(mode="json"))
        changes = [f"`{k}: {_plain(v)}`" for k, v in settings.items() if v != defaults[k]]
        yield f"| `{name}` | {', '.join(changes)} |"


def page_head(title: str, *, made_by: str = "tronlab.campaign.schema") -> Iterator[str]:
    """Give the first lines of a generated page of keys."""
    yield from (f"# {title}", "")
    yield f"Generated from the models by `python -m {made_by}`; do not edit."
    yield "Lengths in metres, times in seconds, angles in degrees: the end of a key says which."


def page_section(title: str, model: type[BaseModel]) -> Iterator[str]:
    """Give the table of a model's keys."""
    schema = schema_of(model)
    yield from ("", f"## {title}", "")
    yield from ("| key | type | default | |", "|---|---|---|---|")
    yield from _rows(schema, schema, prefix="")


def _flat(settings: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in settings.items():
        inner = isinstance(value, Mapping)
        flat |= _flat(value, f"{prefix}{key}.") if inner else {f"{prefix}{key}": value}
    return flat


def _rows(node: Mapping[str, Any], schema: Mapping[str, Any], *, prefix: str) -> Iterator[str]:
    required = node.get("required", ())
    for key, field in node["properties"].items():
        if "const" in field:
            continue
        members = _members(field, schema)
        default = "required" if key in required else _default(field, members)
        text = field.get("description", "").replace("\n", " ").replace("|", "\\|")
        yield f"| `{prefix}{key}` | {_type(field, members)} | {default} | {text} |"
        for tag, member in members.items():
            path = f"{prefix}{key}{_ANY.get(field.get('type', ''), '')}."
            if tag:
                about = member.get("description", "").replace("\n", " ")
                yield f"| `{path}kind: {tag}` | | | {about} |"
            yield from _rows(member, schema, prefix=path)


def _members(field: Mapping[str, Any], schema: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Give the models a field may hold, by the tag that chooses among them; none for a value."""
    for union in (field, *field.get("anyOf", ())):
        if "discriminator" in union:
            mapping = union["discriminator"]["mapping"]
            return {tag: _resolved(reference, schema) for tag, reference in mapping.items()}
    named = field.get("additionalProperties")
    named = named if isinstance(named, dict) else {}
    # Keys that must look like names.
    named = next(iter(field.get("patternProperties", {}).values()), named)
    below = (field.get("items", {}), *field.get("anyOf", ()), named, *named.get("anyOf", ()))
    candidates = [field, *below]
    references = [c["$ref"] for c in candidates if "$ref" in c]
    models = [_resolved(reference, schema) for reference in references]
    model = next((model for model in models if "properties" in model), None)
    return {"": model} if model else {}


def _resolved(reference: str, schema: Mapping[str, Any]) -> Mapping[str, Any]:
    return schema["$defs"][reference.rpartition("/")[2]]


def _type(field: Mapping[str, Any], members: Mapping[str, Mapping[str, Any]]) -> str:
    if members:
        named = next((f for f in field.get("anyOf", ()) if "enum" in f), None)
        if named:
            return f"{_type(named, {})} or section"
        return "list" if field.get("type") == "array" else "section"
    if "enum" in field:
        return " or ".join(f"`{_plain(value)}`" for value in field["enum"])
    if "anyOf" in field:
        return _type(next(f for f in field["anyOf"] if f.get("type") != "null"), {})
    if field.get("type") == "array":
        items = field.get("prefixItems")
        return (
            f"{len(items)} x {_type(items[0], {})}"
            if items
            else f"list of {field['items']['type']}"
        )
    limits = [f"{word} {_short(field[key])}" for key, word in _LIMITS.items() if key in field]
    kind: str = field.get("type", "value")
    name = "file" if field.get("format") == "path" else _WORDS.get(kind) or kind
    return ", ".join([name, *limits])


def _default(field: Mapping[str, Any], members: Mapping[str, Mapping[str, Any]]) -> str:
    if "default" not in field:
        return ""
    if members:
        kind = field["default"].get("kind") if isinstance(field["default"], dict) else None
        return f"`{kind}`" if kind else ""
    return "" if field["default"] in (None, "") else f"`{_plain(field['default'])}`"


def _short(number: float) -> str:
    return str(int(number)) if number == int(number) else f"{number:g}"


def _plain(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value)


if __name__ == "__main__":
    write_generated_files(Path(__file__).resolve().parents[2])
