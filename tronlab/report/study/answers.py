"""The paper's open questions answered in sentences, with the numbers of a study's tables.

A sentence says only what its interval holds: one that includes zero shows no difference.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pandas as pd

from tronlab.report.paper import DATASETS, PAPER_CORES
from tronlab.report.study.charts import correlation_text, drawn_selection, probability_text
from tronlab.report.study.results import select
from tronlab.report.study.tables import METRIC, Scores
from tronlab.report.tables import by_core
from tronlab.score.evaluation.compare import Comparison
from tronlab.score.evaluation.resampling import Estimate
from tronlab.score.evaluation.statistics import estimates, solved_sample
from tronlab.score.perturbation import view_sentence

Sentences = tuple[str, ...]
_DECIMALS = 5
_SIGNIFICANT = 0.05
_N_BEST = 3
"""So many gains are named at the top."""
_STRAIGHT_LINE = "dataset_0"
_SIZES = {
    "image": "images of {} px a side",
    "features": "{} features",
    "landmarks": "{} landmarks",
}
"""What the load is measured against, as a sentence has it."""
_STAGES = {"time_detect_s": "detection", "time_match_s": "matching", "time_pose_s": "the pose"}


def larger_terrain_answer(
    normal: Scores, larger: Scores, comparisons: Mapping[str, Sequence[Comparison]]
) -> Sentences:
    """Say whether a terrain that fills the image lowers the error, as the paper supposes."""
    if not comparisons:
        return ("This study was not taken with the larger terrain.",)
    every = [c for of_dataset in comparisons.values() for c in of_dataset]
    n_better = sum(_sign(c.mean) < 0 for c in every)
    n_worse = sum(_sign(c.mean) > 0 for c in every)
    return (
        f"Of {len(every)} pairs of dataset and core, the larger terrain lowers the mean error in"
        f" {n_better} and raises it in {n_worse}, each with its whole 95 % interval; in"
        f" {len(every) - n_better - n_worse} the interval includes zero: {_judged(every)}.",
        *(_terrain_sentence(normal, larger, name, found) for name, found in comparisons.items()),
        *_against_straight_line(normal, larger),
    )


def load_answer(load: pd.DataFrame) -> Sentences:
    """Say how time and memory grow with image size, number of features and of landmarks."""
    if load.empty:
        return ("The computational load was not measured.",)
    return tuple(_load_sentence(str(core), rows) for core, rows in load.groupby("core", sort=False))


def selection_answer(selection: pd.DataFrame) -> Sentences:
    """Say for each base how many choices of features and matches gain, and which gain most."""
    rows = drawn_selection(selection)
    if rows.empty:
        return ("No way of choosing features and matches was tried.",)
    return tuple(
        _selection_sentence(str(base), of_base)
        for base, of_base in rows.groupby("base", sort=False)
    )


def selection_details(selection: pd.DataFrame) -> Sentences:
    """Say of every choice what it gains."""
    rows = drawn_selection(selection)
    return tuple(
        sentence
        for base, of_base in rows.groupby("base", sort=False)
        for sentence in _gain_sentences(str(base), of_base)
    )


def perturbation_answer(rank: pd.DataFrame) -> Sentences:
    """Say whether the error follows how far a shot is off the nominal trajectory."""
    if rank.empty:
        return ("The perturbed trajectories were not looked at.",)
    known = rank[np.isfinite(rank["p"])]
    if known.empty:
        return ("There are too few perturbed shots for a rank correlation.",)
    n_clear = int((known["p"] < _SIGNIFICANT / len(known)).sum())
    largest = known.iloc[int(known["spearman_rho"].abs().to_numpy().argmax())]
    return (
        f"Of {len(known)} rank correlations of the error with the perturbation, {n_clear} differ"
        f" from zero (p below {_SIGNIFICANT:g} divided by their number); the largest is"
        f" {correlation_text(largest)}, of"
        f" {str(largest['measure']).replace('_', ' ')}, {_title(largest['dataset'])},"
        f" {largest['core']}.",
        *([view_sentence(known)] if known["partial_p"].notna().any() else []),
    )


def estimate_text(value: float, low: float, high: float) -> str:
    """Write a number with its interval, if it has one."""
    if not (np.isfinite(low) and np.isfinite(high)):
        return _number_text(value)
    return f"{_number_text(value)} [{_number_text(low)}, {_number_text(high)}]"


def _number_text(value: float) -> str:
    """Write a percentage; what is less than a hundred thousandth is zero, and has no sign."""
    return f"{round(value, _DECIMALS) + 0.0:.2g}"


def _terrain_sentence(
    normal: Scores, larger: Scores, dataset: str, found: Sequence[Comparison]
) -> str:
    usable = (100.0 * float(of[dataset]["usable_fraction"].mean()) for of in (normal, larger))
    before, after = usable
    parts = (
        f"{c.pair.base.core} {_of(c.mean)} % of LOS ({c.differences.base.mean():.2g} to"
        f" {c.differences.other.mean():.2g}, {len(c.differences.values)} poses)"
        for c in found
        if len(c.differences.values)
    )
    return (
        f"{_title(dataset).capitalize()}: the model fills {after:.0f} instead of {before:.0f} % of"
        f" the image; the mean error changes by: {'; '.join(parts) or 'no pose in common'}."
    )


def _against_straight_line(normal: Scores, larger: Scores) -> Iterator[str]:
    """Hold trajectories with the larger terrain against the straight line, as the paper does."""
    if _STRAIGHT_LINE not in normal:
        return
    lines = dict(by_core(normal[_STRAIGHT_LINE]))
    for dataset, table in larger.items():
        if dataset == _STRAIGHT_LINE:
            continue
        for core, rows in by_core(table):
            if core in PAPER_CORES and core in lines:
                line, other = (
                    estimates(solved_sample(of, METRIC))["mean"] for of in (lines[core], rows)
                )
                yield (
                    f"{PAPER_CORES[core]}, {_title(dataset)} with the larger terrain: mean"
                    f" {_of(other)} % of LOS, on the straight line {_of(line)}:"
                    f" {_alike(line, other)}."
                )


def _judged(comparisons: Sequence[Comparison]) -> str:
    signs = [_sign(c.mean) for c in comparisons if c.pair.base.core in PAPER_CORES]
    if signs and all(sign < 0 for sign in signs):
        return "for the paper's estimator its hypothesis holds"
    if signs and all(sign > 0 for sign in signs):
        return "for the paper's estimator its hypothesis does not hold"
    return "for the paper's estimator its hypothesis is not decided everywhere"


def _alike(one: Estimate, other: Estimate) -> str:
    if one.interval is None or other.interval is None:
        return "too few shots to tell them apart"
    overlap = one.interval.low <= other.interval.high and other.interval.low <= one.interval.high
    return "the intervals overlap" if overlap else "the intervals do not overlap"


def _load_sentence(core: str, rows: pd.DataFrame) -> str:
    grown = [_growth(select(rows, varied=name), text) for name, text in _SIZES.items()]
    memory_mb = rows["peak_memory_mb"].dropna()
    held = f"{memory_mb.min():.0f} to {memory_mb.max():.0f} MB" if len(memory_mb) else "not known"
    return (
        f"{core}: {'; '.join(text for text in grown if text) or 'one size only'}; memory of its"
        f" process: {held}."
    )


def _growth(rows: pd.DataFrame, text: str) -> str:
    """Say how the time of an image grows with one quantity; nothing of a single value."""
    ordered = rows[rows["time_all_s"] > 0.0].sort_values("value")
    if ordered["value"].nunique() < 2:
        return ""
    first, last = ordered.iloc[0], ordered.iloc[-1]
    smallest, largest = float(first["value"]), float(last["value"])
    begin_s, end_s = float(first["time_all_s"]), float(last["time_all_s"])
    stages_s = {name: float(last[column]) for column, name in _STAGES.items()}
    slowest = max(stages_s, key=lambda name: stages_s[name])
    power = np.log(end_s / begin_s) / np.log(largest / smallest)
    return (
        f"{text.format(f'{smallest:,.0f} to {largest:,.0f}')}: {begin_s:.2g} to {end_s:.2g} s an"
        f" image (as its power {power:.2f}), at the end {100 * stages_s[slowest] / end_s:.0f} % of"
        f" it {slowest}"
    )


def _selection_sentence(base: str, rows: pd.DataFrame) -> str:
    lowers, raises, hints, rest = _gain_kinds(rows).values()
    best = rows[lowers].sort_values("gain_pct_los", ascending=False).head(_N_BEST)
    named = f", most of all: {'; '.join(_gain_text(row) for _, row in best.iterrows())}"
    return (
        f"Against {base}, {int(lowers.sum())} of {len(rows)} choices lower the mean error for"
        f" certain{named if len(best) else ''}; {int(raises.sum())} raise it for certain,"
        f" {int((hints | rest).sum())} show no difference that is certain (gains in % of LOS)."
    )


def _gain_sentences(base: str, rows: pd.DataFrame) -> Iterator[str]:
    for text, which in _gain_kinds(rows).items():
        found = rows[which].sort_values("gain_pct_los", ascending=False)
        if not found.empty:
            parts = (_gain_text(row) for _, row in found.iterrows())
            yield f"Against {base}, {text} (gain in % of LOS): {'; '.join(parts)}."


def _gain_kinds(rows: pd.DataFrame) -> "dict[str, pd.Series[bool]]":
    """Part gains by what can be said of them.

    An interval is of one choice alone; p is adjusted for all of them, so it may be the stricter.
    """
    lowers, raises = rows["gain_low"] > 0.0, rows["gain_high"] < 0.0
    is_certain = rows["p_holm"] < _SIGNIFICANT
    return {
        "these lower the mean error": lowers & is_certain,
        "these raise it": raises & is_certain,
        "these hint at a difference that so many choices may show by chance": (lowers | raises)
        & ~is_certain,
        "these show no difference, for the interval includes zero": ~(lowers | raises),
    }


def _gain_text(row: "pd.Series[float]") -> str:
    gain = estimate_text(row["gain_pct_los"], row["gain_low"], row["gain_high"])
    text = f"{row['title']} {gain}, p {probability_text(float(row['p_holm']))}"
    n_missed = int(row["n"] - row["n_solved"])
    return f"{text}, {n_missed} of {row['n']} without a pose" if n_missed else text


def _of(estimate: Estimate) -> str:
    interval = estimate.interval
    low, high = (interval.low, interval.high) if interval else (np.nan, np.nan)
    return estimate_text(estimate.value, low, high)


def _sign(mean: Estimate) -> int:
    """Give on which side of zero the whole interval lies; 0 if on both, or there is none."""
    if mean.interval is None:
        return 0
    return int(mean.interval.low > 0.0) - int(mean.interval.high < 0.0)


def _title(dataset: object) -> str:
    name = str(dataset)
    return DATASETS[name].title if name in DATASETS else name
