from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

import pytest
from pydantic import Field, model_validator

from tronlab.errors import ConfigError
from tronlab.yaml_models import (
    ExistingFile,
    Model,
    join_errors,
    line_of,
    load_model,
    parse_model,
)

Name = Annotated[str, Field(pattern=r"^[a-z]+$")]


class Line(Model):
    kind: Literal["line"]
    start_m: tuple[float, float, float]
    exposure_s: Annotated[float, Field(gt=0, le=1)] = 0.1
    n_points: int = 3


class File(Model):
    kind: Literal["file"]
    path: ExistingFile


class Range(Model):
    low_m: float
    high_m: float

    @model_validator(mode="after")
    def _ordered(self) -> "Range":
        if self.low_m > self.high_m:
            raise ValueError("low_m must not exceed high_m")
        return self


class Document(Model):
    name: str
    trajectory: Annotated[Line | File, Field(discriminator="kind")]
    range: Range | None = None
    extra: tuple[Line, ...] = ()
    named: Mapping[Name, Range] = {}
    ranges: Mapping[str, Range] = {}
    colour: Literal["red", "green"] = "red"


GOOD = "name: a\ntrajectory:\n  kind: line\n  start_m: [1, 2.5, 3e-1]\n"


def problems(tmp_path: Path, text: str) -> list[str]:
    path = tmp_path / "a.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_model(path, Document)
    return [line.replace(str(tmp_path), "") for line in str(caught.value).splitlines()]


def test_good_file_is_read_as_yaml_1_2(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text(GOOD.replace("name: a", "name: no"))
    document = load_model(tmp_path / "a.yaml", Document)
    assert document.name == "no"  # YAML 1.1 would read False
    assert isinstance(document.trajectory, Line)
    assert document.trajectory.start_m == (1.0, 2.5, 0.3)  # YAML 1.1 would read "3e-1"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        pytest.param(
            GOOD + "  exposure_ms: 4\n",
            "/a.yaml:5: trajectory.exposure_ms: unknown key, did you mean exposure_s (in seconds)?",
            id="wrong unit suffix",
        ),
        pytest.param(
            GOOD + "  n_point: 4\n",
            "/a.yaml:5: trajectory.n_point: unknown key, did you mean n_points?",
            id="misspelt key",
        ),
        pytest.param(
            GOOD + "zzz: 4\n",
            "/a.yaml:5: zzz: unknown key; known keys: name, trajectory, range, extra, named,",
            id="unknown key like none",
        ),
        pytest.param(
            GOOD + "1: 4\n", "/a.yaml:5: 1: unknown key; known keys: ", id="number as key"
        ),
        pytest.param(
            GOOD + "named:\n  one: {low_m: 1, high_m: 2, low_mm: 3}\n",
            "/a.yaml:6: named.one.low_mm: unknown key, did you mean low_m (in metres)?",
            id="below a name of the user's own",
        ),
        pytest.param(
            GOOD + "ranges:\n  one: {low_m: 1, high_m: 2, low_mm: 3}\n",
            "/a.yaml:6: ranges.one.low_mm: unknown key, did you mean low_m (in metres)?",
            id="below any name",
        ),
        pytest.param(
            GOOD + "range:\n  low_mm: 1\n  low_m: 1\n  high_m: 2\n",
            "/a.yaml:6: range.low_mm: unknown key, did you mean low_m (in metres)?",
            id="wrong unit in an optional section",
        ),
        pytest.param(
            GOOD + "extra:\n  - kind: line\n    start_m: [0, 0, 0]\n    exposure_us: 3\n",
            "/a.yaml:8: extra[0].exposure_us: unknown key, did you mean exposure_s (in seconds)?",
            id="wrong unit in a list",
        ),
        pytest.param(
            GOOD.replace("2.5", "far"),
            '/a.yaml:4: trajectory.start_m[1]: must be a valid number, got "far"',
            id="text for number",
        ),
        pytest.param(
            GOOD.replace("2.5", "true"),
            "/a.yaml:4: trajectory.start_m[1]: must be a valid number, got true",
            id="boolean for number",
        ),
        pytest.param(
            GOOD + '  n_points: "4"\n',
            '/a.yaml:5: trajectory.n_points: must be a valid integer, got "4"',
            id="quoted number",
        ),
        pytest.param(
            GOOD + "  n_points: 4.5\n",
            "/a.yaml:5: trajectory.n_points: must be a valid integer, got 4.5",
            id="fraction for integer",
        ),
        pytest.param(
            GOOD.replace("name: a", "name: 5"),
            "/a.yaml:1: name: must be a valid string, got 5",
            id="number for text",
        ),
        pytest.param(
            GOOD + "  exposure_s: 2\n",
            "/a.yaml:5: trajectory.exposure_s: must be less than or equal to 1, got 2",
            id="out of range",
        ),
        pytest.param(
            GOOD + "  exposure_s: .nan\n",
            "/a.yaml:5: trajectory.exposure_s: must be a finite number, got NaN",
            id="nan",
        ),
        pytest.param(
            GOOD.replace(", 3e-1", ""),
            "/a.yaml:4: trajectory.start_m[2]: this value of the list is missing",
            id="short list",
        ),
        pytest.param(
            "name: a\ntrajectory:\n  kind: line\n",
            "/a.yaml:2: trajectory.start_m: required key is missing",
            id="missing key",
        ),
        pytest.param(
            GOOD.replace("kind: line", "kind: spiral"),
            "/a.yaml:3: trajectory.kind: unknown value 'spiral', allowed: 'line', 'file'",
            id="unknown kind",
        ),
        pytest.param(
            GOOD.replace("  kind: line\n", ""),
            "/a.yaml:2: trajectory: required key 'kind' is missing",
            id="missing kind",
        ),
        pytest.param(
            GOOD + "colour: blue\n",
            "/a.yaml:5: colour: must be 'red' or 'green', got \"blue\"",
            id="not among the allowed",
        ),
        pytest.param(
            GOOD + "range: {low_m: 2, high_m: 1}\n",
            "/a.yaml:5: range: low_m must not exceed high_m",
            id="keys that contradict each other",
        ),
        pytest.param(
            "name: a\ntrajectory:\n  kind: file\n  path: gone.csv\n",
            "/a.yaml:4: trajectory.path: no such file: /gone.csv",
            id="missing file",
        ),
        pytest.param(
            "name: a\ntrajectory:\n  kind: file\n  path: .\n",
            "/a.yaml:4: trajectory.path: is a directory, not a file: ",
            id="directory for file",
        ),
        pytest.param(
            GOOD + "name: b\n", '/a.yaml:5: found duplicate key "name"', id="duplicate key"
        ),
        pytest.param("a: [1\n", "/a.yaml:2: not valid YAML: expected ',' or ']'", id="open list"),
        pytest.param(
            "a: 1\n\tb: 2\n", "/a.yaml:2: not valid YAML: found character '\\t'", id="tab"
        ),
        pytest.param("a: 1\n---\nb: 2\n", "/a.yaml:2: not valid YAML: ", id="two documents"),
        pytest.param("a: \x00\n", "/a.yaml: not valid YAML: unacceptable character", id="binary"),
        pytest.param("# only a comment\n", "/a.yaml: is empty", id="empty"),
        pytest.param("- a\n- b\n", "/a.yaml:1: expected keys and values at the top", id="list"),
    ],
)
def test_mistake_is_named_with_file_line_and_key(tmp_path: Path, text: str, expected: str) -> None:
    found = problems(tmp_path, text)
    assert len(found) == 1
    assert found[0].startswith(expected)


