"""``tronlab database build``: find the landmarks of views and write them to a file."""

import sys
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tronlab.cli.exit_codes import INTERRUPTED

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tronlab.campaign.live import Live
    from tronlab.cli.database_views import Views
    from tronlab.nav.database_writer import DatabaseWriter
    from tronlab.nav.view_spread import Spread


_M_MMAP_THRESHOLD = -3
"""Number of that parameter in ``malloc.h`` of the GNU C library."""
_LARGE_BYTES = 1 << 20


class FeatureKind(Enum):
    """Which detector and descriptor."""

    AKAZE = "akaze"
    BRISK = "brisk"


def build(
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="DATASET|CAMPAIGN.yaml...",
            help="Datasets, whose reference views are taken, and campaigns, whose renderer is.",
            show_default=False,
        ),
    ],
    *,
    out: Annotated[Path, typer.Option(metavar="DB.h5", help="The new file.")],
    features: Annotated[
        FeatureKind, typer.Option(help="Which detector and descriptor.")
    ] = FeatureKind.AKAZE,
    n_max: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Most landmarks kept of a view.  [default: 2000 for AKAZE, 3000 for BRISK]",
        ),
    ] = None,
    threshold: Annotated[
        float | None,
        typer.Option(
            metavar="T", help="Of the detector.  [default: 0.001 for AKAZE, 30 for BRISK]"
        ),
    ] = None,
    poses: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.csv",
            help="Render campaigns at these poses, header x,y,z,qx,qy,qz,qw, instead of at their"
            " database poses.",
        ),
    ] = None,
    views: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=100_000,
            metavar="N",
            help="Render campaigns at so many poses spread over the model.",
        ),
    ] = None,
    range_m: Annotated[
        str,
        typer.Option(
            "--range", metavar="NEAREST:FARTHEST", help="Of spread views: metres to the terrain."
        ),
    ] = "1:5",
    tilt_deg: Annotated[
        float,
        typer.Option(
            "--tilt", metavar="DEG", help="Of spread views: largest angle off the model's normal."
        ),
    ] = 30.0,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Of spread views.")] = 0,
    accept_calibration: Annotated[
        bool,
        typer.Option(
            "--accept-calibration",
            help="Use a calibration record that has expired or is of another rig.",
        ),
    ] = False,
) -> None:
    """Find the landmarks of views and write them to a file for ``tronlab score --database``.

    Views are taken one by one: memory does not grow with their number.
    """
    from tronlab.campaign.live import open_live
    from tronlab.cli.database_views import Choice, check_choice, open_views
    from tronlab.dataset.places import check_is_new
    from tronlab.nav.database_writer import new_database
    from tronlab.nav.settings import DetectorSettings
    from tronlab.yaml_models import parse_mapping

    detector = parse_mapping(
        {"features": features.value, "n_max": n_max, "threshold": threshold},
        DetectorSettings,
        key="detector",
    )
    choice = Choice(poses, _spread(poses, views, range_m, tilt_deg=tilt_deg, seed=seed))
    check_choice(sources, choice)
    check_is_new(out)
    _keep_large_arrays_off_the_heap()
    try:
        with open_live(sys.stderr) as live:
            opened = [
                open_views(path, choice, live=live, accepts=accept_calibration) for path in sources
            ]
            _check_rigs(opened, live)
            with new_database(out, detector) as writer:
                _find_landmarks(opened, writer, live)
    except KeyboardInterrupt:
        typer.echo(f"interrupted: nothing is left of {out}", err=True)
        raise typer.Exit(INTERRUPTED) from None
    typer.echo(
        f"{out}: {writer.n_landmarks} landmarks from {writer.n_views} views;"
        f" use it: tronlab score DATASET.h5 --database {out}"
    )


def _keep_large_arrays_off_the_heap() -> None:
    """Have memory of freed images returned, where the C library can: holes in the heap add up."""
    import ctypes

    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_MMAP_THRESHOLD, _LARGE_BYTES)


def _spread(
    poses: Path | None, views: int | None, range_m: str, *, tilt_deg: float, seed: int
) -> "Spread | None":
    from math import radians

    from tronlab.errors import ConfigError
    from tronlab.nav.view_spread import Spread

    if views is None:
        return None
    if poses is not None:
        raise ConfigError("--poses and --views: say one of the two where to look from")
    nearest, _, farthest = range_m.partition(":")
    try:
        span_m = float(nearest), float(farthest)
    except ValueError:
        raise ConfigError(
            f"--range {range_m}: must be NEAREST:FARTHEST in metres, as 1:5"
        ) from None
    return Spread(views, span_m, radians(tilt_deg), seed)


def _check_rigs(opened: "Sequence[Views]", live: "Live") -> None:
    rigs = sorted({views.source.rig for views in opened})
    if len(rigs) > 1:
        live.announce(
            f"views of several rigs are put together ({', '.join(rigs)}): that is right only if"
            " all have the same terrain in the same frame trs"
        )


def _find_landmarks(opened: "Sequence[Views]", writer: "DatabaseWriter", live: "Live") -> None:
    from tronlab.nav.database import landmarks_of_view
    from tronlab.nav.features import make_detector

    detector = make_detector(writer.detector)
    n_all = sum(views.n_views for views in opened)
    live.advance("views", n_done=0, n_all=n_all)
    for source, views in enumerate(opened):
        writer.sources.append(views.source)
        for view in views.read():
            found = landmarks_of_view(view, views.camera, detector)
            writer.add(view.trs_from_cam, found, source=source)
            live.advance("views", n_done=writer.n_views, n_all=n_all)
