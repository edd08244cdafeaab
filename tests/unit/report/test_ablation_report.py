"""Pictures and sentences of ablation and limits say what their tables say, and no more."""

import numpy as np
import pandas as pd
import pytest

from tronlab.report.study.ablation_charts import cost_chart, dataset_costs_chart
from tronlab.report.study.limits_charts import limits_chart, shares_chart
from tronlab.report.study.limits_text import cost_sentences, limit_sentences
from tronlab.score.evaluation.ablation import PARTS

CORE = "akaze-refined"


def make_costs(**costs: tuple[float, float, float]) -> pd.DataFrame:
    """A row each for all, none and every source: cost with its limits."""
    whole = {"source": "", "title": "", "kind": "", "core": CORE, "dataset": "together"}
    nothing = {"cost_pct_los": np.nan, "cost_low": np.nan, "cost_high": np.nan}
    rows = [
        {**whole, **nothing, "variant": "all", "mean_pct_los": 0.08},
        {**whole, **nothing, "variant": "none", "mean_pct_los": 0.02},
    ]
    for name, (value, low, high) in costs.items():
        limits = {"cost_pct_los": value, "cost_low": low, "cost_high": high}
        own = {"source": name, "title": f"the {name}", "kind": "light", "mean_pct_los": 0.05}
        rows.append({**whole, **limits, **own, "variant": f"without_{name}"})
    return pd.DataFrame(rows)


def make_shares(largest: str = "", *, share: float = 0.6, low: float = 0.5) -> pd.DataFrame:
    others = (1.0 - share) / (len(PARTS) - 1)
    return pd.DataFrame(
        {
            "dataset": "together",
            "core": CORE,
            "n": 40,
            "part": PARTS,
            "share": [share if part == "terrain" else others for part in PARTS],
            "low": [low if part == "terrain" else others - 0.01 for part in PARTS],
            "high": [share + 0.1 if part == "terrain" else others + 0.01 for part in PARTS],
            "is_largest": [part == largest for part in PARTS],
        }
    )


def make_limits(**changes: float | str) -> pd.DataFrame:
    row: dict[str, float | str] = {
        "dataset": "dataset_1_nominal",
        "core": CORE,
        "n": 12,
        "n_solved": 12,
        "median_pct_los": 0.04,
        "mean_pct_los": 0.05,
        "bound_pct_los": 0.02,
        "truth_sigma_pct_los": 0.005,
        "error_over_bound_q25": 1.0,
        "error_over_bound_median": 2.0,
        "error_over_bound_q75": 3.0,
        "floor_pct_los": 0.021,
        "error_over_floor_median": 1.9,
        "error_over_truth_median": 8.0,
        "bound_rho": 0.1,
        "none_over_bound": np.nan,
        "largest": "",
        **{f"share_{part}": np.nan for part in PARTS},
        **changes,
    }
    return pd.DataFrame([row])


def test_only_costs_that_are_certain_are_named_the_dearest_first() -> None:
    costs = make_costs(
        lamp=(0.01, 0.005, 0.02),
        noise=(0.02, -0.01, 0.05),
        scan=(0.03, 0.02, 0.04),
        blur=(-0.004, -0.006, -0.002),
    )

    (text,) = cost_sentences(costs)

    assert "0.08 % of LOS with every source, 0.02 % without any" in text
    assert text.index("the scan +0.03 [+0.02, +0.04] %") < text.index("the lamp +0.01")
    assert "Without it the error is larger: the blur -0.004" in text
    assert "the noise" not in text
    assert "1 of 4 sources cannot be told from zero" in text


def test_it_is_said_if_no_cost_can_be_told_from_zero() -> None:
    (text,) = cost_sentences(make_costs(lamp=(0.01, -0.005, 0.02)))

    assert text.endswith("cannot be told from zero with these shots.")


def test_a_limit_is_named_only_if_it_is_certain() -> None:
    certain, *_ = limit_sentences(make_limits(), make_shares("terrain"))
    uncertain, *_ = limit_sentences(make_limits(), make_shares())
    odd, *_ = limit_sentences(make_limits(), make_shares("rest"))

    assert "the terrain model limits its typical error, with 95 % confidence" in certain
    assert "terrain model 60 [50, 70] %" in certain
    assert "not conclusive" in uncertain
    assert "40 shots" in uncertain
    assert "not conclusive" in odd
    assert "does not add up" in odd


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"error_over_bound_median": 0.9}, "the view limits it"),
        ({"error_over_truth_median": 1.2}, "the truth is not good enough"),
        ({"bound_rho": 0.8}, r"rise together (rank correlation +0.80)"),
        ({"none_over_bound": 1.6}, "without any source of error it is 1.6 times the bound"),
        ({"share_light": 0.7, "largest": "light"}, "largest part is, certainly: light 70 %"),
        ({"share_estimator": 5.0, "share_rest": -4.0}, "its parts do not add up"),
        ({}, "the ablation says nothing of this dataset"),
        ({"n_solved": 0, "median_pct_los": np.nan}, "no shot was solved"),
    ],
)
def test_each_finding_of_a_dataset_is_said(changes: dict[str, float | str], words: str) -> None:
    limits = make_limits(**changes)

    of_dataset = limit_sentences(limits, make_shares())[1]

    assert words in of_dataset
    if changes:
        assert words not in limit_sentences(make_limits(), make_shares())[1]


def test_uncertain_costs_are_pale_and_every_source_has_a_bar() -> None:
    costs = make_costs(lamp=(0.01, 0.005, 0.02), noise=(0.02, -0.01, 0.05))

    (axes,) = cost_chart(costs).axes

    assert [label.get_text() for label in axes.get_yticklabels()] == ["the lamp", "the noise"]
    widths = [patch.get_width() for patch in axes.patches]
    assert widths == pytest.approx([0.01, 0.02])
    assert [patch.get_alpha() for patch in axes.patches] == [1.0, 0.35]


def test_stacked_shares_reach_as_far_as_their_sum() -> None:
    (axes,) = shares_chart(make_shares(share=0.9)).axes

    assert sum(patch.get_width() for patch in axes.patches) == pytest.approx(100.0)


def test_limits_chart_has_a_row_a_core_and_dataset() -> None:
    limits = pd.concat([make_limits(), make_limits(dataset="dataset_0")])

    (axes,) = limits_chart(limits).axes

    names = [label.get_text() for label in axes.get_yticklabels()]
    assert names == ["dataset_1_nominal", "dataset_0"]


def test_what_was_not_looked_at_leaves_an_empty_panel_that_says_so() -> None:
    unknown = make_shares().assign(share=np.nan)

    figures = {
        "single kinds": shares_chart(unknown),
        "nothing was scored": limits_chart(make_limits()[:0]),
        "no source was looked at": cost_chart(make_costs()),
        "no source": dataset_costs_chart(make_costs(), CORE),
    }

    for words, figure in figures.items():
        assert any(words in text.get_text() for text in figure.axes[0].texts)
