"""The command ``tronlab render``."""

import sys
import time
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tronlab.cli.exit_codes import INTERRUPTED

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tronlab.campaign.job import Job
    from tronlab.campaign.live import Live
    from tronlab.campaign.rendering import Scene
    from tronlab.render.renderer import Renderer
    from tronlab.render.settings import RenderedImages
    from tronlab.terrain.heightmap import HeightMap
    from tronlab.twin.world import WorldSetup


class Images(Enum):
    """Which images of a campaign."""

    LABORATORY = "laboratory"
    DATABASE = "database"
    BOTH = "both"


def render(
    campaign: Annotated[Path, typer.Argument(metavar="CAMPAIGN.yaml", help="Campaign file.")],
    *,
    rig: Annotated[
        Path | None,
        typer.Option(metavar="RIG.yaml", help="Rig file instead of the one the campaign names."),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(
            metavar="RECORD.json",
            help="Calibration record instead of the one the campaign names.",
        ),
    ] = None,
    renderer: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="heightfield, reference, mitsuba, cycles or another installed one, instead of"
            " those that campaign and rig name.",
        ),
    ] = None,
    every_n: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=100,
            help="Take every so many samples of the terrain alone: mitsuba and cycles keep a mesh"
            " of it, 10 and 20 GB for 37 million samples.",
        ),
    ] = None,
    images: Annotated[
        Images, typer.Option(help="What the simulated camera sees, what the database has, or both.")
    ] = Images.BOTH,
    shots: Annotated[
        str | None,
        typer.Option(
            metavar="LIST",
            help="Both from the poses of these shots, as 3,7-9 (default: the laboratory's from"
            " every shot, the database's from its reference views).",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder of the images, new or empty (default: out/NAME-images).",
        ),
    ] = None,
    accept_calibration: Annotated[
        bool,
        typer.Option(
            "--accept-calibration",
            help="Use a calibration record that has expired or is of another rig.",
        ),
    ] = False,
) -> None:
    """Render a campaign's images without taking it.

    From the nominal poses: what the camera of the simulated laboratory sees, without noise, and
    what the database has, each with depth and poses. `database.renderer` of the campaign and
    `world.surface.renderer` of the rig say who renders them in a run, too.
    """
    from tronlab.campaign.acceptance import Acceptance
    from tronlab.campaign.continuation import parse_shot_ids
    from tronlab.campaign.job import DEFAULT_OUT_DIR, Files, read_job
    from tronlab.campaign.live import open_live
    from tronlab.campaign.rendering import check_new_folder
    from tronlab.render.registry import check_renderer

    shot_ids = None if shots is None else parse_shot_ids(shots)
    if renderer is not None:
        check_renderer(renderer)
    folder: Path | None = None
    try:
        with open_live(sys.stderr) as live:
            acceptance = Acceptance(accept_calibration, warn=live.announce)
            job = read_job(Files(campaign, rig, calibration), seed=None, acceptance=acceptance)
            folder = check_new_folder(out or DEFAULT_OUT_DIR / f"{job.campaign.name}-images")
            choice = _Choice(renderer, every_n)
            scenes = _Scenes(job, live, choice=choice, shot_ids=shot_ids)
            lines = [_render(scene, folder / scene.name, live) for scene in scenes.of(images)]
    except KeyboardInterrupt:
        is_begun = folder is not None and any(folder.glob("*/depth"))
        so_far = f": radiance and depth of the views so far are in {folder}" if is_begun else ""
        typer.echo(f"interrupted{so_far}", err=True)
        raise typer.Exit(INTERRUPTED) from None
    for line in lines:
        typer.echo(line)


@dataclass(frozen=True)
class _Choice:
    """Who shall render, instead of what the files say."""

    renderer: str | None
    every_n: int | None

    def over(self, said: "RenderedImages") -> tuple[str, int]:
        """Give renderer and every_n."""
        return self.renderer or said.renderer, self.every_n or said.every_n


