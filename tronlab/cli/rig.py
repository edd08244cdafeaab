"""The commands ``tronlab rig``: is the laboratory there?"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from tronlab.campaign.inspection import Finding

EXIT_FAILED = 1

rig = typer.Typer(
    no_args_is_help=True, rich_markup_mode=None, help="Look whether the devices of a rig answer."
)


@rig.callback()
def _group() -> None:
    """Keep ``check`` a command of its own although it is the only one."""


@rig.command()
def check(
    path: Annotated[Path, typer.Argument(metavar="RIG.yaml", help="Rig file.")],
    seed: Annotated[int, typer.Option(min=0, help="Seed of simulated devices.")] = 0,
) -> None:
    """Connect to every device and say who answers, and in which state; nothing moves.

    The exit code is 1 if a device failed.
    """
    from tronlab.campaign.inspection import inspect_devices
    from tronlab.campaign.rig import load_rig

    loaded = load_rig(path)
    findings = inspect_devices(
        loaded.open_devices(seed),
        drivers={
            kind: getattr(loaded.config.devices, kind).driver
            for kind in type(loaded.config.devices).model_fields
        },
    )
    for finding in findings:
        _print(finding)
    failed = [finding.name for finding in findings if finding.error]
    if failed:
        typer.echo(
            f"{len(failed)} of {len(findings)} devices failed: {', '.join(failed)}", err=True
        )
        raise typer.Exit(EXIT_FAILED)
    typer.echo(f"all {len(findings)} devices answer")


def _print(finding: "Finding") -> None:
    typer.echo(f"{finding.name:9} {'FAILED' if finding.error else 'ok':7} {finding.driver}")
    rows = {"driver file": str(finding.driver_file), **finding.facts}
    if finding.error:
        rows["error"] = finding.error
    width = max(len(name) for name in rows)
    for name, value in rows.items():
        typer.echo(f"          {name:<{width}}  {value}")
