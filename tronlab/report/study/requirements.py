"""What is asked of a study's figures, what was reached, and whether that is enough."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
import pandas as pd

from tronlab.report.paper import (
    DATASET_0,
    DATASETS,
    PAPER_CORES,
    TABLE_1,
    TABLE_2,
    PublishedErrors,
    detector_of,
    is_refined,
)
from tronlab.report.study.results import StudyResults
from tronlab.report.tables import by_core
from tronlab.score.evaluation.consistency import efficiency, efficiency_with_truth
from tronlab.score.evaluation.export import MISSING, Column, Table

REFINED_MEAN_PCT_LOS = 0.1
REFINED_MAX_PCT_LOS = 0.5
REFINED_ERROR_OVER_BOUND = 1.5
"""Of the median."""
REFINED_TIMES_BELOW = 20.0
"""The paper's mean over that of the refined core of the same detector."""
REFINED_AXIS_DEG = 0.05
"""Of the mean error of each camera axis."""
FULL_STUDY_S, QUICK_STUDY_S = 3600.0, 360.0
"""On two processors."""
STUDY_MEMORY_MB = 6000.0

Verdict: TypeAlias = Literal["met", "not met", "not known"]
Errors: TypeAlias = tuple[float, float]
"""Mean and maximum of the position error, percent of the range; infinite without any pose."""


@dataclass(frozen=True, slots=True)
class Requirement:
    """One figure asked for, with the least favourable case there is."""

    subject: str
    asked: str
    reached: str
    case: str
    """Where that was: dataset and core."""
    verdict: Verdict
    others: tuple[str, ...] = ()
    """The other cases that do not meet it, each with its value."""


@dataclass(frozen=True, slots=True)
class _Case:
    """One core on one dataset."""

    dataset: str
    core: str
    rows: pd.DataFrame

    @property
    def name(self) -> str:
        return f"{DATASETS[self.dataset].title}, {self.core}"


def requirements(results: StudyResults) -> tuple[Requirement, ...]:
    """Hold a study against what is asked of it; each figure is that of the worst case."""
    cases = [
        _Case(dataset, core, rows)
        for dataset, scores in results.datasets.items()
        for core, rows in by_core(scores)
    ]
    paper = [case for case in cases if case.core in PAPER_CORES]
    refined = [case for case in cases if is_refined(case.core)]
    return (
        *_of_dataset_0([case for case in paper if case.dataset == "dataset_0"]),
        *_of_published("Table 1", TABLE_1, paper),
        *_of_published("Table 2", TABLE_2, paper),
        *_of_refined(refined),
        *_of_effort(results),
    )


def requirements_table(found: Sequence[Requirement]) -> Table:
    """Give a row a requirement."""
    columns = (
        Column("subject", "figure"),
        Column("asked", "asked"),
        Column("reached", "reached"),
        Column("case", "where it is worst"),
        Column("others", "where else it is not met"),
        Column("verdict", "verdict"),
    )
    rows = tuple(
        (r.subject, r.asked, r.reached, r.case, "; ".join(r.others), r.verdict) for r in found
    )
    return Table("requirements", "What is asked, and what was reached", columns, rows)


def verdict_sentence(found: Sequence[Requirement], *, n_datasets: int) -> str:
    """Say how many of the figures are met, and which are not.

    Args:
        found: All of them.
        n_datasets: Number of datasets they were judged by.
    """
    judged = [r for r in found if r.verdict != "not known"]
    failed = [r.subject for r in judged if r.verdict == "not met"]
    text = f"{len(judged) - len(failed)} of {len(judged)} figures asked for are met"
    if n_datasets < len(DATASETS):
        text += f", by {n_datasets} of {len(DATASETS)} datasets only"
    if failed:
        text += f"; not met: {'; '.join(failed)}"
    unknown = len(found) - len(judged)
    return f"{text}; {unknown} could not be judged." if unknown else f"{text}."


def _of_dataset_0(cases: Sequence[_Case]) -> tuple[Requirement, ...]:
    asked = DATASET_0
    return (
        _limit("Paper's estimator, dataset 0: mean", asked.mean_below_pct_los, cases, _mean),
        _limit("Paper's estimator, dataset 0: maximum", asked.max_below_pct_los, cases, _max),
    )


def _of_published(
    name: str, table: Mapping[tuple[str, str], PublishedErrors], cases: Sequence[_Case]
) -> tuple[Requirement, ...]:
    published = {case.name: table.get((case.dataset, PAPER_CORES[case.core])) for case in cases}
    held = [case for case in cases if published[case.name] is not None]

    def margin(of: Callable[[_Case], float], attribute: str) -> Requirement:
        subject = f"Paper's estimator, {name}: {attribute}"
        asked = "each at most the paper's"
        if not held:
            return _unknown(subject, asked)
        limits = [float(getattr(published[c.name], f"{attribute}_pct_los")) for c in held]
        reached = [of(case) for case in held]
        i = int(np.argmax(np.array(reached) / np.array(limits)))
        n_met = int((np.array(reached) <= np.array(limits)).sum())
        text = f"{n_met} of {len(held)}; {reached[i]:.3g} %, the paper {limits[i]:g} %"
        others = tuple(
            f"{case.name}: {value:.3g} %, the paper {limit:g} %"
            for case, value, limit in zip(held, reached, limits, strict=True)
            if value > limit and case is not held[i]
        )
        verdict = _verdict(n_met == len(held))
        return Requirement(subject, asked, text, held[i].name, verdict, others)

    return margin(_mean, "mean"), margin(_max, "max")


