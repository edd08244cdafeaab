import sys
from collections.abc import Callable
from pathlib import Path

import h5py
import pytest
from rich.console import Console
from typer.testing import CliRunner

from tronlab.cli import dataset as command
from tronlab.dataset.records import Provenance
from tronlab.dataset.writer import DatasetWriter
from tronlab.errors import DatasetError

run = CliRunner().invoke


def test_info_shows_what_is_in_it(small_dataset: Path) -> None:
    result = run(command.dataset, ["info", str(small_dataset)])
    assert result.exit_code == 0
    lines = dict(line.split("  ", 1) for line in result.output.splitlines())
    facts = {name: value.strip() for name, value in lines.items()}
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


def test_info_of_an_empty_unfinished_dataset(
    tmp_path: Path, make_provenance: Callable[..., Provenance]
) -> None:
    with DatasetWriter(tmp_path / "a.h5", make_provenance()):
        pass
    output = run(command.dataset, ["info", str(tmp_path / "a.h5")]).output
    for line in ("shots", "0 of 5 planned", "64 x 48, none yet", "running"):
        assert line in output


def test_info_at_a_terminal_is_a_table(
    small_dataset: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setattr("rich.console.Console", lambda: Console(width=200, file=sys.stdout))
    command.info(small_dataset)
    assert "5 of 5 planned" in capsys.readouterr().out


def test_validate_a_good_dataset(small_dataset: Path) -> None:
    result = run(command.dataset, ["validate", str(small_dataset)])
    assert (result.exit_code, result.output) == (0, "valid\n")


def test_validate_prints_the_findings_and_fails(small_dataset: Path) -> None:
    with h5py.File(small_dataset, "r+") as file:
        file["entry/shots/shot_id"][3] = 1
    result = run(command.dataset, ["validate", str(small_dataset)])
    assert result.exit_code == 1
    assert "shot 1: is there 2 times\n" in result.output
    assert "valid" not in result.output.splitlines()


@pytest.mark.parametrize("name", ["info", "validate"])
def test_a_file_that_cannot_be_opened_is_one_error_of_ours(tmp_path: Path, name: str) -> None:
    result = run(command.dataset, [name, str(tmp_path / "none.h5")])
    assert isinstance(result.exception, DatasetError)
    assert "no such file" in str(result.exception)
