"""YAML files that extend others."""

from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field

from tronlab.errors import ConfigError
from tronlab.yaml_models import ExistingFile, Model
from tronlab.yaml_variants import merged, read_document, recorded_values


class Line(Model):
    kind: Literal["line"]
    length_m: float
    n: int = 3


class Poses(Model):
    kind: Literal["poses"]
    path: ExistingFile


class Lens(Model):
    focal_length_m: float = 0.005
    distortion: tuple[float, float] = (0.0, 0.0)


class World(Model):
    lens: Lens = Lens()
    seed: Annotated[int, Field(ge=0)] = 0


class Document(Model):
    name: str
    way: Annotated[Line | Poses, Field(discriminator="kind")]
    pictures: tuple[Path, ...] = ()
    world: World | None = None
    options: Annotated[dict[str, Any], Field(default_factory=dict)]


BASE = """\
name: base
way: {kind: line, length_m: 2.0, n: 5}
pictures: [a.png]
world:
  lens:
    focal_length_m: 0.004
    distortion: [0.1, 0.2]
  seed: 3
options: {device: {path: ../out/dimmer, port: socket://host/1, type: CCR}}
"""


def write(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def base(tmp_path: Path) -> Path:
    return write(tmp_path / "base.yaml", BASE)


def problems(path: Path) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        read_document(path).read_as(Document)
    return str(caught.value).replace(f"{path.parent}/", "").splitlines()


def test_own_keys_replace_whole_and_changes_reach_deeper(base: Path) -> None:
    text = "extends: base.yaml\nname: mine\npictures: []\n"
    text += "changes: {world: {lens: {distortion: [1, 2]}}}\n"
    mine = read_document(write(base.parent / "mine.yaml", text)).read_as(Document)
    assert (mine.name, mine.pictures) == ("mine", ())
    assert mine.world == World(lens=Lens(focal_length_m=0.004, distortion=(1, 2)), seed=3)
    assert mine.way == Line(kind="line", length_m=2.0, n=5)
    text = "extends: base.yaml\nworld: {lens: {distortion: [1, 2]}}\nchanges: {world: {seed: 4}}"
    mine = read_document(write(base.parent / "mine.yaml", text)).read_as(Document)
    assert mine.world == World(lens=Lens(distortion=(1, 2)), seed=4)


def test_a_section_of_another_kind_is_replaced_whole(base: Path) -> None:
    write(base.parent / "poses.csv", "")
    text = "extends: base.yaml\nchanges: {way: {kind: poses, path: poses.csv}, world: null}"
    mine = read_document(write(base.parent / "mine.yaml", text)).read_as(Document)
    assert mine.way == Poses(kind="poses", path=base.parent / "poses.csv")
    assert mine.world is None
    text = "extends: base.yaml\nchanges: {way: {kind: line, n: 7}}"
    mine = read_document(write(base.parent / "mine.yaml", text)).read_as(Document)
    assert mine.way == Line(kind="line", length_m=2.0, n=7)


def test_a_variant_of_a_variant(base: Path) -> None:
    write(base.parent / "mine.yaml", "extends: base.yaml\nchanges: {world: {seed: 4}, way: {n: 6}}")
    path = write(base.parent / "third.yaml", "extends: mine.yaml\nchanges: {world: {seed: 5}}")
    third = read_document(path).read_as(Document)
    assert third.way == Line(kind="line", length_m=2.0, n=6)
    assert third.world == World(lens=Lens(focal_length_m=0.004, distortion=(0.1, 0.2)), seed=5)


def test_a_relative_path_starts_from_the_file_it_is_written_in(base: Path) -> None:
    folder = base.parent
    write(folder / "poses.csv", "")
    text = "extends: ../base.yaml\nchanges: {way: {kind: poses, path: ../poses.csv}}\n"
    middle = write(folder / "b/middle.yaml", text)
    text = f"extends: {middle}\nchanges: {{options: {{device: {{socket: run/socket}}}}}}\n"
    mine = read_document(write(folder / "c/d/mine.yaml", text)).read_as(Document)
    assert mine.way == Poses(kind="poses", path=folder / "b/../poses.csv")
    assert mine.pictures == (folder / "b/../a.png",)
    assert mine.options["device"] == {
        "path": str(folder / "b/../../out/dimmer"),
        "port": "socket://host/1",
        "type": "CCR",
        "socket": "run/socket",  # of the file itself: whoever reads it knows where that lies
    }


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        (
            "{world: {lens: {focal_lenght_m: 1}}}",
            "mine.yaml:2: changes.world.lens.focal_lenght_m: unknown key, did you mean",
        ),
        (
            "{world: {lens: {distortion: [1, far]}}}",
            'mine.yaml:2: changes.world.lens.distortion[1]: must be a valid number, got "far"',
        ),
        ("{way: {kind: bend}}", "mine.yaml:2: changes.way.kind: unknown value 'bend', allowed: "),
        ("{way: {kind: poses}}", "mine.yaml:2: changes.way.path: required key is missing"),
        ("{wrld: {seed: 1}}", "mine.yaml:2: changes.wrld: unknown key, did you mean world?"),
        ("{world: [1]}", "mine.yaml:2: changes.world: must be an object, got [1]"),
        ("[1]", "mine.yaml:2: changes: must be keys with their new values"),
    ],
)
def test_a_mistake_in_changes_is_named_by_file_line_and_key(
    base: Path, changes: str, expected: str
) -> None:
    path = write(base.parent / "mine.yaml", f"extends: base.yaml\nchanges: {changes}\n")
    (problem,) = problems(path)
    assert problem.startswith(expected)