def _of_refined(cases: Sequence[_Case]) -> tuple[Requirement, ...]:
    return (
        _limit("Refined: mean position error", REFINED_MEAN_PCT_LOS, cases, _mean),
        _times_below(cases),
        _limit("Refined: largest position error", REFINED_MAX_PCT_LOS, cases, _max),
        _limit(
            "Refined: shots without a pose", 0.0, cases, lambda c: float(_n_unsolved(c)), unit=""
        ),
        _limit(
            "Refined: median of error over the bound of pixel noise alone",
            REFINED_ERROR_OVER_BOUND,
            cases,
            lambda case: efficiency(case.rows).median_ratio,
            unit="",
        ),
        _limit(
            "Refined: median of error over bound, truth and registration together",
            REFINED_ERROR_OVER_BOUND,
            cases,
            lambda case: efficiency_with_truth(case.rows).median_ratio,
            unit="",
        ),
        _limit(
            "Refined: mean error of a camera axis", REFINED_AXIS_DEG, cases, _axis_deg, unit=" deg"
        ),
    )


def _times_below(cases: Sequence[_Case]) -> Requirement:
    subject = "Refined: mean below that of the paper's tables"
    asked = f"at least {REFINED_TIMES_BELOW:g} times"
    published = {**TABLE_1, **TABLE_2}
    times = {
        case.name: published[of].mean_pct_los / mean if (mean := _mean(case)) > 0.0 else np.inf
        for case in cases
        if (of := (case.dataset, detector_of(case.core))) in published
    }
    if not times:
        return _unknown(subject, asked)
    worst = min(times, key=lambda name: times[name])
    others = tuple(
        f"{name}: {value:.3g}"
        for name, value in times.items()
        if value < REFINED_TIMES_BELOW and name != worst
    )
    verdict = _verdict(times[worst] >= REFINED_TIMES_BELOW)
    return Requirement(subject, asked, f"{times[worst]:.3g} times", worst, verdict, others)


def _of_effort(results: StudyResults) -> tuple[Requirement, ...]:
    allowed_s = QUICK_STUDY_S if results.is_quick else FULL_STUDY_S
    steps = pd.DataFrame(results.info.get("steps", []))
    kind, other = ("Quick", "Full") if results.is_quick else ("Full", "Quick")
    kind = f"{kind} study"
    elsewhere = (
        _unknown(f"{other} study: time of all steps", "stands on its own page"),
        _unknown("Second run of a study: time", "seconds; no page can tell"),
    )
    asked_time = f"at most {allowed_s / 60:g} min"
    asked_memory = f"at most {STUDY_MEMORY_MB / 1000:g} GB"
    if not {"seconds", "peak_memory_mb"} <= set(steps.columns):
        return (
            _unknown(f"{kind}: time of all steps", asked_time),
            _unknown(f"{kind}: memory", asked_memory),
            *elsewhere,
        )
    seconds = float(steps["seconds"].sum())
    memory_mb = float(steps["peak_memory_mb"].max())
    return (
        Requirement(
            f"{kind}: time of all steps",
            asked_time,
            f"{seconds / 60:.1f} min",
            _largest(steps, "seconds"),
            _verdict(seconds <= allowed_s),
        ),
        Requirement(
            f"{kind}: memory",
            asked_memory,
            f"{memory_mb / 1000:.1f} GB",
            _largest(steps, "peak_memory_mb"),
            _verdict(memory_mb <= STUDY_MEMORY_MB),
        )
        if np.isfinite(memory_mb)
        else _unknown(f"{kind}: memory", asked_memory),
        *elsewhere,
    )


def _limit(
    subject: str,
    limit: float,
    cases: Sequence[_Case],
    of: Callable[[_Case], float],
    *,
    unit: str = " % of LOS",
) -> Requirement:
    """Hold the largest value of all cases against a limit; NaN: not known of that case."""
    asked = f"at most {limit:g}{unit}"
    values = {case.name: of(case) for case in cases}
    known = {name: value for name, value in values.items() if not np.isnan(value)}
    if not known:
        return _unknown(subject, asked)
    worst = max(known, key=lambda name: known[name])
    where = worst if known[worst] > 0.0 else "none anywhere"
    others = tuple(
        f"{name}: {_reached(value, unit)}"
        for name, value in known.items()
        if value > limit and name != worst
    )
    reached, verdict = _reached(known[worst], unit), _verdict(known[worst] <= limit)
    return Requirement(subject, asked, reached, where, verdict, others)


def _reached(value: float, unit: str) -> str:
    return f"{value:.3g}{unit}" if np.isfinite(value) else "no pose"


def _mean(case: _Case) -> float:
    return _errors(case)[0]


def _max(case: _Case) -> float:
    return _errors(case)[1]


def _errors(case: _Case) -> Errors:
    errors = case.rows.loc[case.rows["status"] == "ok", "position_error_pct_los"]
    return (float(errors.mean()), float(errors.max())) if len(errors) else (np.inf, np.inf)


def _n_unsolved(case: _Case) -> int:
    return int((case.rows["status"] != "ok").sum())


def _axis_deg(case: _Case) -> float:
    """Give the mean error of that axis which has the largest; NaN without any pose."""
    solved = case.rows[case.rows["status"] == "ok"]
    if solved.empty:
        return np.nan
    return max(float(solved[f"axis_error_{axis}_deg"].mean()) for axis in "xyz")


def _largest(steps: pd.DataFrame, column: str) -> str:
    if "name" not in steps.columns:
        return MISSING
    return f"most: {steps.sort_values(column, na_position='first')['name'].iloc[-1]}"


def _unknown(subject: str, asked: str) -> Requirement:
    return Requirement(subject, asked, MISSING, MISSING, "not known")


def _verdict(is_met: bool) -> Verdict:
    return "met" if is_met else "not met"
