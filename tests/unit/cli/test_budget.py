"""The command ``tronlab budget``."""

import csv
from pathlib import Path

import pytest
import typer
from measured_record import measured_record
from typer.testing import CliRunner

from tronlab.cli.budget import budget
from tronlab.errors import CalibrationError, ConfigError

CAMPAIGN = Path(__file__).parents[3] / "campaigns/straight_line.yaml"


@pytest.fixture
def record(tmp_path):
    path = tmp_path / "record.json"
    measured_record(seed=1).save(path)
    return path


def run(*arguments):
    app = typer.Typer()
    app.command()(budget)
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def rows_of(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_prints_the_budget_and_writes_table_and_plot(record, tmp_path):
    out = tmp_path / "new" / "folder"
    result = run(record, "--out", out)
    assert result.exit_code == 0, result.output
    assert f"error budget of {record}" in result.stdout
    assert "camera centre: frame dominates" in result.stdout
    assert result.stdout.splitlines()[-2:] == [
        f"table: {out / 'budget.csv'}",
        f"plot: {out / 'budget.png'}",
    ]
    rows = rows_of(out / "budget.csv")
    assert len(rows) == 46
    assert float(rows[0]["range_los_m"]) == pytest.approx(0.5)
    assert 0.05 < float(rows[0]["total_mm"]) < 0.2
    assert (out / "budget.png").read_bytes().startswith(b"\x89PNG")


def test_the_poses_of_a_campaign(record, tmp_path):
    result = run(record, "--campaign", CAMPAIGN, "--out", tmp_path)
    assert result.exit_code == 0, result.output
    ranges = [float(row["range_los_m"]) for row in rows_of(tmp_path / "budget.csv")]
    assert len(ranges) > 50
    assert ranges == sorted(ranges, reverse=True)


def test_mistakes_are_told(record, tmp_path):
    assert isinstance(run(tmp_path / "none.json").exception, CalibrationError)
    assert isinstance(run(record, "--campaign", tmp_path / "none.yaml").exception, ConfigError)
    blocked = run(record, "--out", record)
    assert isinstance(blocked.exception, CalibrationError)
    assert "name another folder: --out DIR" in str(blocked.exception)
