"""What is generated from the models: JSON schemas for editors, and the page of all keys.

``python -m tronlab.campaign.schema`` in a source checkout writes them anew.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from tronlab.campaign.config import CampaignConfig
from tronlab.campaign.rig import RigConfig, RigVariant

MODELS: Mapping[str, type[BaseModel]] = {
    "campaign": CampaignConfig,
    "rig": RigConfig,
    "rig-variant": RigVariant,
}
DESCRIBED = ("campaign", "rig")
"""Files whose keys the page lists; a variant of a rig has a rig's."""
SCHEMA_DIR = Path("campaigns/schema")
REFERENCE_PAGE = Path("docs/reference/campaign.md")
_LIMITS = {
    "minimum": "at least",
    "exclusiveMinimum": "more than",
    "maximum": "at most",
    "exclusiveMaximum": "less than",
}


def generated_files() -> dict[Path, str]:
    """Give every generated file, by its path in a source checkout."""
    schemas = {name: _schema(name) for name in MODELS}
    files = {
        SCHEMA_DIR / f"{name}.schema.json": json.dumps(schema, indent=2) + "\n"
        for name, schema in schemas.items()
    }
    files[REFERENCE_PAGE] = _reference_page(schemas)
    return files


def write_generated_files(checkout: Path) -> None:
    """Write every generated file below a source checkout."""
    for path, text in generated_files().items():
        (checkout / path).parent.mkdir(parents=True, exist_ok=True)
        (checkout / path).write_text(text, encoding="utf-8")


def _schema(name: str) -> dict[str, Any]:
    schema = MODELS[name].model_json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def _reference_page(schemas: Mapping[str, dict[str, Any]]) -> str:
    lines = [
        "# Campaign and rig files: all keys",
        "",
        "Generated from the models by `python -m tronlab.campaign.schema`; do not edit.",
        "Lengths in metres, times in seconds, angles in degrees: the end of a key says which.",
    ]
    for name in DESCRIBED:
        schema = schemas[name]
        lines += ["", f"## {name.capitalize()} file", ""]
        lines += ["| key | type | default | |", "|---|---|---|---|"]
        lines += _rows(schema, schema, prefix="")
    lines += [
        "",
        "A rig file with the key `extends` takes over the rig file named there and replaces the"
        " sections it has itself, whole.",
    ]
    return "\n".join(lines) + "\n"


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
            path = f"{prefix}{key}[]." if field.get("type") == "array" else f"{prefix}{key}."
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
    candidates = [field, field.get("items", {}), *field.get("anyOf", ())]
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
    name = "file" if field.get("format") == "path" else field.get("type", "value")
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
