"""Worker processes: what dies, hangs or is interrupted costs what it was at, and nothing else."""

import multiprocessing
from collections.abc import Callable
from dataclasses import replace
from types import ModuleType

import pandas as pd
import pytest

from tronlab.errors import ScoreError
from tronlab.nav.specs import CoreSpec
from tronlab.score.rescore import score_jobs
from tronlab.score.rescoring import workers as workers_module
from tronlab.score.rescoring.job import ScoreJob, Scoring
from tronlab.score.rescoring.prior import PriorSettings
from tronlab.score.rescoring.unit import Asked, Unit, failed_unit, rest_of, score_unit
from tronlab.score.rescoring.workers import ProcessExecutor
from tronlab.score.results import load_results

MakeJob = Callable[..., ScoreJob]


def test_a_core_that_crashes_or_hangs_costs_its_own_answers_only(
    make_job: MakeJob, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workers_module, "MARGIN_S", 0.5)
    crashes = CoreSpec("crashes", "installed", "crashes", {"frames": [3]})
    job = make_job("good", crashes, "deaf", "third", time_limit_s=1.5)
    alone = make_job("good", "third", out_dir=job.out_dir.parent / "alone")
    (table,) = score_jobs([job], executor=ProcessExecutor(2))
    (undisturbed,) = score_jobs([alone], executor=ProcessExecutor(1))
    found = {str(core): rows for core, rows in table.groupby("core")}
    assert found["crashes"]["status"].tolist() == ["ok", "ok", "ok", "error", "ok"]
    assert found["deaf"]["status"].tolist() == ["ok", "timeout", "ok", "ok", "ok"]
    for core, rows in undisturbed.groupby("core"):
        same = found[str(core)].reset_index(drop=True)
        pd.testing.assert_frame_equal(same, rows.reset_index(drop=True), check_exact=True)
    reasons = load_results(job.out_dir).reasons
    assert reasons["crashes", 0, 3] == "the process that ran it was ended by SIGSEGV"
    assert reasons["deaf", 0, 1] == "no answer within 1.5 s, and its process had to be ended"


def test_workers_that_die_one_after_the_other_end_the_scoring(
    make_job: MakeJob, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workers_module, "MOST_DEATHS", 2)
    units = Scoring(make_job("dies"), 0, announce=print).units()[:1]
    with pytest.raises(ScoreError, match=r"2 worker processes died one after .* exit code 9: out"):
        list(ProcessExecutor(2).run(units))
    assert not multiprocessing.active_children()


def test_what_is_left_after_a_crash_begins_with_what_was_known(make_job: MakeJob) -> None:
    prior = PriorSettings(source="previous", position_sigma_m=0.1, rotation_sigma_deg=1.0)
    scoring = Scoring(make_job("follows", "good"), 0, announce=print)
    unit = Unit(scoring.job.dataset_path, scoring.cores, (0, 1, 2, 3, 4), prior=prior)
    whole = [*score_unit(replace(unit, cores=unit.cores[:1])).answers]
    crash = failed_unit(replace(unit, cores=unit.cores[:1], shots=(2,)), "it crashed").answers
    mine, others = rest_of(unit, Asked(0, 2), [*whole[:2], *crash])
    assert (mine.cores, mine.shots) == (unit.cores[:1], (3, 4))
    assert (others.cores, others.shots, others.last) == (unit.cores[1:], unit.shots, b"")
    # It goes on from the answer to shot 1, less certain by two images.
    first = score_unit(mine).answers[0].result
    assert first.trs_from_cam is not None
    assert first.covariance is not None
    assert first.trs_from_cam.translation[0] == pytest.approx(2.0)
    assert first.covariance[5, 5] == pytest.approx(3 * 0.1**2)
    assert rest_of(others, Asked(0, 4), ()) == ()


def test_a_unit_gives_an_answer_for_each_core_and_shot(
    make_job: MakeJob, fakes: ModuleType
) -> None:
    scoring = Scoring(make_job("good", "shift"), 3, announce=print)
    unit = Unit(scoring.job.dataset_path, scoring.cores, (1, 2), job=3)
    done, failed = score_unit(unit), failed_unit(unit, "the worker was lost")
    assert done.job == failed.job == 3
    for each in (done, failed):
        names = [(answer.core, answer.shot) for answer in each.answers]
        assert names == [("good", 1), ("good", 2), ("shift", 1), ("shift", 2)]
    assert {a.result.status for a in failed.answers} == {"error"}
    assert {a.result.reason for a in failed.answers} == {"the worker was lost"}


def test_the_number_of_workers_is_checked() -> None:
    with pytest.raises(ScoreError, match="workers is 0, must be 1 or more"):
        ProcessExecutor(0)
