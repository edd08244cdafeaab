"""The command ``tronlab score``."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tronlab.cli.exit_codes import INTERRUPTED
from tronlab.errors import ScoreError

if TYPE_CHECKING:
    import pandas as pd

    from tronlab.nav.specs import CoreSpec
    from tronlab.score.rescoring.job import ScoreJob
    from tronlab.score.rescoring.prior import PriorSettings
    from tronlab.score.rescoring.workers import Executor
    from tronlab.score.sweep import SweepPlan

N_SHOWN = 20
"""Lines about a sweep; all variants are in ``sweep.csv``."""


def score(
    datasets: Annotated[
        list[Path],
        typer.Argument(
            metavar="DATASET...", help="Recorded datasets, or their folders.", show_default=False
        ),
    ],
    *,
    core: Annotated[
        list[str] | None,
        typer.Option(
            metavar="CORE",
            help="Navigation core: NAME, package.module:Class, cmd:PROGRAM ARGUMENTS or"
            " tcp://HOST:PORT, with ALIAS= before it for another name; may be given several"
            " times.  [default: the campaign's]",
        ),
    ] = None,
    sweep: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Cores and the settings to try, a sweep file."),
    ] = None,
    seeds: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, help="Score each core N times, with the seeds 0 to N-1."),
    ] = None,
    prior: Annotated[
        str | None,
        typer.Option(
            metavar="SOURCE:M,DEG",
            help="Offer cores a prior: truth:0.05,1 is the truth with random errors of 5 cm and"
            " 1 deg; previous:0.2,5 is their last answer, less certain by 20 cm and 5 deg.",
        ),
    ] = None,
    database: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Landmarks of the built-in cores.  [default: the dataset's views]"
        ),
    ] = None,
    time_limit: Annotated[
        float | None,
        typer.Option(metavar="S", help="A core that takes longer has not answered.  [default: 60]"),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(metavar="N", help="Number of processes.  [default: one a processor]"),
    ] = None,
    cluster: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Work on a Dask cluster: tcp://SCHEDULER:8786."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder of the results; of several datasets, each has a folder in it."
            "  [default: the dataset's]",
        ),
    ] = None,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Compute everything anew, keep nothing for next time.")
    ] = False,
) -> None:
    """Score navigation cores against recorded datasets.

    What was computed before and did not change since is taken from a cache.
    """
    from tronlab.campaign.live import open_live
    from tronlab.score.rescore import score_jobs
    from tronlab.score.rescoring.cache import usual_cache_folder
    from tronlab.score.rescoring.job import ScoreJob
    from tronlab.score.sweep import load_sweep

    executor = _executor(workers, cluster)
    if database is not None and not database.is_file():
        raise ScoreError(f"{database}: no such file; make it with: tronlab database build")
    plan = load_sweep(sweep, database=database) if sweep is not None else None
    jobs = [
        ScoreJob(
            dataset,
            _cores(dataset, core or (), plan, n_seeds=seeds, database=database),
            folder,
            prior=_prior(prior, plan),
            time_limit_s=_time_limit_s(time_limit, plan),
            cache_dir=None if fresh else usual_cache_folder(),
        )
        for dataset, folder in _folders(datasets, out).items()
    ]
    try:
        with open_live(sys.stderr) as live:
            score_jobs(
                jobs,
                executor=executor,
                progress=lambda done, n: live.advance("score", n_done=done, n_all=n),
                announce=live.announce,
            )
    except KeyboardInterrupt as interrupt:
        typer.echo(str(interrupt) or "interrupted", err=True)
        raise typer.Exit(INTERRUPTED) from None
    for job in jobs:
        if len(jobs) > 1:
            typer.echo(f"\n{job.dataset_path}")
        _show(job, plan)


def _folders(datasets: Sequence[Path], out: Path | None) -> dict[Path, Path]:
    """Give each dataset the folder of its results; one that is named twice counts once.

    Raises:
        ScoreError: Two would have the same folder.
        DatasetError: A folder holds no dataset.
    """
    from tronlab.dataset.location import DATASET_NAME, dataset_in

    named = {path.resolve(): path for path in reversed([*map(dataset_in, datasets)])}
    folders: dict[Path, Path] = {}
    for path in reversed(named.values()):
        # A run calls every dataset the same; what tells them apart is its folder.
        stem = path.resolve().parent.name if path.name == DATASET_NAME else path.stem
        own = path.parent if out is None else out if len(named) == 1 else out / stem
        taken = {folder.resolve(): one for one, folder in folders.items()}
        clash = taken.get(own.resolve())
        if clash is not None:
            raise ScoreError(
                f"{own}: results of {clash} and {path} would both go there;"
                " score them one at a time, each with a folder of its own: --out DIR"
            )
        folders[path] = own
    return folders


def _cores(
    dataset: Path,
    texts: Sequence[str],
    plan: "SweepPlan | None",
    *,
    n_seeds: int | None,
    database: Path | None,
) -> "tuple[CoreSpec, ...]":
    """Give every core with every seed: those of the sweep, and those named or the campaign's.

    Raises:
        ScoreError: A text is no core, or two different cores have the same name.
        DatasetError: The dataset cannot be read.
    """
    from tronlab.nav.specs import parse_cores
    from tronlab.score.rescore import cores_of_dataset
    from tronlab.score.sweep import with_database, with_seeds

    swept = [variant.spec for variant in plan.variants] if plan else []
    named = parse_cores(texts or (() if plan else cores_of_dataset(dataset)))
    cores: dict[str, CoreSpec] = {}
    for spec in (*swept, *(with_database(spec, database) for spec in named)):
        if cores.setdefault(spec.name, spec) != spec:
            raise ScoreError(
                f"a core of the sweep and one of --core are both called {spec.name!r}, and differ;"
                f" give the other a name: --core other-name={spec.target}"
            )
    seeds = range(n_seeds) if n_seeds is not None else plan.seeds if plan else (0,)
    return with_seeds(tuple(cores.values()), tuple(seeds))


def _prior(text: str | None, plan: "SweepPlan | None") -> "PriorSettings | None":
    """Read what ``--prior`` takes; without it the sweep's.

    Raises:
        ConfigError: It is not written like that.
    """
    from tronlab.score.rescoring.prior import PriorSettings
    from tronlab.yaml_models import parse_mapping

    if text is None:
        return plan.prior if plan else None
    source, _, sigmas = text.partition(":")
    numbers = sigmas.split(",")
    try:
        position_m, rotation_deg = map(float, numbers)
    except ValueError:
        raise ScoreError(
            f"--prior {text}: not a prior; write SOURCE:M,DEG, for example truth:0.05,1 or"
            " previous:0.2,5"
        ) from None
    values = {
        "source": source,
        "position_sigma_m": position_m,
        "rotation_sigma_deg": rotation_deg,
    }
    return parse_mapping(values, PriorSettings, key="--prior")


def _time_limit_s(limit_s: float | None, plan: "SweepPlan | None") -> float:
    from tronlab.score.rescoring.shot import LIMIT_S

    if limit_s is None:
        return (plan and plan.time_limit_s) or LIMIT_S
    if not 0 < limit_s < float("inf"):
        raise ScoreError(f"--time-limit {limit_s:g}: must be more than 0 seconds")
    return limit_s


def _executor(n_workers: int | None, cluster: str | None) -> "Executor":
    from tronlab.score.rescore import n_processors
    from tronlab.score.rescoring.workers import ProcessExecutor

    if cluster is None:
        return ProcessExecutor(n_processors() if n_workers is None else n_workers)
    if n_workers is not None:
        raise ScoreError("--workers and --cluster: a cluster has its own workers; leave one out")
    from tronlab.score.rescoring.cluster import DaskExecutor

    return DaskExecutor(cluster)


def _show(job: "ScoreJob", plan: "SweepPlan | None") -> None:
    """Print what came out for one dataset."""
    from tronlab.cli.summary import missing_poses, summary_table
    from tronlab.score.results import SCORES, load_results

    folder = job.out_dir
    results = load_results(folder)
    missing = missing_poses(results)
    if plan is None:
        typer.echo("\n".join([summary_table(results.summary), *missing]))
    else:
        # Not before it is needed: drawing takes a second to import.
        from tronlab.report.sweep import PICTURE, TABLE, save_sweep

        scores = results.scores[results.scores["core"].isin(list(job.names))]
        lines = _variant_lines(save_sweep(scores, plan.variants, folder))
        typer.echo("\n".join([lines[0], *_first(lines[1:]), *_first(missing)]))
        typer.echo(f"\nsweep: {folder / TABLE}, {folder / PICTURE}.png")
    typer.echo(f"\nscores: {folder / SCORES}")


def _variant_lines(table: "pd.DataFrame") -> list[str]:
    """Give a heading, and a line for each variant."""
    heading = "position error, % of line of sight"
    width = max(map(len, [heading, *table["variant"]]))
    lines = [f"{heading:<{width}}     mean   median   solved"]
    for row in table.to_dict("records"):
        mean, median = (
            f"{row[key]:.3f}" if row["n_ok"] else "-"
            for key in ("position_error_mean_pct_los", "position_error_median_pct_los")
        )
        solved = f"{row['n_ok']}/{row['n_rows']}"
        lines.append(f"{row['variant']:<{width}}{mean:>9}{median:>9}{solved:>9}")
    return lines


def _first(lines: Sequence[str]) -> list[str]:
    more = len(lines) - N_SHOWN
    return [*lines[:N_SHOWN], *([f"and {more} more"] if more > 0 else [])]
