"""What is generated from the study file's model: its JSON schema, and the page of all keys.

``python -m tronlab.study.schema`` in a source checkout writes them anew.
"""

import json
from collections.abc import Iterator
from pathlib import Path

from tronlab.campaign.schema import SCHEMA_DIR, page_head, page_section, schema_of
from tronlab.study.config import StudyConfig

STUDY_SCHEMA = SCHEMA_DIR / "study.schema.json"
STUDY_PAGE = Path("docs/reference/study.md")


def generated_files() -> dict[Path, str]:
    """Give every generated file, by its path in a source checkout."""
    return {
        STUDY_SCHEMA: json.dumps(schema_of(StudyConfig), indent=2) + "\n",
        STUDY_PAGE: "\n".join(_page()) + "\n",
    }


def write_generated_files(checkout: Path) -> None:
    """Write every generated file below a source checkout."""
    for path, text in generated_files().items():
        (checkout / path).parent.mkdir(parents=True, exist_ok=True)
        (checkout / path).write_text(text, encoding="utf-8")


def _page() -> Iterator[str]:
    yield from page_head("Study files: all keys", made_by="tronlab.study.schema")
    yield from page_section("Study file", StudyConfig)


if __name__ == "__main__":
    write_generated_files(Path(__file__).resolve().parents[2])