def test_all_mistakes_are_listed_in_the_order_of_the_file(tmp_path: Path) -> None:
    text = "name: 5\ntrajectory:\n  kind: line\n  start_m: [1, x, 3]\n  exposure_ms: 4\nfoo: 1\n"
    found = problems(tmp_path, text)
    assert [line.split(": ")[0] for line in found] == [f"/a.yaml:{line}" for line in (1, 4, 5, 6)]


def test_error_carries_the_place_of_the_first_mistake(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(GOOD + "  n_points: x\nfoo: 1\n")
    with pytest.raises(ConfigError) as caught:
        load_model(path, Document)
    assert (caught.value.path, caught.value.line, caught.value.key) == (
        path,
        5,
        "trajectory.n_points",
    )


def test_unreadable_files(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"gone\.yaml: no such file"):
        load_model(tmp_path / "gone.yaml", Document)
    with pytest.raises(ConfigError, match="is a directory, expected a file"):
        load_model(tmp_path, Document)
    (tmp_path / "latin.yaml").write_bytes("name: ä\n".encode("latin-1"))
    with pytest.raises(ConfigError, match=r"not UTF-8 text \(byte 6\)"):
        load_model(tmp_path / "latin.yaml", Document)


def test_files_are_relative_to_the_yaml_and_may_be_overridden(tmp_path: Path) -> None:
    (tmp_path / "poses.csv").touch()
    text = "name: a\ntrajectory:\n  kind: file\n  path: {}\n"
    document = parse_model(text.format("poses.csv"), Document, path=tmp_path / "a.yaml")
    assert isinstance(document.trajectory, File)
    assert document.trajectory.path == tmp_path / "poses.csv"
    gone = parse_model(
        text.format("gone.csv"), Document, path=tmp_path / "a.yaml", overridden={"path"}
    )
    assert isinstance(gone.trajectory, File)


def test_models_are_immutable(tmp_path: Path) -> None:
    document = parse_model(GOOD, Document, path=tmp_path / "a.yaml")
    with pytest.raises(ValueError, match="frozen"):
        document.name = "b"  # pyright: ignore[reportAttributeAccessIssue]


def test_line_of_a_key() -> None:
    assert line_of(GOOD, ("trajectory", "start_m", 2)) == 4
    assert line_of(GOOD, ("nothing",)) is None
    assert line_of("a: [", ("a",)) is None


def test_join_errors_keeps_a_single_one_as_it_is() -> None:
    error = ConfigError("wrong", path="a.yaml", line=3, key="b")
    assert join_errors([error]) is error
    joined = join_errors([error, ConfigError("bad", path="a.yaml", line=5)])
    assert str(joined) == "a.yaml:3: b: wrong\na.yaml:5: bad"
