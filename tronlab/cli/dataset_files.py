"""``tronlab dataset pack|migrate|recompute-truth``: another file made of a dataset."""

import sys
from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from tronlab.cli.exit_codes import INTERRUPTED

DatasetArgument: TypeAlias = Annotated[
    Path,
    typer.Argument(metavar="DATASET", help="The .h5 file, or its folder.", show_default=False),
]


def pack(
    path: DatasetArgument,
    *,
    out: Annotated[
        Path | None,
        typer.Option(metavar="NEW.h5", help="The new file (default: beside it, NAME.packed.h5)."),
    ] = None,
    level: Annotated[int, typer.Option(min=1, max=9, help="1 is fast, 9 is small.")] = 4,
    all_rows: Annotated[
        bool,
        typer.Option(
            "--all-rows", help="Keep what was superseded, too, of shots that were taken again."
        ),
    ] = False,
) -> None:
    """Make one compressed file of a dataset.

    No bit of image, mask or value changes; the journal goes into the file too. It is read back and
    verified before it gets its name.
    """
    from tronlab.campaign.live import open_live
    from tronlab.dataset.location import dataset_in
    from tronlab.dataset.pack import pack as pack_into

    source = dataset_in(path)
    target = out or source.with_name(f"{source.stem}.packed.h5")
    try:
        with open_live(sys.stderr) as live:
            packed = pack_into(
                source,
                target,
                level=level,
                keeps_all_rows=all_rows,
                on_stage=lambda stage, n, n_all: live.advance(stage, n_done=n, n_all=n_all),
            )
    except KeyboardInterrupt:
        typer.echo(f"interrupted: nothing is left of {target}", err=True)
        raise typer.Exit(INTERRUPTED) from None
    typer.echo(packed)
    typer.echo(target)


def migrate(
    path: DatasetArgument,
    *,
    out: Annotated[
        Path | None,
        typer.Option(metavar="NEW.h5", help="The new file (default: beside it, NAME.migrated.h5)."),
    ] = None,
) -> None:
    """Write an older dataset in the layout of today.

    Older layouts are read all the same; nothing needs this to be done.
    """
    from tronlab.campaign.live import open_live
    from tronlab.dataset.location import dataset_in
    from tronlab.dataset.migrate import migrate as migrate_into

    source = dataset_in(path)
    target = out or source.with_name(f"{source.stem}.migrated.h5")
    try:
        with open_live(sys.stderr) as live:
            migrate_into(
                source,
                target,
                on_stage=lambda stage, n, n_all: live.advance(stage, n_done=n, n_all=n_all),
            )
    except KeyboardInterrupt:
        typer.echo(f"interrupted: nothing is left of {target}", err=True)
        raise typer.Exit(INTERRUPTED) from None
    typer.echo(target)


def recompute_truth(
    path: DatasetArgument,
    *,
    calibration: Annotated[
        Path, typer.Option(metavar="RECORD.json", help="The calibration record to compute it with.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="NEW.h5", help="The new file (default: beside it, NAME.recomputed.h5)."
        ),
    ] = None,
    rig: Annotated[
        Path | None,
        typer.Option(
            metavar="RIG.yaml", help="Rig file, needed only where the terrain is a file it names."
        ),
    ] = None,
    accept_calibration: Annotated[
        bool,
        typer.Option(
            "--accept-calibration",
            help="Use a record of another rig or other devices, or one that had expired when the"
            " dataset was recorded; the new dataset says so.",
        ),
    ] = False,
) -> None:
    """Compute truth anew by another calibration.

    Readings and images stay; truth, masks and reference views follow from the record, in a new
    file.
    """
    from tronlab.campaign.live import open_live
    from tronlab.campaign.recompute import recompute_truth as recompute
    from tronlab.dataset.location import dataset_in

    source = dataset_in(path)
    target = out or source.with_name(f"{source.stem}.recomputed.h5")
    with open_live(sys.stderr) as live:
        change = recompute(
            source,
            calibration,
            out=target,
            rig_path=rig,
            is_calibration_accepted=accept_calibration,
            live=live,
        )
    typer.echo(change)
    typer.echo(target)
