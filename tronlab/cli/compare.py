"""The command ``tronlab compare``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tronlab.cli.exit_codes import REGRESSION

if TYPE_CHECKING:
    from tronlab.score.evaluation.compare import Comparison
    from tronlab.score.evaluation.resampling import Estimate


def compare(
    directories: Annotated[
        list[Path],
        typer.Argument(
            metavar="DIR...",
            help="Folders that `tronlab score` wrote to, the base first.",
            show_default=False,
        ),
    ],
    *,
    core: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Core to look at, may be given several times; in one folder the first one is the"
            " base.  [default: all]",
        ),
    ] = None,
    metric: Annotated[
        list[str] | None,
        typer.Option(
            metavar="COLUMN",
            help="What is compared: position_error_pct_los, position_error_m, rotation_error_deg,"
            " time_detect_s, time_match_s or time_pose_s; may be given several times."
            "  [default: position_error_pct_los]",
        ),
    ] = None,
    tolerance: Annotated[
        str,
        typer.Option(
            metavar="X|X%",
            help="How much larger mean and median may be: in the metric's unit, or in % of the"
            " base's.",
        ),
    ] = "0",
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for tables and pictures.  [default: none]"),
    ] = None,
    tables: Annotated[
        str,
        typer.Option(
            metavar="FORMAT,...",
            help="What tables are written as: csv, latex, xlsx, json, parquet.",
        ),
    ] = "csv,latex",
) -> None:
    """Compare scorings of the same shots, pair by pair; exit code 1 if one is worse than the base.

    Worse: the whole 95 % interval of the difference of means, or of medians, is above the
    tolerance; or there are fewer poses than in the base.
    """
    from tronlab.report.comparison import write_comparison
    from tronlab.score.evaluation.compare import compare as compare_pairs
    from tronlab.score.evaluation.compare import parse_tolerance, regressions
    from tronlab.score.evaluation.export import parse_formats
    from tronlab.score.evaluation.pairing import left_out, pair_runs
    from tronlab.score.results import load_results

    allowed, formats = parse_tolerance(tolerance), parse_formats(tables)
    results = [load_results(folder) for folder in directories]
    pairs = pair_runs(results, core or [])
    for run in left_out(results, pairs, core or []):
        typer.echo(f"not compared, there is nothing to pair it with: {run}", err=True)
    comparisons = compare_pairs(pairs, metric or ["position_error_pct_los"])
    worse = {
        f"{comparison.pair.name}: {line}": None
        for comparison in comparisons
        for line in regressions(comparison, allowed)
    }
    typer.echo("\n\n".join(_paragraph(comparison) for comparison in comparisons))
    if out is not None:
        write_comparison(
            out,
            comparisons,
            allowed,
            formats=formats,
            announce=lambda text: typer.echo(text, err=True),
        )
        typer.echo(f"\ncomparison: {out}")
    if worse:
        typer.echo("\n" + "\n".join(f"worse: {line}" for line in worse))
        raise typer.Exit(REGRESSION)
    typer.echo(f"\nnothing is worse than the base by more than {tolerance}")


def _paragraph(comparison: "Comparison") -> str:
    """Say what one comparison found."""
    c, solved = comparison, comparison.solved
    lines = [
        f"{c.pair.name}: {c.metric}",
        f"  poses: {solved.n_base} and {solved.n_other} of {solved.n_answers};"
        f" shots solved by the base only {solved.n_base_only}, by the other only"
        f" {solved.n_other_only} (McNemar p {_p(c.p.solved, c.p_holm.solved)})",
    ]
    if c.n_left_out:
        lines.append(f"  {c.n_left_out} answers with seeds that only one of them has are left out")
    n_pairs = len(c.differences.base)
    if not n_pairs:
        return "\n".join([*lines, "  no shot was solved by both"])
    lines += [
        f"  mean {c.differences.base.mean():.4g} to {c.differences.other.mean():.4g}:"
        f" {_estimate(c.mean)};  median: {_estimate(c.median)}",
        f"  of {n_pairs} shots {c.n_better} better, {c.n_same} same, {c.n_worse} worse"
        f" (signed rank p {_p(c.p.wilcoxon, c.p_holm.wilcoxon)},"
        f" sign p {_p(c.p.sign, c.p_holm.sign)})",
    ]
    return "\n".join(lines)


def _estimate(estimate: "Estimate") -> str:
    if estimate.interval is None:
        return f"{estimate.value:+.3g} (too few shots for an interval)"
    return f"{estimate.value:+.3g} [{estimate.interval.low:+.3g}, {estimate.interval.high:+.3g}]"


def _p(alone: float, adjusted: float) -> str:
    return f"{alone:.2g}" if alone == adjusted else f"{alone:.2g}, Holm {adjusted:.2g}"
