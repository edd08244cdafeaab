"""``tronlab dataset export|import``: recorded shots for other programs, images of others for us."""

import sys
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from tronlab.cli.dataset_files import DatasetArgument
from tronlab.cli.exit_codes import INTERRUPTED

import_app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    help="Make a dataset of what others recorded.",
)


def export(
    path: DatasetArgument,
    *,
    format_name: Annotated[
        str,
        typer.Option(
            "--format",
            metavar="NAME",
            help="bop: a scene for the BOP toolkit; speedplus: labels as of SPEED+; tum: images and"
            " trajectory as of the TUM RGB-D benchmark, for evo; colmap: a text model; folder: PNG"
            " files and one CSV table, which `import folder` reads back.",
        ),
    ],
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="The new folder; it must not exist yet.")
    ],
) -> None:
    """Write a dataset in a format of others.

    Formats and conventions: docs/reference/exchange.md.
    """
    from tronlab.campaign.live import open_live
    from tronlab.dataset.exchange.export import export as export_to
    from tronlab.dataset.location import dataset_in

    try:
        with open_live(sys.stderr) as live:
            export_to(
                dataset_in(path),
                format_name,
                out,
                on_shot=lambda n_done, n_all: live.advance("shots", n_done=n_done, n_all=n_all),
            )
    except KeyboardInterrupt:
        _say_interrupted(out)
    else:
        typer.echo(out)


_Name = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Name of the dataset.  [default: that of the folder]"),
]
_Out = Annotated[
    Path, typer.Option(metavar="DIR", help="The new folder; the dataset is dataset.h5 in it.")
]


@import_app.command("folder")
def import_folder(
    table: Annotated[
        Path,
        typer.Argument(
            metavar="TABLE.csv",
            help="One row an image: shot_id, image, x_m, y_m, z_m, qx, qy, qz, qw, and what else"
            " docs/reference/exchange.md lists.",
            show_default=False,
        ),
    ],
    *,
    out: _Out,
    camera: Annotated[
        Path | None,
        typer.Option(
            metavar="CAMERA.json", help="Intrinsics.  [default: camera.json beside the table]"
        ),
    ] = None,
    rig: Annotated[
        Path | None,
        typer.Option(
            metavar="RIG.yaml",
            help="Rig whose terrain the images show: gives ranges, masks and reference views that"
            " the table does not bring along.",
        ),
    ] = None,
    name: _Name = None,
) -> None:
    """Make a dataset of a table of images."""
    from tronlab.campaign.importing import import_folder as make
    from tronlab.campaign.live import open_live

    try:
        with open_live(sys.stderr) as live:
            path = make(table, out, name=name, camera_path=camera, rig_path=rig, live=live)
    except KeyboardInterrupt:
        _say_interrupted(out)
    else:
        typer.echo(path)


@import_app.command("tum")
def import_tum(
    images: Annotated[
        Path,
        typer.Argument(
            metavar="IMAGES.txt", help="Rows of: timestamp filename.", show_default=False
        ),
    ],
    trajectory: Annotated[
        Path,
        typer.Argument(
            metavar="TRAJECTORY.txt",
            help="Rows of: timestamp tx ty tz qx qy qz qw; the camera in frame trs, metres.",
            show_default=False,
        ),
    ],
    *,
    camera: Annotated[Path, typer.Option(metavar="CAMERA.json", help="Intrinsics.")],
    rig: Annotated[
        Path, typer.Option(metavar="RIG.yaml", help="Rig whose terrain the images show.")
    ],
    out: _Out,
    max_difference: Annotated[
        float,
        typer.Option(
            metavar="SECONDS", min=0.0, help="Images without a pose so near in time are left out."
        ),
    ] = 0.02,
    offset: Annotated[
        float, typer.Option(metavar="SECONDS", help="Added to the times of the trajectory.")
    ] = 0.0,
    name: _Name = None,
) -> None:
    """Make a dataset of a TUM RGB-D sequence."""
    from tronlab.campaign.importing import import_tum as make
    from tronlab.campaign.live import open_live

    try:
        with open_live(sys.stderr) as live:
            path = make(
                images,
                trajectory,
                camera,
                out,
                rig_path=rig,
                name=name,
                max_difference_s=max_difference,
                offset_s=offset,
                live=live,
            )
    except KeyboardInterrupt:
        _say_interrupted(out)
    else:
        typer.echo(path)


def _say_interrupted(target: Path) -> NoReturn:
    typer.echo(f"interrupted: nothing is left of {target}", err=True)
    raise typer.Exit(INTERRUPTED) from None
