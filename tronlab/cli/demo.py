"""The command ``tronlab demo``."""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tronlab.cli.exit_codes import INTERRUPTED
from tronlab.errors import ConfigError

if TYPE_CHECKING:
    from tronlab.campaign.live import Live

DEMO_CAMPAIGN = Path("campaigns/straight_line.yaml")
DEFAULT_OUT = Path("out/demo")


def demo(
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder of the results; if in use, the next free.")
    ] = DEFAULT_OUT,
) -> None:
    """Run, score and report campaigns/straight_line.yaml on the simulated laboratory."""
    from tronlab.campaign.live import open_live
    from tronlab.cli.summary import summary_table

    campaign = find_campaign()
    out = free_folder(out, announce=lambda text: typer.echo(text, err=True))
    try:
        with open_live(sys.stderr) as live:
            report = _run_score_report(campaign, out, live)
    except KeyboardInterrupt as interrupt:
        typer.echo(str(interrupt) or "interrupted", err=True)
        raise typer.Exit(INTERRUPTED) from None
    typer.echo(summary_table(json.loads((out / "summary.json").read_text(encoding="utf-8"))))
    typer.echo(f"\nreport: {report}")


def find_campaign() -> Path:
    """Find the demo campaign: in the working directory, else in the source checkout.

    Raises:
        ConfigError: It is in neither.
    """
    checkout = Path(__file__).resolve().parents[2]
    for folder in (Path(), checkout):
        if (folder / DEMO_CAMPAIGN).is_file():
            return folder / DEMO_CAMPAIGN
    raise ConfigError(
        f"no such file, neither here ({Path.cwd()}) nor in {checkout}; run the demo from a source"
        " checkout",
        path=DEMO_CAMPAIGN,
    )


def free_folder(out: Path, *, announce: Callable[[str], None]) -> Path:
    """Give ``out``, or the first of out-2, out-3, ... that is new or empty."""
    folder, n = out, 1
    while folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        n += 1
        folder = out.with_name(f"{out.name}-{n}")
    if folder != out:
        announce(f"{out} is in use and stays as it is; this run goes to {folder}")
    return folder


def _run_score_report(campaign: Path, out: Path, live: "Live") -> Path:
    from tronlab.campaign.run import run_campaign
    from tronlab.report.build import build_report
    from tronlab.score.rescore import score_dataset

    dataset = run_campaign(campaign, out_dir=out, live=live)
    score_dataset(
        dataset,
        out_dir=out,
        progress=lambda n_done, n_all: live.advance("score", n_done=n_done, n_all=n_all),
        announce=live.announce,
    )
    live.announce("report: drawing figures")
    return build_report(out, announce=live.announce)
