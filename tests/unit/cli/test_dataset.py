import json
import os
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import pytest
from rich.console import Console
from typer.testing import CliRunner

from tronlab.cli import dataset as command
from tronlab.dataset.journal import Journal, read_journal
from tronlab.dataset.lock import run_lock
from tronlab.dataset.records import Provenance, ShotQuality, ShotRecord, ShotTiming
from tronlab.dataset.sessions import only_session
from tronlab.dataset.writer import DatasetWriter
from tronlab.errors import DatasetError

run = CliRunner().invoke


def facts_in(table: str) -> dict[str, str]:
    lines = dict(line.split("  ", 1) for line in table.splitlines())
    return {name: value.strip() for name, value in lines.items()}


def test_info_shows_what_is_in_it(small_dataset: Path) -> None:
    result = run(command.dataset, ["info", str(small_dataset)])
    assert result.exit_code == 0
    facts = facts_in(result.stdout)
    assert facts["file"] == str(small_dataset)
    assert facts["campaign"] == "straight line"
    assert facts["rig"] == "twin"
    assert facts["seed"] == "42"
    assert facts["status"] == "complete"
    assert facts["shots"] == "5 of 5 planned"
    assert facts["reference views"] == "2"
    assert facts["images"] == "64 x 48, uint8"
    assert facts["range to terrain"] == "3.800 to 4.000 m"
    assert facts["usable fraction"] == "0.742 to 0.794"
    assert facts["calibrated"] == "2026-11-20T10:00:00+00:00"
    assert facts["truth of the shots"] == "5 good"
    assert facts["drift checks"] == "2, at most 0.100 mm (limit 0.5 mm)"
    assert facts["device camera"] == "Prosilica GC1380H 02-2166A 1.42"
    assert facts["version tronlab"] == "0.1.0"
    assert facts["duration"].endswith(" s")


def test_info_of_a_run_that_is_under_way(
    tmp_path: Path,
    make_provenance: Callable[..., Provenance],
    make_shot: Callable[..., ShotRecord],
) -> None:
    path, provenance = tmp_path / "dataset.h5", make_provenance()
    session = replace(
        only_session(provenance, start_utc="2026-11-22T12:00:00.000+00:00"),
        host="lab",
        accepted=("expired 2 days ago",),
    )
    quality = ShotQuality(*[0.1] * 10, brightness=None, flags=("blur", "robot"))
    timing = ShotTiming(3.0, 1.0, 2.0, 0.5, 0.25, 0.25, 1.0)
    shot = replace(make_shot(3), quality=quality, timing=timing, n_failures={"tracking_lost": 2})
    with (
        run_lock(path),
        DatasetWriter(path, provenance, session=session, segment_shots=2) as writer,
    ):
        writer.commit(shot)
        Journal(path).write("skipped", "shot 4: beam lost", shot_id=4)
        Journal(path).write("note", "door was open")
        facts = facts_in(run(command.dataset, ["info", str(tmp_path)]).stdout)
        values = json.loads(run(command.dataset, ["info", "--json", str(tmp_path)]).stdout)
    assert facts["status"] == "running"
    assert facts["written by"].startswith(f"process {os.getpid()} on ")
    assert facts["shots"] == "1 of 5 planned"
    assert facts["skipped shots"] == "4: beam lost"
    assert (facts["flagged blur"], facts["flagged robot"]) == ("3", "3")
    assert facts["failed attempts"] == "2 tracking lost"
    assert facts["session 1"] == (
        "run at 2026-11-22T12:00:00.000+00:00 on lab; accepted: expired 2 days ago"
    )
    assert facts["time move"].split() == ["3.0", "s", "37.5", "%"]
    assert facts["time together"].split() == ["8.0", "s", "100.0", "%"]
    assert "door was open" in facts.values()
    assert values["writer"]["pid"] == os.getpid()
    assert values["skipped"] == {"4": "beam lost"}
    assert values["flagged"] == {"blur": [3], "robot": [3]}
    assert values["n_failures"] == {"tracking_lost": 2}
    assert values["timing_s"]["lost_s"] == 1.0
    assert values["sessions"][0]["accepted"] == ["expired 2 days ago"]
    assert (values["n_shots"], values["n_shots_planned"], values["n_files"]) == (1, 5, 3)


