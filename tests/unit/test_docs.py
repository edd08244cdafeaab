"""The documentation says what is: its links, its tables and its snippets."""

import doctest
import os
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages

import pytest
from ruamel.yaml import YAML

import tronlab
from tronlab.campaign.config import CampaignConfig
from tronlab.errors import TronlabError
from tronlab.geometry.frames import FRAMES
from tronlab.score.table import COLUMNS
from tronlab.yaml_models import parse_model

ROOT = Path(__file__).parents[2]
CONVENTIONS = ROOT / "docs/conventions.md"
PAGES = sorted(
    page
    for pattern in (
        "*.md",
        "docs/**/*.md",
        "campaigns/*.md",
        "drivers/*/README.md",
        "examples/*/README.md",
    )
    for page in ROOT.glob(pattern)
)
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


def prose(page: Path) -> str:
    """Give a page without its code blocks."""
    return re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)


def first_cells(section: str) -> list[str]:
    """Give what stands in backticks in the first column of a section of the conventions."""
    (text,) = re.findall(
        rf"^## {section}\n(.*?)(?=^## |\Z)", CONVENTIONS.read_text(), re.DOTALL | re.MULTILINE
    )
    return re.findall(r"^\| `([^`]+)` \|", text, re.MULTILINE)


def error_names() -> set[str]:
    """Give the names of all errors of the library."""
    for module in walk_packages(tronlab.__path__, "tronlab."):
        import_module(module.name)
    return {kind.__name__ for kind in descendants(TronlabError)}


def descendants(kind: type) -> set[type]:
    return {kind}.union(*(descendants(child) for child in kind.__subclasses__()))


def test_the_pages_are_found() -> None:
    assert {"README.md", "docs/conventions.md"} < {name_of(page) for page in PAGES}


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_to_files(page: Path) -> None:
    targets = [link.split("#")[0] for link in LINK.findall(prose(page)) if "://" not in link]
    missing = [target for target in targets if target and not (page.parent / target).exists()]
    assert not missing


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_snippets_do_what_they_say(page: Path) -> None:
    snippets = doctest.DocTestParser().get_doctest(page.read_text(), {}, page.name, str(page), 0)
    said: list[str] = []
    failures = doctest.DocTestRunner().run(snippets, out=said.append).failed
    assert not failures, "".join(said)


def test_the_conventions_have_snippets() -> None:
    assert len(doctest.DocTestParser().get_examples(CONVENTIONS.read_text())) > 20


def test_every_frame_is_in_the_table() -> None:
    assert sorted(first_cells("Frames")) == sorted(FRAMES)


def test_every_column_of_scores_is_explained_in_its_order() -> None:
    assert first_cells("Scores") == list(COLUMNS)


def test_every_error_is_explained() -> None:
    explained = first_cells("Errors")
    public = {name for name in error_names() if not name.startswith("_")}
    assert set(explained) >= public - {"TronlabError"}
    assert set(explained) <= public


def test_the_campaign_of_the_tutorial_can_be_read() -> None:
    """The page's YAML over straight_line.yaml is a campaign, and changes what it says."""
    page = (ROOT / "docs/tutorials/first_campaign.md").read_text()
    original = (ROOT / "campaigns/straight_line.yaml").read_text()
    text = original
    for block in re.findall(r"^```yaml\n(.*?)^```$", page, re.DOTALL | re.MULTILINE):
        for line in block.splitlines():
            key = line.split(":")[0]
            text, n_lines = re.subn(rf"^{key}:[^\n]*", line, text, flags=re.MULTILINE)
            assert n_lines == 1, key
    campaign = parse_model(text, CampaignConfig, path=ROOT / "campaigns/sideways.yaml")
    assert (campaign.name, campaign.database.n_views) == ("sideways", 4)
    before, after = (set(YAML(typ="safe", pure=True).load(it)) for it in (original, text))
    assert before == after


def test_the_picture_of_the_frames_can_be_drawn(tmp_path: Path) -> None:
    picture = tmp_path / "frames.png"
    subprocess.run(
        [sys.executable, ROOT / "docs/draw_frames.py", picture],
        env={**os.environ, "XDG_CACHE_HOME": str(tmp_path)},
        check=True,
        timeout=120,
    )
    assert picture.read_bytes().startswith(b"\x89PNG")
