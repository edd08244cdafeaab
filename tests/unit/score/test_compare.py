"""Paired comparison: differences, tests and verdicts against theory and scipy."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from tronlab.errors import ScoreError
from tronlab.score.evaluation.compare import (
    Differences,
    Tolerance,
    _centres,
    compare,
    holm,
    parse_tolerance,
    regressions,
)
from tronlab.score.evaluation.pairing import Run, RunPair, left_out, pair_runs
from tronlab.score.results import ScoreResults

ERROR = "position_error_pct_los"


def rows_of(errors, *, core="akaze", seed=0, first_id=0):
    """One answer a shot; NaN is a shot without a pose."""
    errors = np.asarray(errors, dtype=np.float64)
    n = errors.size
    return pd.DataFrame(
        {
            "core": core,
            "shot_id": np.arange(n) + first_id,
            "seed": seed,
            "status": np.where(np.isnan(errors), "no_pose", "ok"),
            "range_los_m": np.linspace(4.0, 1.0, n),
            "usable_fraction": 0.8,
            "sigma_truth_m": 1e-4,
            "truth_crc": 7,
            ERROR: errors,
            "time_pose_s": 0.01,
        }
    )


def one(base, other, metric=ERROR):
    pair = RunPair(Run("a", "akaze", base), Run("b", "akaze", other))
    return compare([pair], [metric])[0]


def results_of(folder, *tables):
    scores = pd.concat(tables)
    cores = tuple(scores["core"].unique())
    return ScoreResults(Path(folder), scores, {}, Path("dataset.h5"), cores, {}, "", {}, {})


def test_statistics_of_pairs_are_those_of_scipy(rng):
    base = rng.lognormal(size=60)
    other = base * rng.lognormal(0.1, 0.3, 60)
    other[:7] = base[:7]
    found = one(rows_of(base), rows_of(other))
    differences = other - base
    assert found.mean.value == pytest.approx(differences.mean())
    assert found.median.value == pytest.approx(np.median(other) - np.median(base))
    assert found.p.wilcoxon == pytest.approx(stats.wilcoxon(differences[7:]).pvalue)
    counts = int((differences < 0).sum()), int((differences > 0).sum())
    assert (found.n_better, found.n_worse, found.n_same) == (*counts, 7)
    assert found.p.sign == pytest.approx(stats.binomtest(counts[0], sum(counts)).pvalue)


def test_the_interval_of_the_difference_holds_as_often_as_stated():
    rng, n_trials = np.random.default_rng(8), 200
    n_held = 0
    for _ in range(n_trials):
        base = rng.lognormal(size=50)
        pairs = Differences(np.arange(50), base, base, base + rng.exponential(size=50))
        interval = _centres(pairs)[0].interval
        n_held += interval.low <= 1.0 <= interval.high
    low, high = stats.binom.ppf([1e-4, 1.0 - 1e-4], n_trials, 0.935)
    assert low <= n_held <= high


def test_pairing_sees_what_the_scatter_of_shots_hides(rng):
    base = rng.lognormal(0.0, 1.5, 60)
    found = one(rows_of(base), rows_of(base + 0.01))
    assert found.mean.interval.low == pytest.approx(0.01)
    assert regressions(found, Tolerance(0.009))
    assert not regressions(found, Tolerance(0.011))


def test_order_of_rows_does_not_matter_and_the_same_is_no_difference(rng):
    base = rows_of(rng.lognormal(size=30))
    found = one(base, base.iloc[::-1])
    assert (found.n_same, found.p.wilcoxon, found.p.sign, found.p.solved) == (30, 1.0, 1.0, 1.0)
    assert (found.mean.interval.low, found.mean.interval.high) == (0.0, 0.0)
    assert not regressions(found, Tolerance())


def test_worse_is_the_whole_interval_above_the_tolerance(rng):
    base = rng.lognormal(size=60)
    worse = one(rows_of(base), rows_of(1.2 * base))
    lines = regressions(worse, parse_tolerance("5%"))
    assert [line.split()[0] for line in lines] == ["mean", "median"]
    assert f"allowed is {0.05 * base.mean():.3g}" in lines[0]
    assert not regressions(worse, parse_tolerance("25%"))
    assert not regressions(one(rows_of(1.2 * base), rows_of(base)), Tolerance())
    # Larger, but not for sure: one gross error moves the mean alone.
    gross = base.copy()
    gross[3] += 30.0
    assert not regressions(one(rows_of(base), rows_of(gross)), Tolerance())


def test_fewer_poses_are_worse_whatever_the_errors():
    base, other = np.ones(12), np.full(12, 0.5)
    other[:2] = np.nan
    base[11] = np.nan
    found = one(rows_of(base), rows_of(other))
    solved = found.solved
    assert (solved.n_base, solved.n_other, solved.n_base_only, solved.n_other_only) == (
        11,
        10,
        2,
        1,
    )
    assert found.p.solved == pytest.approx(stats.binomtest(2, 3).pvalue)
    assert len(found.differences.base) == 9
    assert regressions(found, Tolerance()) == ["poses: 10 of 12, were 11"]
    assert not regressions(one(rows_of(other), rows_of(base)), Tolerance(1.0))


def test_repeats_of_a_shot_count_once(rng):
    base, other = rng.lognormal(size=(2, 40))
    once = one(rows_of(base), rows_of(other))
    twice = one(
        pd.concat([rows_of(base), rows_of(base, seed=1)]),
        pd.concat([rows_of(other), rows_of(other, seed=1), rows_of(other, seed=9)]),
    )
    assert twice.p == once.p
    assert twice.mean == once.mean
    assert (twice.solved.n_shots, twice.solved.n_answers, twice.n_left_out) == (40, 80, 40)
    with pytest.raises(ScoreError, match=r"no seed in common: \[0\] and \[1\]"):
        one(rows_of(base), rows_of(other, seed=1))


def test_runs_without_a_shot_in_common_and_with_few():
    nothing = one(rows_of([1.0, np.nan]), rows_of([np.nan, 1.0]))
    assert np.isnan(nothing.mean.value)
    assert np.isnan(nothing.p.wilcoxon)
    assert not regressions(nothing, Tolerance())
    few = one(rows_of([1.0, 1.0]), rows_of([2.0, 2.0]))
    assert (few.mean.value, few.mean.interval) == (1.0, None)


def test_holm_by_hand():
    # Three tests: 0.01 * 3, then 0.02 * 2, then 0.04 * 1, but never less than the one before.
    np.testing.assert_allclose(holm([0.04, 0.01, 0.02]), [0.04, 0.03, 0.04])
    np.testing.assert_allclose(holm([0.5, np.nan, 0.6]), [1.0, np.nan, 1.0])
    assert holm([]).size == 0


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=8))
def test_holm_lies_between_no_correction_and_bonferroni(p):
    adjusted = holm(p)
    assert (adjusted >= np.array(p)).all()
    assert (adjusted <= np.minimum(len(p) * np.array(p), 1.0)).all()
    assert (np.diff(adjusted[np.argsort(p, kind="stable")]) >= 0.0).all()


def test_probabilities_are_adjusted_over_the_pairs_of_one_metric(rng):
    base = rows_of(rng.lognormal(size=30))
    others = [rows_of(base[ERROR] * factor, core=str(factor)) for factor in (1.1, 1.2, 1.3)]
    pairs = [RunPair(Run("a", "akaze", base), Run("a", "x", other)) for other in others]
    found = compare(pairs, [ERROR, "time_pose_s"])
    assert [c.metric for c in found] == [ERROR] * 3 + ["time_pose_s"] * 3
    assert [c.p_holm.sign for c in found[:3]] == pytest.approx([3 * 2.0**-29] * 3)
    assert [c.p_holm.sign for c in found[3:]] == [1.0] * 3


def test_tolerances_and_metrics_are_read_or_refused():
    assert parse_tolerance("0.02").of(9.0) == 0.02
    assert parse_tolerance(" 5 %").of(2.0) == pytest.approx(0.1)
    for odd in ("-1", "nan", "five", "%", "inf%"):
        with pytest.raises(ScoreError, match=f"tolerance '{odd}'"):
            parse_tolerance(odd)
    with pytest.raises(ScoreError, match="metric 'nees': cannot be compared"):
        one(rows_of([1.0]), rows_of([1.0]), "nees")


def names(pairs):
    return [(p.base.folder, p.base.core, p.other.folder, p.other.core) for p in pairs]


def test_what_is_compared_with_what():
    two = [rows_of([1.0, 2.0]), rows_of([1.0, 2.0], core="brisk")]
    before, after, alone = (
        results_of("before", *two), results_of("after", *two), results_of("alone", two[1])
    )  # fmt: skip
    assert names(pair_runs([before])) == [("before", "akaze", "before", "brisk")]
    assert names(pair_runs([before], ["brisk", "akaze"])) == [
        ("before", "brisk", "before", "akaze")
    ]
    assert names(pair_runs([before, after, alone])) == [
        ("before", "akaze", "after", "akaze"),
        ("before", "brisk", "after", "brisk"),
        ("before", "brisk", "alone", "brisk"),
    ]
    assert names(pair_runs([before, after], ["brisk"])) == [("before", "brisk", "after", "brisk")]
    only = results_of("only", two[0])
    assert names(pair_runs([alone, only], ["akaze", "brisk"])) == [
        ("only", "akaze", "alone", "brisk")
    ]
    assert left_out([before, after], pair_runs([before, after])) == []
    lost = pair_runs([before, only, alone])
    assert left_out([before, only, alone], lost) == []
    assert left_out([before, only], lost[:1]) == ["brisk of before"]
    assert left_out([before, only], lost[:1], ["akaze"]) == []
    with pytest.raises(ScoreError, match="nothing to compare"):
        pair_runs([before], ["akaze", "akaze"])
    with pytest.raises(ScoreError, match="no scores of mine; there are: akaze, brisk"):
        pair_runs([before, after], ["mine"])
    for folders in ([alone], [alone, only]):
        with pytest.raises(ScoreError, match="nothing to compare"):
            pair_runs(folders)


def test_other_shots_or_another_truth_are_refused():
    ours = results_of("a", rows_of([1.0, 2.0, 3.0]))
    with pytest.raises(ScoreError, match=r"shot 2 is in a only \(3 and 2 shots\)"):
        pair_runs([ours, results_of("b", rows_of([1.0, 2.0]))])
    other = rows_of([1.0, 2.0, 3.0])
    other.loc[1, "range_los_m"] += 1e-7
    with pytest.raises(ScoreError, match=r"the truth differs: range_los_m of shot 1 is 2\.5 and"):
        pair_runs([ours, results_of("b", other)])
    turned = rows_of([1.0, 2.0, 3.0])
    turned.loc[2, "truth_crc"] = 8
    with pytest.raises(
        ScoreError, match="the truth differs: shot 2 has another pose; the datasets"
    ):
        pair_runs([ours, results_of("b", turned)])
    old = rows_of([1.0, 2.0, 3.0]).assign(sigma_truth_m=np.nan, truth_crc=0)
    assert pair_runs([ours, results_of("b", old)])
