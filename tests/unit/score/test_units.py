"""Only what is not known yet is computed: kept answers, priors, sequences, several jobs."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest

from tronlab.dataset import columns, schema
from tronlab.dataset.reader import Dataset
from tronlab.dataset.rewriter import rewritten
from tronlab.errors import ScoreError
from tronlab.nav.specs import CoreSpec
from tronlab.score.rescore import _phases, score_jobs
from tronlab.score.rescoring.job import ScoreJob, Scoring
from tronlab.score.rescoring.opening import ScoredCore
from tronlab.score.rescoring.prior import PriorSettings
from tronlab.score.rescoring.unit import Unit, UnitDone, score_unit
from tronlab.score.rescoring.workers import ProcessExecutor
from tronlab.score.results import load_results

MakeJob = Callable[..., ScoreJob]
PREVIOUS = PriorSettings(source="previous", position_sigma_m=0.1, rotation_sigma_deg=1.0)


class Counting(ProcessExecutor):
    """Counts the answers that are computed."""

    def __init__(self, stop_after: int | None = None) -> None:
        super().__init__(1)
        self.n_answers = 0
        self._stop_after = stop_after

    def run(self, units):
        for done in super().run(units):
            if self.n_answers == self._stop_after:
                raise KeyboardInterrupt
            self.n_answers += len(done.answers)
            yield done


def computed(*jobs: ScoreJob, said: list[str] | None = None) -> tuple[int, list[pd.DataFrame]]:
    executor = Counting()
    say = None if said is None else said.append
    tables = score_jobs(jobs, executor=executor, announce=say)
    return executor.n_answers, tables


def named(core: str, name: str = "", seed: int = 0, **settings: object) -> CoreSpec:
    return CoreSpec(name or core, "installed", core, settings, seed)


def test_nothing_is_computed_twice(make_job: MakeJob, tmp_path: Path) -> None:
    job = make_job("good", "third", cache_dir=tmp_path / "cache")
    n, (fresh,) = computed(job)
    assert n == 10
    said: list[str] = []
    # Three answers of "third" are errors, which may not come again.
    n, (again,) = computed(job, said=said)
    assert n == 3
    assert "7 of 10 answers are known from earlier scorings" in said
    pd.testing.assert_frame_equal(fresh, again, check_exact=True)
    other = replace(job, cores=(named("good", "alias"), named("good", "b", seed=1)))
    n, (table,) = computed(replace(other, out_dir=tmp_path / "other"))
    assert n == 5
    errors = {core: rows["position_error_m"].to_numpy() for core, rows in table.groupby("core")}
    np.testing.assert_array_equal(errors["alias"], fresh["position_error_m"][:5])
    assert np.abs(errors["b"] - errors["alias"]).min() > 0


def test_what_was_interrupted_goes_on_where_it_stopped(make_job: MakeJob, tmp_path: Path) -> None:
    job = make_job("good", named("good", "b", seed=4), cache_dir=tmp_path / "cache")
    with pytest.raises(KeyboardInterrupt, match=r"4 of 10 answers.*\nthe same command goes on"):
        score_jobs([job], executor=Counting(stop_after=4))
    progress: list[tuple[int, int]] = []
    executor = Counting()
    (table,) = score_jobs([job], executor=executor, progress=lambda *args: progress.append(args))
    assert executor.n_answers == 6
    assert progress == [(k, 6) for k in range(7)]
    _, (fresh,) = computed(replace(job, cache_dir=None, out_dir=tmp_path / "fresh"))
    pd.testing.assert_frame_equal(table, fresh, check_exact=True)


def test_matches_of_kept_answers_are_those_of_fresh_ones(make_job: MakeJob, tmp_path: Path) -> None:
    job = make_job("good", cache_dir=tmp_path / "cache")
    for out_dir in (tmp_path / "a", tmp_path / "b"):
        computed(replace(job, out_dir=out_dir))
    first, again = ([*load_results(tmp_path / name).answers()] for name in "ab")
    assert len(first) == 5
    for a, b in zip(first, again, strict=True):
        assert (a.core, a.seed, a.shot_id, a.database) == (b.core, b.seed, b.shot_id, b.database)
        np.testing.assert_array_equal(a.uv_inliers, [[1, 2], [3, 4]])
        np.testing.assert_array_equal(b.landmark_inliers, [5, 7])


def test_a_recomputed_truth_costs_nothing(make_job: MakeJob, tmp_path: Path) -> None:
    job = make_job("good", cache_dir=tmp_path / "cache")
    _, (before,) = computed(job)
    copy = tmp_path / "recomputed.h5"
    with Dataset(job.dataset_path) as dataset, rewritten(job.dataset_path, copy) as rewriter:
        shot = dataset.shot(2)
        truth = replace(shot.truth, range_los_m=shot.truth.range_los_m * 2)
        rewriter.write_truth(2, shot, truth, shot.mask)
    n, (after,) = computed(replace(job, dataset_path=copy, out_dir=tmp_path / "after"))
    assert n == 0
    ratio = after["position_error_pct_los"] / before["position_error_pct_los"]
    np.testing.assert_allclose(ratio, [1, 1, 0.5, 1, 1])


def test_a_core_with_state_sees_the_whole_dataset_in_order(
    make_job: MakeJob, tmp_path: Path
) -> None:
    log = tmp_path / "log"
    core = named("counting", log=str(log), stumbles_at=4)
    job = make_job(core, cache_dir=tmp_path / "cache")
    _, (table,) = computed(job)
    assert log.read_text().split() == list("01234")
    assert table["status"].tolist() == ["ok", "ok", "ok", "error", "ok"]
    # Its answers after the error are not kept, and those before are no use without the state.
    n, (again,) = computed(job)
    assert n == 5
    pd.testing.assert_frame_equal(table, again, check_exact=True)
    sound = make_job(named("counting", "sound"), cache_dir=tmp_path / "cache")
    assert [computed(sound)[0] for _ in range(2)] == [5, 0]


def test_the_last_answer_is_the_next_prior_also_after_an_interruption(
    make_job: MakeJob, tmp_path: Path
) -> None:
    log = tmp_path / "log"
    core = named("follows", log=str(log))
    job = make_job(core, prior=PREVIOUS, cache_dir=tmp_path / "cache")
    with pytest.raises(KeyboardInterrupt):
        score_jobs([job], executor=Counting(stop_after=2))
    log.unlink()
    n, (table,) = computed(job)
    assert n == 3
    assert log.read_text().split() == list("234")
    with Dataset(job.dataset_path) as dataset:
        truth_m = np.array([dataset.truth(i).trs_from_cam.translation[0] for i in range(5)])
    # The origin first, then a metre further each time: it was offered its own answers.
    np.testing.assert_allclose(truth_m - table["error_trs_x_m"], np.arange(5), atol=1e-12)
    sigma_m = np.sqrt(3 * 0.1**2 * np.arange(1, 5))
    np.testing.assert_allclose(table["sigma_core_m"][1:], sigma_m)


def test_after_an_error_the_rest_of_a_chain_is_not_kept(make_job: MakeJob, tmp_path: Path) -> None:
    core = named("follows", fails_at=2)
    job = make_job(core, prior=PREVIOUS, cache_dir=tmp_path / "cache")
    assert [computed(job)[0] for _ in range(2)] == [5, 3]


def test_a_prior_from_the_truth_is_the_truth_with_an_error(make_job: MakeJob) -> None:
    prior = PriorSettings(source="truth", position_sigma_m=0.1, rotation_sigma_deg=1.0)
    _, (table,) = computed(make_job("follows", prior=prior))
    # A metre off along x, as the core moves it, and the drawn error.
    np.testing.assert_allclose(table["error_trs_x_m"], -1.0, atol=0.5)
    assert 0.001 < table["error_trs_y_m"].abs().max() < 0.5


def test_jobs_are_written_as_each_is_done(make_job: MakeJob, tmp_path: Path) -> None:
    jobs = [make_job("good", out_dir=tmp_path / name) for name in "ab"]
    with pytest.raises(KeyboardInterrupt, match=r"^interrupted: 2 of 5 answers .* are there"):
        score_jobs(jobs, executor=Counting(stop_after=7))
    assert load_results(tmp_path / "a").cores == ("good",)
    assert len(pd.read_csv(tmp_path / "b" / "scores.partial.csv")) == 2
    with pytest.raises(ScoreError, match=r"cannot go into the same folder"):
        score_jobs([jobs[0], jobs[0]], executor=ProcessExecutor(1))


def test_seeds_are_repeats_of_one_name(make_job: MakeJob) -> None:
    job = make_job(*(named("good", seed=seed) for seed in (2, 0, 1)))
    _, (table,) = computed(job)
    assert table["seed"].tolist() == [2] * 5 + [0] * 5 + [1] * 5
    results = load_results(job.out_dir)
    assert results.definitions["good"]["seeds"] == [2, 0, 1]
    np.testing.assert_array_equal(results.uv_inliers("good", 3, seed=2), [[1, 2], [3, 4]])
    assert results.uv_inliers("good", 3, seed=7).shape == (0, 2)
    with pytest.raises(ScoreError, match="two navigation cores are called 'good' and have the se"):
        computed(make_job("good", "good"))
    with pytest.raises(ScoreError, match="no navigation core to score"):
        computed(make_job())


def test_cores_of_one_image_are_scored_together_and_others_alone(make_job: MakeJob) -> None:
    scoring = Scoring(make_job("good", "third"), 0, announce=print)
    assert [(len(unit.cores), unit.shots) for unit in scoring.units()] == [
        (2, (i,)) for i in range(5)
    ]
    foreign = [
        replace(core, is_built_in=False, spec=replace(core.spec, kind=kind))
        for core, kind in zip(scoring.cores, ("command", "tcp"), strict=True)
    ]
    units = _units_of(scoring, foreign)
    assert [(unit.cores[0].spec.kind, unit.shots) for unit in units] == [
        ("tcp", (0, 1, 2, 3, 4)),
        *(("command", (i,)) for i in range(5)),
    ]
    # Whoever listens on a socket serves one at a time.
    assert [len(phase) for phase in _phases([*units, *units])] == [11, 1]


def _units_of(scoring: Scoring, cores: list[ScoredCore]) -> list[Unit]:
    for answers, core in zip(scoring._answers.values(), cores, strict=True):
        answers.core = core
    return scoring.units()


def test_an_executor_may_give_whole_units(make_job: MakeJob) -> None:
    class Whole(ProcessExecutor):
        def run(self, units):
            parts = [*super().run(units)]
            yield UnitDone(0, tuple(answer for part in parts for answer in part.answers))

    (table,) = score_jobs([make_job("good", "third")], executor=Whole(1))
    assert len(table) == 10


def test_a_damaged_image_costs_one_shot_only(make_job: MakeJob) -> None:
    job = make_job("good")
    with h5py.File(job.dataset_path, "r+") as file:
        file["entry/data/image"][2, 0, 0] ^= 1
    _, (table,) = computed(job)
    assert table["status"].tolist() == ["ok", "ok", "error", "ok", "ok"]
    assert "damaged" in load_results(job.out_dir).reasons["good", 0, 2]


def test_a_dataset_without_images_is_an_error_unless_its_answers_are_kept(
    make_job: MakeJob, segmented_dataset: Path, tmp_path: Path
) -> None:
    job = replace(make_job("good"), dataset_path=segmented_dataset, out_dir=tmp_path / "out")
    kept = replace(job, cache_dir=tmp_path / "cache")
    _, (before,) = computed(kept)
    shutil.rmtree(segmented_dataset.with_suffix(".images"))
    n, (again,) = computed(kept)
    assert n == 0
    pd.testing.assert_frame_equal(before, again, check_exact=True)
    with pytest.raises(ScoreError, match=r"none of its 5 images can be read: .*dataset\.images"):
        computed(job)


def test_a_dataset_that_became_another_is_opened_anew(make_job: MakeJob) -> None:
    job = make_job("good")
    unit = Scoring(job, 0, announce=print).units()[0]
    before = score_unit(unit)
    other = Path(shutil.copy(job.dataset_path, job.dataset_path.with_name("other.h5")))
    with h5py.File(other, "r+") as file:
        file["entry/data/image"][0] = 255
        file[schema.IMAGE_CRC32][0] = columns.checksum([file["entry/data/image"][0]])
    other.replace(job.dataset_path)
    anew = Scoring(job, 0, announce=print).units()[0]
    assert anew.dataset_key != unit.dataset_key
    assert score_unit(anew) != before
