"""Why errors are farther above the Cramer-Rao bound than asked, as far as the ablation tells."""

from collections.abc import Iterator

import numpy as np
import pandas as pd

from tronlab.report.paper import DATASETS, is_refined
from tronlab.report.study.limits_text import cost_text
from tronlab.report.study.requirements import REFINED_ERROR_OVER_BOUND
from tronlab.report.study.results import StudyResults, select
from tronlab.score.evaluation.ablation import ALL, TOGETHER
from tronlab.score.evaluation.consistency import efficiency, efficiency_with_truth

_LIMIT = f"{REFINED_ERROR_OVER_BOUND:g}"


def bound_shortfalls(results: StudyResults) -> tuple[str, ...]:
    """Say of each refined core where it misses the asked error over bound, and what costs most."""
    return tuple(
        f"{core} misses the asked median of error over bound ({_LIMIT}): {'; '.join(where)}."
        f" {_dearest(results.tables.get('ablation'), core)}"
        for core in results.cores
        if is_refined(core) and (where := list(_where(results, core)))
    )


def _where(results: StudyResults, core: str) -> Iterator[str]:
    for dataset, scores in results.datasets.items():
        rows = select(scores, core=core)
        ratio = efficiency(rows).median_ratio
        if ratio > REFINED_ERROR_OVER_BOUND:
            alone = _without_any(results.tables.get("limits"), dataset, core)
            yield f"{DATASETS[dataset].title} {ratio:.2g}{_over_stated(rows)}{alone}"


def _over_stated(rows: pd.DataFrame) -> str:
    """Hold the error against what was stated of truth, and what the core states."""
    solved = select(rows, status="ok")
    over_core = float((solved["position_error_m"] / solved["sigma_core_m"]).median())
    ratios = {
        "bound, truth and registration together": efficiency_with_truth(rows).median_ratio,
        "the core's own sigma": over_core,
    }
    told = [f"{ratio:.2g} times {what}" for what, ratio in ratios.items() if np.isfinite(ratio)]
    return f" ({', '.join(told)})" if told else ""


def _without_any(limits: pd.DataFrame | None, dataset: str, core: str) -> str:
    if limits is None:
        return ""
    known = select(limits, dataset=dataset, core=core)["none_over_bound"].dropna()
    return f", {float(known.iloc[0]):.2g} without any source of error" if len(known) else ""


def _dearest(ablation: pd.DataFrame | None, core: str) -> str:
    """Name the source that certainly costs most, over all datasets of the ablation."""
    if ablation is None:
        return "Why is not known: no sources of error were switched off."
    rows = select(ablation, core=core, dataset=TOGETHER)
    certain = rows[rows["variant"].str.startswith("without_") & (rows["cost_low"] > 0.0)]
    if certain.empty:
        return "Why is not known: no source by itself costs more than zero for certain."
    dearest = certain.sort_values("cost_pct_los").to_dict("records")[-1]
    mean = select(rows, variant=ALL)["mean_pct_los"]
    of = f" of a mean error of {float(mean.iloc[0]):.2g} % of LOS" if len(mean) else ""
    return f"As far as the ablation tells, what costs most is: {cost_text(dearest)}{of}."
