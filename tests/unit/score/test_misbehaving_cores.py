"""Cores that crash, hang, chat or answer nonsense, scored beside one that does not."""

import csv
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from misbehaving_core import EVERY, LATE_S, WAYS
from plane_dataset import N_SHOTS
from typer.testing import CliRunner

from tronlab.cli.app import app
from tronlab.score.results import load_results

TESTS = Path(__file__).parents[2]
SCRIPT = TESTS / "support/misbehaving_core.py"
GOOD = "akaze-refined"
LIMIT_S = 0.8

WHAT_HAPPENS = {
    "crash": ("error", r"signal 6 \(Aborted\).*pose\.c:42: assertion failed"),
    "segfault": ("error", r"signal 11 \(Segmentation fault\)"),
    "leave": ("error", "code 3"),
    "hang": ("timeout", r"no answer within 0\.8 s"),
    "late": ("timeout", r"answered 0\.\d+ s after the limit of 0\.8 s"),
    "chat": ("error", 'wrote "Loading model'),
    "nan": ("error", "finite|nan|NaN"),
    "wrong-frame": ("error", "'?trs'?.*'?cam'?|'?cam'?.*'?trs'?"),
    "wrong-number": ("error", "8"),
}
"""The status of the tenth frame and a part of the reason, for each way but noise."""


def test_every_way_to_misbehave_is_expected() -> None:
    assert set(WHAT_HAPPENS) == set(WAYS) - {"noise"}
    assert LIMIT_S < LATE_S < 2 * LIMIT_S


def score(dataset: Path, cores: list[str], out: Path, *options: str) -> str:
    """Score as a person does; give what is printed."""
    named = [text for core in cores for text in ("--core", core)]
    where = ("--workers", "1", "--fresh", "--out", str(out))
    done = CliRunner().invoke(app, ["score", str(dataset), *named, *where, *options])
    assert done.exit_code == 0, done.output
    return done.output


@pytest.fixture(scope="module")
def alone(plane_dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("alone")
    score(plane_dataset, [GOOD], out)
    return out


@pytest.fixture(scope="module")
def crowd(
    plane_dataset: Path, alone: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, str]:
    """The folder of the good core among all others, and what was printed.

    After ``alone``, so that what the good core does but once is not held against the short limit.
    """
    assert alone.is_dir()
    out = tmp_path_factory.mktemp("crowd")
    others = [f"{way}=cmd:{sys.executable} {SCRIPT} {way}" for way in WAYS]
    cores = [*others[:4], GOOD, *others[4:]]
    return out, score(plane_dataset, cores, out, "--time-limit", str(LIMIT_S))


@pytest.fixture(scope="module")
def reasons(crowd: tuple[Path, str]) -> Mapping[tuple[str, int, int], str]:
    """Why there is no pose, by core, seed and shot id."""
    return load_results(crowd[0]).reasons


def rows(folder: Path, core: str) -> list[Mapping[str, str]]:
    with (folder / "scores.csv").open(newline="") as file:
        return [row for row in csv.DictReader(file) if row["core"] == core]


def test_the_rows_of_the_good_core_are_those_it_has_alone(
    alone: Path, crowd: tuple[Path, str]
) -> None:
    def without_times(folder: Path) -> list[Mapping[str, str]]:
        return [
            {key: text for key, text in row.items() if not key.startswith("time_")}
            for row in rows(folder, GOOD)
        ]

    assert without_times(crowd[0]) == without_times(alone)
    assert [row["status"] for row in rows(alone, GOOD)] == ["ok"] * N_SHOTS
    assert max(float(row["position_error_m"]) for row in rows(alone, GOOD)) < 0.05


def test_so_are_its_matches(alone: Path, crowd: tuple[Path, str]) -> None:
    stored: list[dict[str, Any]] = []
    for folder in (alone, crowd[0]):
        with h5py.File(folder / "matches.h5") as file:
            found: dict[str, Any] = {}
            file[GOOD].visititems(
                lambda name, item, found=found: found.update(
                    {
                        name: (
                            dict(item.attrs),
                            item[()].tobytes() if hasattr(item, "shape") else b"",
                        )
                    }
                )
            )
            stored.append(found)
    assert stored[0]
    assert str(stored[0]) == str(stored[1])


@pytest.mark.parametrize("way", WHAT_HAPPENS)
def test_the_tenth_frame_says_what_happened_and_the_others_are_scored(
    crowd: tuple[Path, str], reasons: Mapping[tuple[str, int, int], str], way: str
) -> None:
    expected, reason = WHAT_HAPPENS[way]
    statuses = [row["status"] for row in rows(crowd[0], way)]
    assert statuses == [expected if i % EVERY == EVERY - 1 else "ok" for i in range(N_SHOTS)], (
        reasons
    )
    (shot_id,) = [int(row["shot_id"]) for row in rows(crowd[0], way) if row["status"] != "ok"]
    assert re.search(reason, reasons[way, 0, shot_id]), reasons[way, 0, shot_id]


def test_noise_is_scored_for_what_it_is(crowd: tuple[Path, str]) -> None:
    noise = rows(crowd[0], "noise")
    assert [row["status"] for row in noise] == ["ok"] * N_SHOTS
    assert np.median([float(row["position_error_m"]) for row in noise]) > 10.0


def test_the_command_names_each_of_them(crowd: tuple[Path, str]) -> None:
    for way in WAYS:
        assert re.search(rf"\b{way}\b", crowd[1]), crowd[1]
