"""Costs and shares of sources of error, against errors whose size is known."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tronlab.errors import ScoreError
from tronlab.score.evaluation.ablation import (
    ALL,
    EFFICIENT_MEDIAN,
    NONE,
    TOGETHER,
    Kind,
    Scores,
    Source,
    ablation_table,
    error_shares,
    only,
    shares_table,
    without,
)
from tronlab.score.evaluation.limits import limits_table

SIGMA_M: Mapping[str, float] = {
    "detail": 2e-3,
    "registration": 1e-3,
    "lamp": 1e-3,
    "noise": 5e-4,
    "frame": 1e-3,
}
SOURCES = (
    Source("detail", "terrain finer than its model", "terrain"),
    Source("registration", "registration", "terrain"),
    Source("lamp", "place of the lamp", "light"),
    Source("noise", "noise", "camera"),
    Source("frame", "frame", "truth"),
)
FLOOR_M = 1e-3
RANGE_M = 10.0


def make_scores(n: int, *, datasets: Sequence[str] = ("dataset_0",), lose: float = 1.0) -> Scores:
    """Errors in two directions, each source's own; ``lose``: error over what the bound allows."""
    rng = np.random.default_rng(1)
    every = [source.name for source in SOURCES]
    variants = {ALL: every, NONE: []}
    variants |= {without(s): [other for other in every if other != s] for s in every}
    for kind in ("terrain", "light", "camera", "truth"):
        variants[only(kind)] = [s.name for s in SOURCES if s.kind == kind]
    scores: dict[str, dict[str, pd.DataFrame]] = {}
    for dataset in datasets:
        drawn = {name: SIGMA_M[name] * rng.standard_normal((n, 2)) for name in every}
        floor = FLOOR_M * rng.standard_normal((n, 2))
        for variant, on in variants.items():
            error_m = np.linalg.norm(floor + sum((drawn[s] for s in on), np.zeros(2)), axis=1)
            scores.setdefault(variant, {})[dataset] = make_rows(error_m, lose=lose)
    return scores


def make_rows(error_m: np.ndarray, *, lose: float = 1.0) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "core": "akaze-refined",
            "shot_id": np.arange(len(error_m)),
            "seed": 0,
            "status": "ok",
            "range_los_m": RANGE_M,
            "position_error_m": error_m,
            "position_error_pct_los": 100.0 * error_m / RANGE_M,
            "bound_m": np.sqrt(2.0) * FLOOR_M / lose,
            "sigma_truth_m": 1e-4,
        }
    )


def of_dataset(scores: Scores, dataset: str = "dataset_0") -> dict[str, pd.DataFrame]:
    return {variant: tables[dataset] for variant, tables in scores.items()}


def test_cost_is_the_drop_of_the_mean_that_theory_predicts() -> None:
    table = ablation_table(make_scores(200), SOURCES)

    rows = table[table["dataset"] == "dataset_0"].set_index("variant")
    variances = {name: sigma**2 for name, sigma in SIGMA_M.items()}
    whole = FLOOR_M**2 + sum(variances.values())
    for name, variance in variances.items():
        # The mean of a Rayleigh distribution is sqrt(pi / 2) sigma.
        drop = np.sqrt(np.pi / 2.0) * (np.sqrt(whole) - np.sqrt(whole - variance))
        row = rows.loc[without(name)]
        # 99.9 % of 95 % intervals of normal estimates, widened by half, hold what they are of.
        centre, half = (row["cost_low"] + row["cost_high"]) / 2, row["cost_high"] - row["cost_low"]
        assert abs(centre - 100.0 * drop / RANGE_M) < 0.85 * half
        assert row["cost_low"] < row["cost_pct_los"] < row["cost_high"]
        assert row["n_paired"] == 200
    assert rows.loc[without("detail"), "cost_low"] > 0.0
    assert np.isnan(rows.loc[ALL, "cost_pct_los"])
    assert rows.loc[NONE, "cost_pct_los"] > rows.loc[without("detail"), "cost_pct_los"]


def test_only_one_kind_costs_against_a_perfect_laboratory() -> None:
    scores = make_scores(50)

    rows = ablation_table(scores, SOURCES).set_index(["variant", "dataset"])

    means = {v: t["dataset_0"]["position_error_pct_los"].mean() for v, t in scores.items()}
    expected = means[only("light")] - means[NONE]
    assert rows.loc[(only("light"), "dataset_0"), "cost_pct_los"] == pytest.approx(expected)


def test_all_datasets_together_count_every_shot_once() -> None:
    scores = make_scores(20, datasets=("dataset_1_nominal", "dataset_2_nominal"))

    rows = ablation_table(scores, SOURCES).set_index(["variant", "dataset"])

    assert rows.loc[(without("lamp"), TOGETHER), "n"] == 40
    assert rows.loc[(without("lamp"), TOGETHER), "n_paired"] == 40
    means = [rows.loc[(ALL, d), "mean_pct_los"] for d in scores[ALL]]
    assert rows.loc[(ALL, TOGETHER), "mean_pct_los"] == pytest.approx(np.mean(means))


