"""What an ablation and the table of limits amount to, in sentences with numbers."""

from collections.abc import Hashable, Iterator, Mapping
from typing import Any, TypeAlias

import numpy as np
import pandas as pd

from tronlab.report.study.limits_charts import PART_TITLES
from tronlab.score.evaluation.ablation import ALL, EFFICIENT_MEDIAN, NONE, PARTS, TOGETHER
from tronlab.score.evaluation.consistency import N_SIGMA_TRUTH

Row: TypeAlias = Mapping[Hashable, Any]

_TEXTS = frozenset({"dataset", "core", "largest"})
_MOST_NAMED = 3
_MOST_SHARE = 1.2
"""A part that is larger than the whole, by more than chance, says that parts do not add up."""
_NEAR_BOUND = 1.0
"""Up to this, the median of error over bound is that of an estimator that reaches the bound."""
_Z_95 = 1.96
_SMALL_SHARE = 0.05
"""Parts below this are not named."""


def cost_sentences(ablation: pd.DataFrame, *, dataset: str = TOGETHER) -> tuple[str, ...]:
    """Say for each core what all sources cost together, and which of them cost most.

    A source counts only if the 95 % interval of its cost does not include zero.

    Args:
        ablation: As ``ablation_table`` gives it.
        dataset: Which; by default all together.
    """
    rows = ablation[ablation["dataset"] == dataset]
    return tuple(
        _cost_sentence(str(core), rows[rows["core"] == core]) for core in rows["core"].unique()
    )


def limit_sentences(limits: pd.DataFrame, shares: pd.DataFrame) -> tuple[str, ...]:
    """Say for each core what limits it, over all datasets and on each: or that it is not known.

    Args:
        limits: As ``limits_table`` gives it.
        shares: As ``shares_table`` gives it.
    """
    return tuple(
        sentence
        for core in limits["core"].unique()
        for sentence in _sentences_of_core(
            str(core), limits[limits["core"] == core], shares[shares["core"] == core]
        )
    )


def _cost_sentence(core: str, rows: pd.DataFrame) -> str:
    mean = rows.set_index("variant")["mean_pct_los"]
    head = f"{core}: mean error {_pct(mean.get(ALL, np.nan))} of LOS with every source"
    if NONE in mean.index:
        head += f", {_pct(mean[NONE])} without any"
    costs = rows[rows["variant"].str.startswith("without_")]
    if costs.empty:
        return f"{head}; no single source was looked at."
    certain = costs[(costs["cost_low"] > 0.0) | (costs["cost_high"] < 0.0)]
    certain = certain.sort_values("cost_pct_los", ascending=False)
    n_uncertain = len(costs) - len(certain)
    if certain.empty:
        return (
            f"{head}; what each of the {len(costs)} sources costs by itself cannot be told from"
            " zero with these shots."
        )
    dear, cheap = certain[certain["cost_low"] > 0.0], certain[certain["cost_high"] < 0.0]
    parts = [f"{head}."]
    if len(dear):
        named = "; ".join(map(cost_text, dear.head(_MOST_NAMED).to_dict("records")))
        parts.append(f"The dearest: {named}.")
    if len(cheap):
        named = "; ".join(map(cost_text, cheap.iloc[::-1].to_dict("records")))
        parts.append(f"Without it the error is larger: {named}.")
    if n_uncertain:
        parts.append(f"{n_uncertain} of {len(costs)} sources cannot be told from zero.")
    return " ".join(parts)


def cost_text(row: Row) -> str:
    """Name a source of an ablation and its cost with its interval."""
    value, low, high = (float(row[c]) for c in ("cost_pct_los", "cost_low", "cost_high"))
    return f"{row['title']} {_signed(value)} [{_signed(low)}, {_signed(high)}] %"


def _sentences_of_core(core: str, limits: pd.DataFrame, shares: pd.DataFrame) -> Iterator[str]:
    yield _verdict(core, shares[shares["dataset"] == TOGETHER])
    for row in limits.to_dict("records"):
        yield _of_dataset(core, row)


