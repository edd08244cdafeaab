"""``tronlab database prune``: leave out landmarks that are of no use."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tronlab.cli.exit_codes import INTERRUPTED

if TYPE_CHECKING:
    from tronlab.campaign.live import Live
    from tronlab.cli.database_evidence import Evidence
    from tronlab.nav.database import Database
    from tronlab.nav.database_file import Pruning
    from tronlab.nav.pruning import PruningRules, Selection


def prune(
    path: Annotated[
        Path, typer.Argument(metavar="DB.h5", help="The database.", show_default=False)
    ],
    *,
    out: Annotated[Path, typer.Option(metavar="DB2.h5", help="The new file.")],
    verified_by: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="SCORES",
            help="Folder of a scoring with this database; may be given several times.",
        ),
    ] = None,
    max_error_pct: Annotated[
        float,
        typer.Option(
            min=0.0,
            metavar="PCT",
            help="Largest error of a pose that counts as right there, in % of the line of sight.",
        ),
    ] = 1.0,
    min_verified: Annotated[
        int,
        typer.Option(
            min=0, metavar="N", help="Least number of shots in which a landmark must have verified."
        ),
    ] = 1,
    min_offered: Annotated[
        int,
        typer.Option(min=1, metavar="N", help="Landmarks that fewer shots could see stay."),
    ] = 3,
    max_differing_pct: Annotated[
        float,
        typer.Option(
            "--merge",
            min=0.0,
            max=50.0,
            metavar="PCT",
            help="One point seen in several views stays once, at its mean place, if its descriptors"
            " differ in no more of their bits; 10 keeps a third of a dense database.",
        ),
    ] = 0.0,
    max_per_cell: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            help="Most landmarks of one cell and one octave of size.  [default: all]",
        ),
    ] = None,
    cell_m: Annotated[
        float, typer.Option("--cell", metavar="M", help="Side of the cells, metres.")
    ] = 0.05,
) -> None:
    """Leave out landmarks that never verify, that are there twice, or that crowd a cell.

    A landmark verifies in a shot if a right pose rests on it. What no shot could see stays. The new
    file remembers the counts, and by which datasets it was pruned.
    """
    from tronlab.campaign.live import open_live
    from tronlab.dataset.places import check_is_new
    from tronlab.nav.pruning import PruningRules
    from tronlab.yaml_models import parse_mapping

    rules = parse_mapping(
        {
            "min_verified": min_verified,
            "min_offered": min_offered,
            "max_differing_pct": max_differing_pct,
            "max_per_cell": max_per_cell,
            "cell_m": cell_m,
        },
        PruningRules,
        key="prune",
    )
    check_is_new(out)
    try:
        with open_live(sys.stderr) as live:
            summary = _prune(
                path,
                out,
                rules=rules,
                folders=verified_by or [],
                max_error_pct=max_error_pct,
                live=live,
            )
    except KeyboardInterrupt:
        typer.echo(f"interrupted: nothing is left of {out}", err=True)
        raise typer.Exit(INTERRUPTED) from None
    typer.echo(summary)


def _prune(
    path: Path,
    out: Path,
    *,
    rules: "PruningRules",
    folders: list[Path],
    max_error_pct: float,
    live: "Live",
) -> str:
    """Write what stays of a database; give what is said of it."""
    from tronlab.nav.database_file import read_database_file, verify_database
    from tronlab.nav.database_writer import save_selection
    from tronlab.nav.pruning import select

    verify_database(path)
    source = read_database_file(path)
    evidence = _evidence(source.database, folders, max_error_pct, live)
    counts = evidence.counts if evidence else source.counts
    selection = select(
        source.database,
        counts,
        rules,
        on_progress=lambda n_done, n_all: live.advance("duplicates", n_done=n_done, n_all=n_all),
    )
    pruning = _pruning_of(source.database, selection, evidence, rules, max_error_pct)
    save_selection(source, selection.chosen, selection.p_trs_m, out, pruning=pruning, counts=counts)
    return (
        f"{out}: {pruning.n_after} of {pruning.n_before} landmarks; left out:"
        f" {selection.n_unverified} never or seldom verified, {selection.n_merged} there twice,"
        f" {selection.n_thinned} in crowded cells"
    )


def _pruning_of(
    database: "Database",
    selection: "Selection",
    evidence: "Evidence | None",
    rules: "PruningRules",
    max_error_pct: float,
) -> "Pruning":
    """Say what the new file remembers of how it came about."""
    from datetime import UTC, datetime

    from tronlab.nav.database_file import Pruning

    return Pruning(
        time_utc=datetime.now(UTC).isoformat(timespec="seconds"),
        from_digest=database.digest,
        n_before=len(database),
        n_after=len(selection.chosen),
        datasets=evidence.datasets if evidence else (),
        rules={**rules.model_dump(), "max_error_pct": max_error_pct},
    )


def _evidence(
    database: "Database", folders: list[Path], max_error_pct: float, live: "Live"
) -> "Evidence | None":
    from tronlab.cli.database_evidence import gather

    if not folders:
        return None
    evidence = gather(
        database,
        folders,
        max_error_pct=max_error_pct,
        on_shot=lambda n_done, n_all: live.advance("shots looked at", n_done=n_done, n_all=n_all),
    )
    live.announce(
        f"{evidence.n_shots} shots with a right pose; a score on the same shots will look better"
        " than on others: judge the pruned database by another dataset"
    )
    return evidence
