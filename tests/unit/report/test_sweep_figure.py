"""Table and picture of a sweep, from scores whose means are known."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tronlab.nav.specs import CoreSpec
from tronlab.report.sweep import save_sweep, sweep_figure, variant_table
from tronlab.score.sweep import Value, Variant

ERRORS = {"a@g=1,m=x": 0.3, "a@g=1,m=y": 0.4, "a@g=100,m=x": 0.1, "a@g=100,m=y": 0.2, "base": 0.25}


def variant(name: str, **values: Value) -> Variant:
    core, _, _ = name.partition("@")
    return Variant(CoreSpec(name, "installed", core), core, values)


VARIANTS = [
    variant("a@g=1,m=x", g=1, m="x"),
    variant("a@g=1,m=y", g=1, m="y"),
    variant("a@g=100,m=x", g=100, m="x"),
    variant("a@g=100,m=y", g=100, m="y"),
]


@pytest.fixture
def scores() -> pd.DataFrame:
    rows = [
        {
            "core": name,
            "shot_id": shot_id,
            "status": "ok" if shot_id else "no_pose",
            "position_error_pct_los": mean + (shot_id - 2) * 0.01 if shot_id else np.nan,
            "rotation_error_deg": 0.1 * mean if shot_id else np.nan,
            "time_detect_s": 0.1,
            "time_match_s": 0.02,
            "time_pose_s": 0.003,
        }
        for name, mean in ERRORS.items()
        for shot_id in range(4)
    ]
    return pd.DataFrame(rows)


def test_the_best_variant_comes_first_with_its_settings(scores: pd.DataFrame) -> None:
    table = variant_table(scores, VARIANTS)
    assert table["variant"].tolist() == sorted(ERRORS, key=lambda name: ERRORS[name])
    assert table["core"].tolist() == ["a", "a", "base", "a", "a"]
    assert table["g"].tolist()[:2] == [100, 100]
    assert np.isnan(table["g"][2])
    np.testing.assert_allclose(table["position_error_mean_pct_los"], sorted(ERRORS.values()))
    assert set(table["n_rows"]) == {4}
    assert set(table["n_ok"]) == {3}
    np.testing.assert_allclose(table["time_mean_s"], 0.123)


def test_a_variant_without_any_pose_comes_last(scores: pd.DataFrame) -> None:
    is_failed = scores["core"] == "a@g=100,m=x"
    scores.loc[is_failed, "status"] = "error"
    scores.loc[is_failed, "position_error_pct_los"] = np.nan
    table = variant_table(scores, VARIANTS)
    assert table["variant"].iloc[-1] == "a@g=100,m=x"
    assert sweep_figure(table, VARIANTS).axes


def test_lines_join_what_differs_in_one_setting(scores: pd.DataFrame, tmp_path: Path) -> None:
    save_sweep(scores, VARIANTS, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"sweep.csv", "sweep.png", "sweep.pdf"}
    table = pd.read_csv(tmp_path / "sweep.csv")
    upper_g, _, lower_g, lower_m = sweep_figure(table, VARIANTS).axes
    assert [axes.get_xlabel() for axes in (lower_g, lower_m)] == ["g", "m"]
    assert upper_g.get_xscale() == "log"
    assert [tick.get_text() for tick in lower_m.get_xticklabels()] == ["x", "y"]
    drawn = {
        tuple(map(float, line.get_ydata())): tuple(map(float, line.get_xdata()))
        for line in upper_g.get_lines()
        if line.get_label() == "a"
    }
    assert list(drawn.values()) == [(1, 100), (1, 100)]
    np.testing.assert_allclose(sorted(drawn), [(0.3, 0.1), (0.4, 0.2)])
    labels = {str(line.get_label()) for line in upper_g.get_lines()}
    assert labels == {"a", "base", "least mean error: a@g=100,m=x"}


def test_a_sweep_of_nothing_says_so(scores: pd.DataFrame) -> None:
    only = [variant("base")]
    table = variant_table(scores[scores["core"] == "base"], only)
    (axes,) = sweep_figure(table, only).axes
    assert axes.texts[0].get_text() == "nothing was swept"