def _verdict(core: str, shares: pd.DataFrame) -> str:
    known = shares[np.isfinite(shares["share"])]
    if known.empty:
        return (
            f"{core}: what limits it is not known, the ablation did not look at kinds of sources."
        )
    n, named = int(known["n"].iloc[0]), _named(known)
    largest = known.loc[known["is_largest"].astype(bool), "part"]
    if len(largest):
        part = str(largest.iloc[0])
        if part == "rest" or known["share"].abs().max() > _MOST_SHARE:
            return (
                f"{core}: not conclusive: its error does not add up from its parts"
                f" ({named}; {n} shots): sources act together, or cancel each other."
            )
        return (
            f"{core}: the {PART_TITLES[part]} limits its typical error, with 95 % confidence as the"
            f" largest part ({named} of its square; {n} shots)."
        )
    return f"{core}: not conclusive: which part is the largest cannot be said with {n} shots" + (
        f" ({named} of the square of its typical error)." if named else "."
    )


def _named(shares: pd.DataFrame) -> str:
    """Name the parts that matter, the largest first, each with its interval."""
    order = shares.sort_values("share", ascending=False, key=np.abs)
    texts: list[str] = []
    for row in order.to_dict("records"):
        value, low, high = (100.0 * float(row[name]) for name in ("share", "low", "high"))
        if abs(value) < 100.0 * _SMALL_SHARE:
            continue
        interval = f" [{low:.0f}, {high:.0f}]" if np.isfinite(low) else ""
        texts.append(f"{PART_TITLES[str(row['part'])]} {value:.0f}{interval} %")
    return ", ".join(texts)


def _of_dataset(core: str, row: Row) -> str:
    of = f"{core}, {row['dataset']}"
    number = {str(name): float(x) for name, x in row.items() if name not in _TEXTS}
    if not number["n_solved"]:
        return f"{of}: no shot was solved."
    head = (
        f"{of}: median error {_pct(number['median_pct_los'])} of LOS, bound"
        f" {_pct(number['bound_pct_los'])}, one sigma of the truth"
        f" {_pct(number['truth_sigma_pct_los'])}"
    )
    findings = [*_against_bound(number), *_against_truth(number), *_of_shares(row)]
    return f"{head}: {'; '.join(findings)}." if findings else f"{head}."


def _against_bound(number: dict[str, float]) -> Iterator[str]:
    """Say how much of the error view and estimator explain."""
    ratio, alone = number["error_over_bound_median"], number["none_over_bound"]
    if ratio <= _NEAR_BOUND:
        yield f"the view limits it, for the error is {ratio:.2g} times the bound"
    elif np.isfinite(ratio):
        yield f"the view explains a part, for the error is {ratio:.2g} times the bound"
    if np.isfinite(floor := number["error_over_floor_median"]):
        yield f"it is {floor:.2g} times bound, truth and registration together"
    if np.isfinite(alone):
        yield (
            f"without any source of error it is {alone:.2g} times the bound, where"
            f" {EFFICIENT_MEDIAN:g} is the best there can be"
        )
    rho, n = number["bound_rho"], number["n_solved"]
    if n > 2 and abs(rho) > _Z_95 / np.sqrt(n - 1.0):
        yield f"error and bound rise together (rank correlation {rho:+.2f})"


def _against_truth(number: dict[str, float]) -> Iterator[str]:
    ratio = number["error_over_truth_median"]
    if ratio < N_SIGMA_TRUTH:
        yield f"the truth is not good enough to tell more, the error is {ratio:.2g} of its sigmas"


def _of_shares(row: Row) -> Iterator[str]:
    shares = {part: float(row[f"share_{part}"]) for part in PARTS}
    known = {part: share for part, share in shares.items() if np.isfinite(share)}
    if not known:
        yield "the ablation says nothing of this dataset"
        return
    first = max(known, key=lambda part: abs(known[part]))
    if first == "rest" or abs(known[first]) > _MOST_SHARE:
        yield "its parts do not add up"
        return
    named = f"{PART_TITLES[first]} {100.0 * known[first]:.0f} %"
    certain = "certainly" if row["largest"] == first else "not certainly"
    yield f"its largest part is, {certain}: {named}"


def _pct(value: float) -> str:
    return f"{value:.2g} %" if np.isfinite(value) else "not known"


def _signed(value: float) -> str:
    return f"{value:+.2g}"
