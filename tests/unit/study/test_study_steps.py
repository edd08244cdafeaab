"""A study does its steps once, in their order, and goes on after whatever ended it."""

import io
import json
import multiprocessing
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from small_study import write_small_study

from tronlab.errors import ConfigError, ScoreError
from tronlab.study.ledger import LEDGER_NAME
from tronlab.study.run import StepError, StudyRun, run_steps
from tronlab.study.steps import Desk, Step
from tronlab.study.study import Study, load_study
from tronlab.study.view import PlainView, TimeLeft

SETTINGS = ("one", "two", "three")


@pytest.fixture
def study(tmp_path: Path) -> Study:
    return load_study(write_small_study(tmp_path, with_record=False))


def writing_step(name: str, key: str = "k", *, run: Callable[[Desk], None] | None = None) -> Step:
    """Give a step that adds a line to ``NAME.txt``."""

    def write(desk: Desk) -> None:
        if run is not None:
            run(desk)
        with (desk.out / f"{name}.txt").open("a") as file:
            file.write(f"{key} {'begun' if desk.is_begun else 'new'}\n")

    return Step(name, key, 1.0, write, (Path(f"{name}.txt"),))


def do(study: Study, steps: list[Step], out: Path, shown: io.StringIO | None = None) -> StudyRun:
    view = PlainView(shown or io.StringIO())
    return run_steps(study, steps, out, n_workers=1, view=view, check=lambda: None)


def lines(out: Path, name: str) -> list[str]:
    return (out / f"{name}.txt").read_text().splitlines()


def test_what_is_done_is_not_done_again(study: Study, tmp_path: Path) -> None:
    out, shown = tmp_path / "out", io.StringIO()
    steps = [writing_step(name) for name in SETTINGS]
    assert do(study, steps, out).n_done == 3
    again = do(study, steps, out, shown)
    assert (again.n_done, again.n_done_before) == (0, 3)
    assert "all 3 steps are done" in shown.getvalue()
    assert [lines(out, name) for name in SETTINGS] == [["k new"]] * 3


