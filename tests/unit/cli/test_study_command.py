"""What ``tronlab study`` says of a study without doing it, and of mistakes."""

from pathlib import Path

import pytest
from small_study import write_small_study
from typer.testing import CliRunner

from tronlab.cli.app import app
from tronlab.errors import ConfigError
from tronlab.study import run
from tronlab.study.steps import Desk, Step


@pytest.fixture
def study_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A study of two steps: one that writes a file, and one that does as the test says."""
    monkeypatch.chdir(tmp_path)
    return write_small_study(tmp_path, with_record=False)


def with_steps(monkeypatch: pytest.MonkeyPatch, *steps: Step) -> None:
    monkeypatch.setattr(run, "steps_of", lambda _: list(steps))
    monkeypatch.setattr(
        "tronlab.study.check.check_study", lambda _study, *, live: live.announce("ok")
    )


def step(name: str, error: BaseException | None = None) -> Step:
    def do(desk: Desk) -> None:
        if error is not None:
            raise error
        (desk.out / name).write_text(str(desk.n_workers))

    return Step(name, "k", 60.0, do, (Path(name),))


def test_a_study_says_what_it_did_and_where_its_page_is(
    study_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with_steps(monkeypatch, step("one"), step("two"))
    done = CliRunner().invoke(app, ["study", str(study_path), "--quick", "--workers", "3"])
    assert done.exit_code == 0, done.output
    assert done.stdout.strip() == "out/tiny-quick/report.html"
    assert "2 steps done" in done.stderr
    assert Path("out/tiny-quick/one").read_text() == "3"
    again = CliRunner().invoke(app, ["study", str(study_path), "--quick"])
    assert "all 2 steps are done, nothing has changed since" in again.stderr


def test_ctrl_c_and_mistakes_leave_what_is_done(
    study_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with_steps(monkeypatch, step("one"), step("two", KeyboardInterrupt("after shot 3")))
    arguments = ["study", str(study_path), "--out", "here"]
    stopped = CliRunner().invoke(app, arguments)
    assert stopped.exit_code == 130
    assert "two: after shot 3\nthe same command goes on" in stopped.stderr
    with_steps(monkeypatch, step("one"), step("two", ConfigError("a mistake")))
    failed = CliRunner().invoke(app, arguments)
    assert str(failed.exception) == "two: a mistake"
    listed = CliRunner().invoke(app, [*arguments, "--steps"])
    assert [line.split() for line in listed.stdout.splitlines()] == [
        ["done", "0:00:00", "one"],
        ["to", "do", "about", "0:01:00", "two"],
    ]


def test_listing_makes_no_folder(study_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with_steps(monkeypatch, step("one"))
    CliRunner().invoke(app, ["study", str(study_path), "--steps"])
    assert not Path("out").exists()