def test_shots_that_one_variant_did_not_solve_are_in_no_cost() -> None:
    scores = make_scores(30)
    lost = scores[without("lamp")]["dataset_0"]
    lost.loc[:9, ["status", "position_error_pct_los"]] = ["no_pose", np.nan]

    rows = ablation_table(scores, SOURCES).set_index(["variant", "dataset"])

    row = rows.loc[(without("lamp"), "dataset_0")]
    assert (row["n"], row["n_solved"], row["n_paired"]) == (30, 20, 20)
    whole = scores[ALL]["dataset_0"]["position_error_pct_los"][10:]
    expected = (whole - lost["position_error_pct_los"][10:]).mean()
    assert row["cost_pct_los"] == pytest.approx(expected)


def test_shots_taken_elsewhere_are_refused() -> None:
    scores = make_scores(10)
    scores[without("noise")]["dataset_0"].loc[3, "range_los_m"] = 7.0

    with pytest.raises(ScoreError, match=r"shot 3 is 7 m .* 'without_noise' and 10 m in 'all'"):
        ablation_table(scores, SOURCES)


def test_there_is_no_ablation_without_the_whole() -> None:
    with pytest.raises(ScoreError, match="variant 'all'"):
        ablation_table({NONE: make_scores(5)[NONE]}, SOURCES)


def test_shares_are_those_of_the_variances() -> None:
    shares = error_shares(of_dataset(make_scores(500)))

    whole = FLOOR_M**2 + sum(sigma**2 for sigma in SIGMA_M.values())
    variances = {"terrain": 5e-6, "light": 1e-6, "camera": 2.5e-7, "truth": 1e-6, "view": 1e-6}
    expected = {part: variance / whole for part, variance in variances.items()}
    for part, share in {**expected, "estimator": 0.0, "rest": 0.0}.items():
        assert shares.parts[part].value == pytest.approx(share, abs=0.12)
    assert shares.largest == "terrain"


def test_an_estimator_twice_as_bad_as_its_bound_is_told_from_the_view() -> None:
    shares = error_shares(of_dataset(make_scores(500, lose=2.0)))

    view, estimator = shares.parts["view"].value, shares.parts["estimator"].value
    assert estimator / (view + estimator) == pytest.approx(0.75, abs=0.05)


@settings(max_examples=20, deadline=None)
@given(n=st.integers(5, 40), seed=st.integers(0, 99))
def test_shares_add_up_to_one(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    variants = [ALL, NONE, *map(only, ("terrain", "light", "camera", "truth"))]

    shares = error_shares({v: make_rows(rng.uniform(1e-4, 1e-2, n)) for v in variants})

    assert sum(part.value for part in shares.parts.values()) == pytest.approx(1.0)


def test_largest_part_is_not_named_if_it_is_not_certain() -> None:
    assert error_shares(of_dataset(make_scores(8))).largest is None


def test_parts_that_do_not_add_up_are_the_largest_if_they_are() -> None:
    variants = of_dataset(make_scores(200))
    for kind in ("light", "camera", "truth"):
        variants[only(kind)] = variants[only("terrain")]

    assert error_shares(variants).largest == "rest"


@pytest.mark.parametrize("missing", [ALL, NONE])
def test_shares_are_not_known_without_both_ends(missing: str) -> None:
    variants = of_dataset(make_scores(10))
    del variants[missing]

    shares = error_shares(variants)

    assert all(np.isnan(part.value) for part in shares.parts.values())


def test_a_kind_that_was_not_looked_at_has_no_share() -> None:
    kind: Kind = "camera"
    scores = {v: tables for v, tables in make_scores(30).items() if v != only(kind)}

    table = shares_table(scores).set_index(["dataset", "part"])

    assert np.isnan(table.loc[("dataset_0", "camera"), "share"])
    assert np.isnan(table.loc[("dataset_0", "rest"), "share"])
    assert table.loc[("dataset_0", "terrain"), "share"] > 0.0


def test_limits_put_error_bound_truth_and_shares_side_by_side() -> None:
    scores = make_scores(400)
    unknown = make_rows(np.full(3, 5e-3))
    measured = {**scores[ALL], "dataset_2_nominal": unknown}

    table = limits_table(measured, scores[NONE], shares_table(scores)).set_index("dataset")

    row = table.loc["dataset_0"]
    assert row["none_over_bound"] == pytest.approx(EFFICIENT_MEDIAN, rel=0.1)
    errors = scores[ALL]["dataset_0"]["position_error_m"]
    assert row["error_over_bound_median"] == pytest.approx(
        errors.median() / (np.sqrt(2.0) * FLOOR_M)
    )
    floors_m = np.hypot(np.sqrt(2.0) * FLOOR_M, scores[ALL]["dataset_0"]["sigma_truth_m"])
    assert row["error_over_floor_median"] == pytest.approx((errors / floors_m).median())
    assert row["truth_sigma_pct_los"] == pytest.approx(1e-3)
    assert row["largest"] == "terrain"
    other = table.loc["dataset_2_nominal"]
    assert other["median_pct_los"] == pytest.approx(0.05)
    assert np.isnan(other["share_terrain"])
    assert not other["largest"]


def test_rank_correlation_of_error_and_bound_is_spearmans() -> None:
    from scipy.stats import spearmanr

    rng = np.random.default_rng(2)
    rows = make_rows(rng.uniform(1e-3, 2e-3, 50)).assign(bound_m=rng.uniform(1e-3, 2e-3, 50))
    shares = pd.DataFrame(columns=["dataset", "core", "part", "share", "is_largest"])

    found = limits_table({"dataset_0": rows}, {}, shares)["bound_rho"][0]

    assert found == pytest.approx(spearmanr(rows["position_error_m"], rows["bound_m"]).statistic)