def test_info_at_a_terminal_is_a_table(
    small_dataset: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setattr("rich.console.Console", lambda: Console(width=200, file=sys.stdout))
    command.info(small_dataset)
    assert "5 of 5 planned" in capsys.readouterr().out


def test_validate_a_good_dataset(small_dataset: Path) -> None:
    for named in (small_dataset, small_dataset.parent):
        result = run(command.dataset, ["validate", "--strict", str(named)])
        assert (result.exit_code, result.stdout) == (0, "valid\n")


def test_validate_prints_the_findings_and_fails(small_dataset: Path) -> None:
    with h5py.File(small_dataset, "r+") as file:
        file["entry/shots/shot_id"][3] = 1
    result = run(command.dataset, ["validate", str(small_dataset)])
    assert result.exit_code == 1
    assert "shot 1: is there 2 times\n" in result.stdout
    assert "valid" not in result.stdout.splitlines()


def test_notes_fail_only_if_validation_is_strict(small_dataset: Path) -> None:
    with h5py.File(small_dataset, "r+") as file:
        file["entry/recording/n_shots_planned"][()] = 7
    arguments = ["validate", str(small_dataset)]
    result = run(command.dataset, arguments)
    assert (result.exit_code, result.stdout) == (
        0,
        "note: 5 of 7 planned shots are there\nvalid\n",
    )
    assert run(command.dataset, [*arguments, "--strict"]).exit_code == 1
    assert json.loads(run(command.dataset, [*arguments, "--json"]).stdout) == {
        "is_valid": True,
        "findings": [],
        "notes": ["5 of 7 planned shots are there"],
    }


@pytest.mark.parametrize("name", ["info", "validate", "pack", "migrate"])
def test_what_cannot_be_opened_is_one_error_of_ours(tmp_path: Path, name: str) -> None:
    result = run(command.dataset, [name, str(tmp_path / "none.h5")])
    assert isinstance(result.exception, DatasetError)
    assert "no such file" in str(result.exception)
    result = run(command.dataset, [name, str(tmp_path)])
    assert isinstance(result.exception, DatasetError)
    assert "is a folder without dataset.h5" in str(result.exception)
    (tmp_path / ".dataset.h5.part").touch()
    result = run(command.dataset, [name, str(tmp_path)])
    assert "its run has not recorded a shot yet" in str(result.exception)


def test_pack_says_what_it_brought_and_where_the_file_is(small_dataset: Path) -> None:
    result = run(command.dataset, ["pack", str(small_dataset.parent)])
    ratio, target = result.stdout.splitlines()
    assert " MB packed into " in ratio
    assert target == str(small_dataset.with_name("dataset.packed.h5"))
    assert run(command.dataset, ["validate", target]).exit_code == 0


def test_an_interrupted_pack_says_that_nothing_is_left(
    small_dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("tronlab.dataset.pack.verify", interrupt)
    result = run(command.dataset, ["pack", str(small_dataset)])
    assert result.exit_code == 130
    target = small_dataset.with_name("dataset.packed.h5")
    assert result.stderr.endswith(f"interrupted: nothing is left of {target}\n")
    assert sorted(small_dataset.parent.iterdir()) == [small_dataset]


def test_notes_go_to_the_journal(small_dataset: Path) -> None:
    arguments = ["note", str(small_dataset.parent)]
    assert run(command.dataset, [*arguments, "lamp was warm", "--author", "ada"]).exit_code == 0
    assert run(command.dataset, [*arguments, "-"], input="from\na pipe\n").exit_code == 0
    first, second = read_journal(small_dataset)
    assert (first.kind, first.text, first.fields) == ("note", "lamp was warm", {"author": "ada"})
    assert second.text == "from\na pipe"
    empty = run(command.dataset, [*arguments, "  "])
    assert (empty.exit_code, "is empty" in empty.stderr) == (2, True)


def test_a_run_before_its_first_shot_can_be_noted_in_but_not_what_is_not_there(
    tmp_path: Path,
) -> None:
    result = run(command.dataset, ["note", str(tmp_path), "text"])
    assert "dataset.h5: no such file" in str(result.exception)
    (tmp_path / ".dataset.h5.part").touch()
    assert run(command.dataset, ["note", str(tmp_path), "text"]).exit_code == 0
    assert (tmp_path / "dataset.journal.jsonl").exists()


def test_export_and_import_make_a_dataset_again(small_dataset: Path, tmp_path: Path) -> None:
    table, again = tmp_path / "exported", tmp_path / "again"
    arguments = ["export", str(small_dataset), "--format", "folder", "--out", str(table)]
    result = run(command.dataset, arguments)
    assert (result.exit_code, result.stdout) == (0, f"{table}\n")
    shots = str(table / "shots.csv")
    result = run(command.dataset, ["import", "folder", shots, "--out", str(again)])
    assert (result.exit_code, result.stdout) == (0, f"{again / 'dataset.h5'}\n")
    assert run(command.dataset, ["validate", str(again)]).exit_code == 0
    result = run(command.dataset, [*arguments[:3], "papyrus", "--out", str(tmp_path / "other")])
    assert "no format 'papyrus'; known are bop, speedplus, tum" in str(result.exception)
