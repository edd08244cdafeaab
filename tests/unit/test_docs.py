"""The documentation says what is: its links, its tables and its snippets."""

import doctest
import re
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages

import pytest

import tronlab
from tronlab.errors import TronlabError
from tronlab.geometry.frames import FRAMES
from tronlab.score.table import COLUMNS

ROOT = Path(__file__).parents[2]
CONVENTIONS = ROOT / "docs/conventions.md"
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("campaigns/*.md")])
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
