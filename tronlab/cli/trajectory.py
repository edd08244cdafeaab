"""The command ``tronlab trajectory``."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tronlab.cli.exit_codes import INTERRUPTED
from tronlab.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from scipy.spatial.transform import RigidTransform

    from tronlab.campaign.config import Campaign
    from tronlab.campaign.live import Live
    from tronlab.trajectory.descent import DescentSet


def trajectory(
    campaign: Annotated[Path, typer.Argument(metavar="CAMPAIGN.yaml", help="Campaign file.")],
    *,
    rig: Annotated[
        Path | None,
        typer.Option(
            metavar="RIG.yaml",
            help="Rig file instead of the one the campaign names; its terrain is drawn.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="New file of the poses: .csv, as a campaign reads them; .h5, with the states at"
            " full scale (default: none is written).",
        ),
    ] = None,
    plot: Annotated[
        bool,
        typer.Option(
            "--plot",
            help="Draw the poses, and the states of a powered descent, as PNG and PDF beside FILE"
            " (default: out/NAME-trajectory.png); earlier pictures are replaced.",
        ),
    ] = False,
) -> None:
    """Show where a campaign's camera goes; of a powered descent, how the lander flies.

    A powered descent is optimised: table, poses and pictures are of the trajectories that a run of
    the campaign would fly. No device is connected.
    """
    from tronlab.campaign.config import load_campaign
    from tronlab.campaign.live import open_live
    from tronlab.trajectory.files import check_out
    from tronlab.trajectory.poses import camera_poses, trajectory_numbers
    from tronlab.trajectory.summary import describe_descents, describe_poses, poses_by_trajectory

    if out is not None:
        check_out(out)
    lines: list[str] = []
    try:
        with open_live(sys.stderr) as live:
            brought = {"calibration"} if rig is None else {"calibration", "rig"}
            loaded = load_campaign(campaign, overridden=brought)
            descents = _fly(loaded, live)
            poses = camera_poses(loaded.config.trajectory)
            lines.append(describe_poses(poses) if descents is None else describe_descents(descents))
            by_number = poses_by_trajectory(poses, trajectory_numbers(loaded.config.trajectory))
            if plot:
                rig_path = rig or loaded.config.rig
                lines += _draw(loaded, rig_path, by_number, descents, live=live, beside=out)
            if out is not None:
                lines.append(_write(out, by_number, descents))
    except KeyboardInterrupt:
        typer.echo("interrupted: no poses were written", err=True)
        raise typer.Exit(INTERRUPTED) from None
    typer.echo("\n".join(lines))


def _fly(campaign: "Campaign", live: "Live") -> "DescentSet | None":
    """Find the descents of a campaign that has any."""
    from tronlab.trajectory.config import PoweredDescent
    from tronlab.trajectory.descent import fly

    config = campaign.config.trajectory
    if not isinstance(config, PoweredDescent):
        return None
    try:
        return fly(
            config,
            on_descent=lambda n_done, n_all: live.advance("descents", n_done=n_done, n_all=n_all),
        )
    except ConfigError as error:
        raise campaign.placed(error) from None


def _write(
    out: Path, poses: "Mapping[int, Sequence[RigidTransform]]", descents: "DescentSet | None"
) -> str:
    from tronlab.trajectory.files import POSES_SUFFIX, write_poses, write_states

    if out.suffix == POSES_SUFFIX:
        write_poses(out, poses)
        return f"poses: {out}"
    write_states(out, poses, () if descents is None else descents.trajectories)
    return f"poses and states: {out}"


def _draw(
    campaign: "Campaign",
    rig_path: Path,
    poses: "Mapping[int, Sequence[RigidTransform]]",
    descents: "DescentSet | None",
    *,
    live: "Live",
    beside: Path | None,
) -> list[str]:
    """Draw where the camera goes, and how a lander flies; give the lines that say so."""
    from tronlab.campaign.job import DEFAULT_OUT_DIR, check_can_be_made
    from tronlab.campaign.rig import load_rig
    from tronlab.report.style import save_chart
    from tronlab.report.trajectory_charts import descent_states_figure, pose_figure

    folder = DEFAULT_OUT_DIR if beside is None else beside.parent
    stem = campaign.name if beside is None else beside.stem
    check_can_be_made(folder)
    heightmap = load_rig(rig_path).load_heightmap(live.announce)
    live.announce("drawing")
    folder.mkdir(parents=True, exist_ok=True)
    nominal = () if descents is None else descents.nominal.trs_from_cam
    figures = {"trajectory": pose_figure(poses, heightmap, nominal=nominal)}
    if descents is not None:
        figures["states"] = descent_states_figure(descents)
    pictures = [save_chart(figure, folder, f"{stem}-{what}") for what, figure in figures.items()]
    return [f"picture: {path}, and as PDF beside it" for path in pictures]