def test_a_step_with_another_key_or_without_its_results_is_done_again(
    study: Study, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    do(study, [writing_step(name) for name in SETTINGS], out)
    (out / "three.txt").unlink()
    changed = [writing_step("one"), writing_step("two", "l"), writing_step("three")]
    assert do(study, changed, out).n_done == 2
    assert lines(out, "two") == ["l new"]  # nothing of another key is left to go on with
    assert lines(out, "three") == ["k begun"]


def test_a_step_that_is_gone_is_forgotten(study: Study, tmp_path: Path) -> None:
    out = tmp_path / "out"
    do(study, [writing_step(name) for name in SETTINGS], out)
    do(study, [writing_step("one")], out)
    assert [step["name"] for step in json.loads((out / LEDGER_NAME).read_text())["steps"]] == [
        "one"
    ]


def test_a_failed_step_says_which_it_is_and_is_done_the_next_time(
    study: Study, tmp_path: Path
) -> None:
    def fail(_: Desk) -> None:
        raise ScoreError("no landmark")

    out = tmp_path / "out"
    steps = [writing_step("one"), writing_step("two", run=fail), writing_step("three")]
    with pytest.raises(StepError, match=r"^two: no landmark$"):
        do(study, steps, out)
    assert not (out / "three.txt").exists()
    do(study, [writing_step(name) for name in SETTINGS], out)
    assert [lines(out, name) for name in SETTINGS] == [["k new"], ["k begun"], ["k new"]]


def test_ctrl_c_says_how_to_go_on(study: Study, tmp_path: Path) -> None:
    def interrupt(_: Desk) -> None:
        raise KeyboardInterrupt("stopped after shot 3")

    with pytest.raises(KeyboardInterrupt) as caught:
        do(study, [writing_step("one", run=interrupt)], tmp_path / "out")
    assert str(caught.value) == "one: stopped after shot 3\nthe same command goes on"


def test_two_steps_of_one_name_are_refused(study: Study, tmp_path: Path) -> None:
    with pytest.raises(StepError, match="two steps are called one"):
        do(study, [writing_step("one"), writing_step("one")], tmp_path / "out")


def test_a_folder_of_something_else_stays_as_it_is(study: Study, tmp_path: Path) -> None:
    out = tmp_path / "photos"
    out.mkdir()
    (out / "cat.jpg").touch()
    with pytest.raises(ConfigError, match=r"holds no study \(cat.jpg.*--out"):
        do(study, [writing_step("one")], out)
    assert [path.name for path in out.iterdir()] == ["cat.jpg"]


def test_a_damaged_ledger_is_one_clear_error(study: Study, tmp_path: Path) -> None:
    out = tmp_path / "out"
    do(study, [writing_step("one")], out)
    (out / LEDGER_NAME).write_text('{"steps": [{"name": ')
    with pytest.raises(ConfigError, match=r"study\.json: is damaged.*begin anew"):
        do(study, [writing_step("one")], out)


def test_mistakes_are_looked_for_only_if_there_is_something_to_do(
    study: Study, tmp_path: Path
) -> None:
    def check() -> None:
        raise ConfigError("a mistake")

    out, steps = tmp_path / "out", [writing_step("one")]
    view = PlainView(io.StringIO())
    with pytest.raises(ConfigError, match="a mistake"):
        run_steps(study, steps, out, n_workers=1, view=view, check=check)
    assert not (out / "one.txt").exists()
    do(study, steps, out)
    assert run_steps(study, steps, out, n_workers=1, view=view, check=check).n_done == 0


def wait_for(path: Path) -> None:
    end_s = time.monotonic() + 30.0
    while not path.exists():
        assert time.monotonic() < end_s, f"{path} does not come"
        time.sleep(0.005)


def test_a_killed_study_goes_on_and_nobody_else_may_meanwhile(study: Study, tmp_path: Path) -> None:
    def hang(desk: Desk) -> None:
        (desk.out / "hangs").touch()
        time.sleep(60.0)

    out = tmp_path / "out"
    hanging = [writing_step("one"), writing_step("two", run=hang), writing_step("three")]
    child = multiprocessing.get_context("fork").Process(target=do, args=(study, hanging, out))
    child.start()
    assert child.pid is not None
    try:
        wait_for(out / "hangs")
        with pytest.raises(ConfigError, match=f"a study is going on in it .process {child.pid} on"):
            do(study, [writing_step(name) for name in SETTINGS], out)
    finally:
        os.kill(child.pid, signal.SIGKILL)
        child.join()
    run = do(study, [writing_step(name) for name in SETTINGS], out)
    assert (run.n_done_before, run.n_done) == (1, 2)
    assert [lines(out, name) for name in SETTINGS] == [["k new"], ["k begun"], ["k new"]]


def test_what_a_step_took_is_written_down(study: Study, tmp_path: Path) -> None:
    held: list[bytes] = []

    def hold(_: Desk) -> None:
        held.append(b"x" * 200_000_000)

    def forget(_: Desk) -> None:
        held.clear()

    out = tmp_path / "out"
    steps = [
        writing_step("large", run=hold),
        writing_step("forget", run=forget),
        writing_step("small"),
    ]
    do(study, steps, out)
    ledger = json.loads((out / LEDGER_NAME).read_text())
    peaks = {step["name"]: step["peak_memory_mb"] for step in ledger["steps"]}
    assert ledger["software"]["numpy"]
    assert all(step["seconds"] > 0 for step in ledger["steps"])
    assert 150 < peaks["large"] - peaks["small"] < 250


def test_the_time_left_learns_from_steps_done() -> None:
    now_s = 0.0
    steps = [Step(name, "k", 30.0, lambda _: None, ()) for name in SETTINGS]
    left = TimeLeft(steps, {"three": 5.0}, monotonic_s=lambda: now_s)
    assert left.left_s == 65.0
    left.begin(steps[0])
    now_s = 60.0
    assert left.left_s == 35.0  # more than it was to take is not taken from the others
    left.end(steps[0], seconds=60.0)
    assert left.left_s == pytest.approx(30.0 * (60.0 + 30.0) / (30.0 + 30.0) + 5.0)
