"""The command ``tronlab study``."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tronlab.cli.exit_codes import INTERRUPTED

if TYPE_CHECKING:
    from tronlab.study.run import StudyRun
    from tronlab.study.steps import Step
    from tronlab.study.study import Study


def study(
    path: Annotated[
        Path, typer.Argument(metavar="STUDY.yaml", help="Study file.", show_default=False)
    ],
    *,
    quick: Annotated[
        bool,
        typer.Option("--quick", help="A first look in minutes: what the file says under quick."),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Folder of the results (default: out/NAME, or out/NAME-quick)."
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, help="Number of processes.  [default: one a processor]"),
    ] = None,
    steps: Annotated[
        bool, typer.Option("--steps", help="Only list the steps, and which of them are done.")
    ] = False,
) -> None:
    """Record, score, take apart and report all datasets of a study.

    What is done already and has not changed since is not done again: after Ctrl-C, a power cut or
    an edited file the same command goes on.
    """
    from tronlab.score.rescore import n_processors
    from tronlab.study.check import check_study
    from tronlab.study.run import run_steps, steps_of
    from tronlab.study.study import load_study, study_folder
    from tronlab.study.view import open_view

    read = load_study(path, quick=quick)
    folder = out or study_folder(read)
    every = steps_of(read)
    if steps:
        _list(every, read, folder)
        return
    try:
        with open_view(sys.stderr) as view:
            done = run_steps(
                read,
                every,
                folder,
                n_workers=workers or n_processors(),
                view=view,
                check=lambda: check_study(read, live=view),
            )
    except KeyboardInterrupt as interrupt:
        typer.echo(str(interrupt) or "interrupted", err=True)
        raise typer.Exit(INTERRUPTED) from None
    typer.echo(_summary(done), err=True)
    typer.echo(folder / "report.html")


def _list(steps: "list[Step]", study: "Study", folder: Path) -> None:
    """Print every step with its state, and how long it took or may take."""
    from tronlab.study.run import ledger_of
    from tronlab.study.view import clock_face

    ledger = ledger_of(study, folder)
    for step in steps:
        is_done = ledger.is_done(step)
        duration = clock_face(ledger.took_s.get(step.name, step.cost))
        about = "     " if is_done else "about"
        typer.echo(f"{'done' if is_done else 'to do':6} {about} {duration}  {step.name}")


def _summary(done: "StudyRun") -> str:
    from tronlab.study.view import clock_face

    memory = "" if done.peak_memory_mb is None else f", {done.peak_memory_mb / 1e3:.1f} GB at most"
    return (
        f"{done.n_done} steps done in {clock_face(done.seconds)},"
        f" {done.n_done_before} were done before{memory}"
    )
