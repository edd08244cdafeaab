"""The table of results that ``tronlab demo``, ``score`` and ``report`` print."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tronlab.score.results import ScoreResults


def summary_table(summary: Mapping[str, Any]) -> str:
    """Give the statistics of each core as text, beside what the paper claims.

    Args:
        summary: What ``summary.json`` holds: core name to its statistics.
    """
    from tronlab.report.paper import DATASET_0

    n_wide = max([34, *(len(core) + 1 for core in summary)])
    heading = "position error, % of line of sight"
    lines = [
        f"{heading:<{n_wide}}{'mean':>9}{'max':>9}{'solved':>9}",
        *(_summary_row(core, statistics, n_wide) for core, statistics in summary.items()),
        f"{'the paper, AKAZE and BRISK':<{n_wide}}"
        f"{f'< {DATASET_0.mean_below_pct_los:g}':>9}{f'< {DATASET_0.max_below_pct_los:g}':>9}",
    ]
    return "\n".join(lines)


def missing_poses(results: "ScoreResults") -> list[str]:
    """Give a line for each core that gave no pose for some shots: how many, and why the first."""
    lines: list[str] = []
    for core in results.summary:
        rows = results.scores[results.scores["core"] == core]
        missing = rows[rows["status"] != "ok"]
        if len(missing):
            first = missing.iloc[0]
            seed, shot_id, status = int(first["seed"]), int(first["shot_id"]), str(first["status"])
            reason = " ".join(results.reasons.get((core, seed, shot_id), "").split())
            why = f"{status}: {reason}" if reason else status
            lines.append(
                f"{core}: {len(missing)} of {len(rows)} shots without a pose;"
                f" first: shot {shot_id}, {why}"
            )
    return lines


def _summary_row(core: str, statistics: Mapping[str, Any], n_wide: int) -> str:
    error = statistics["position_error_pct_los"]
    mean, maximum = ("-" if error[key] is None else f"{error[key]:.3f}" for key in ("mean", "max"))
    # An earlier version counted shots only.
    solved = f"{statistics['n_ok']}/{statistics.get('n_answers', statistics['n_shots'])}"
    return f"{core:<{n_wide}}{mean:>9}{maximum:>9}{solved:>9}"