def test_mistakes_are_named_in_the_file_they_are_written_in(base: Path) -> None:
    base.write_text(BASE.replace("seed: 3", "seed: -3"))
    path = write(base.parent / "mine.yaml", "extends: base.yaml\nname: 5\nchanges: {way: {n: x}}\n")
    assert problems(path) == [
        "base.yaml:8: world.seed: must be greater than or equal to 0, got -3",
        "mine.yaml:2: name: must be a valid string, got 5",
        'mine.yaml:3: changes.way.n: must be a valid integer, got "x"',
    ]
    document = read_document(path)
    found = str(document.error("is wrong", "world", "lens", "distortion", 1))
    assert found == f"{base}:7: world.lens.distortion[1]: is wrong"
    assert str(document.error("is wrong", "options", "x")).startswith(f"{base}:9: options.x")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("extends: 5\n", r"mine\.yaml:1: extends: must be the path of a YAML file"),
        ("name: a\nextends: gone.yaml\n", r"mine\.yaml:2: extends: no such file: .*gone\.yaml"),
        ("extends: mine.yaml\n", r"mine\.yaml:1: extends: the file extends itself"),
        ("extends: other.yaml\n", r"other\.yaml:1: extends: the file extends itself by way of"),
        ("changes: {name: a}\n", r"changes: unknown key"),
    ],
)
def test_what_cannot_be_extended(tmp_path: Path, text: str, expected: str) -> None:
    write(tmp_path / "other.yaml", "extends: mine.yaml\n")
    with pytest.raises(ConfigError, match=expected):
        read_document(write(tmp_path / "mine.yaml", text)).read_as(Document)


def test_what_was_recorded_says_the_same(base: Path) -> None:
    text = "# c\nextends: base.yaml\nname: mine\nchanges: {world: {seed: 4}, way: {kind: poses}}"
    document = read_document(write(base.parent / "mine.yaml", text))
    assert document.whole_text == f"{text}\n# --- extends: base.yaml\n{BASE}"
    assert recorded_values(document.whole_text) == document.values
    assert document.values["world"]["seed"] == 4
    assert document.values["way"] == {"kind": "poses"}
    assert recorded_values("") == {}
    with pytest.raises(ConfigError, match="not valid YAML"):
        recorded_values("a: [")


LEAVES = st.integers() | st.lists(st.integers(), max_size=2)
NESTED = st.recursive(
    st.dictionaries(st.sampled_from("abc"), LEAVES, max_size=3),
    lambda inner: st.dictionaries(st.sampled_from(["a", "b", "kind"]), inner | LEAVES, max_size=3),
    max_leaves=8,
)


@given(NESTED, NESTED)
def test_changes_are_there_and_nothing_else_has_changed(
    base: dict[str, Any], changes: dict[str, Any]
) -> None:
    result = merged(base, changes)
    assert merged(result, changes) == result
    assert merged(base, {}) == base
    assert merged({}, changes) == changes
    assert result.keys() == base.keys() | changes.keys()
    for key in base.keys() - changes.keys():
        assert result[key] == base[key]
    for key, value in changes.items():
        before = base.get(key)
        is_section = isinstance(value, dict) and isinstance(before, dict)
        if is_section and ("kind" not in value or before.get("kind") == value["kind"]):
            assert result[key] == merged(before, value)
        else:
            assert result[key] == value