class _Scenes:
    """What can be rendered of a campaign; renderers are shared where they are the same."""

    def __init__(
        self,
        job: "Job",
        live: "Live",
        *,
        choice: _Choice,
        shot_ids: "Sequence[int] | None",
    ) -> None:
        self._job = job
        self._live = live
        self._choice = choice
        self._shot_ids = shot_ids
        self._heightmap = job.rig.load_heightmap(live.announce)
        self._renderers: dict[tuple[str, int, int], Renderer] = {}

    def of(self, images: Images) -> "list[Scene]":
        """Give the scenes of these images."""
        scenes: list[Scene] = []
        if images is not Images.DATABASE:
            setup = self._job.rig.world_setup(lambda: self._heightmap)
            if setup is not None:
                scenes.append(self._laboratory(setup))
            else:
                self._miss_world(images)
        if images is not Images.LABORATORY:
            scenes.append(self._database())
        return scenes

    def _miss_world(self, images: Images) -> None:
        from tronlab.errors import ConfigError

        lack = f"{self._job.rig.path} has no simulated laboratory (section world)"
        if images is Images.LABORATORY:
            raise ConfigError(f"--images laboratory: {lack}; take --images database")
        self._live.announce(f"{lack}: only the database's images are rendered")

    def _database(self) -> "Scene":
        from tronlab.campaign.rendering import Scene, database_poses, poses_of

        job, config = self._job, self._job.database_images
        name, every_n = self._choice.over(config)
        return Scene(
            name=Images.DATABASE.value,
            renderer=self._renderer(name, every_n, self._heightmap),
            renderer_name=name,
            camera=job.calibration.camera,
            poses=database_poses(job) if self._shot_ids is None else poses_of(job, self._shot_ids),
            lamp=job.lamp,
            settings=config,
        )

    def _laboratory(self, setup: "WorldSetup") -> "Scene":
        from tronlab.campaign.rendering import Scene, poses_of
        from tronlab.twin.world import World

        job = self._job
        world, surface = World(setup), setup.config.surface
        name, every_n = self._choice.over(surface)
        targets = {shot.shot_id: shot.robot_target for shot in job.plan.shots}
        return Scene(
            name=Images.LABORATORY.value,
            renderer=self._renderer(name, every_n, setup.load_heightmap()),
            renderer_name=name,
            camera=world.laboratory.camera,
            poses={
                shot_id: world.trs_from_cam_at(targets[shot_id])
                for shot_id in poses_of(job, self._shot_ids)
            },
            lamp=world.lamp,
            settings=surface,
            albedo=surface.albedo,
            stray_radiance=surface.stray_radiance_w_per_m2_sr,
        )

    def _renderer(self, name: str, every_n: int, heightmap: "HeightMap") -> "Renderer":
        from tronlab.render.registry import open_renderer

        key = name, every_n, id(heightmap)
        if key not in self._renderers:
            self._renderers[key] = open_renderer(
                name, heightmap, every_n=every_n, announce=self._live.announce
            )
        return self._renderers[key]


def _render(scene: "Scene", folder: Path, live: "Live") -> str:
    """Render a scene and draw its contact sheet; give the line that says so."""
    from tronlab.campaign.rendering import render_scene
    from tronlab.report.renderings import save_contact_sheet

    stage = f"{scene.name} images"
    live.advance(stage, n_done=0, n_all=len(scene.poses))
    begun_s = time.perf_counter()
    views = render_scene(
        scene, folder, on_view=lambda n_done, n_all: live.advance(stage, n_done=n_done, n_all=n_all)
    )
    each_s = (time.perf_counter() - begun_s) / len(views)
    sheet = save_contact_sheet(
        {f"{view.view_id}: lit {100 * view.lit_fraction:.0f} %": view.image_path for view in views},
        folder,
        title=f"{scene.name}: {scene.renderer_name}",
    )
    return (
        f"{scene.name}: {len(views)} images of {scene.camera.width_px} x {scene.camera.height_px}"
        f" px by {scene.renderer_name}, {each_s:.2f} s each: {folder}; look at {sheet}"
    )
