"""Where the views of a landmark database come from: a dataset, or a campaign's renderer."""

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from tronlab.campaign.reference import GreyScale
from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import ReferenceView
from tronlab.errors import ConfigError, DatasetError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import pose_from_xyz_quat, xyz_quat_from_pose
from tronlab.nav.database_file import Source
from tronlab.nav.view_spread import Spread, spread_poses
from tronlab.planning.shots import database_indices
from tronlab.render.mask import model_mask

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform

    from tronlab.campaign.job import Job
    from tronlab.campaign.live import Live
    from tronlab.campaign.rendering import Scene
    from tronlab.terrain.heightmap import HeightMap

YAML_SUFFIXES = (".yaml", ".yml")
N_SAMPLED = 12
"""Views that the grey scale is chosen from. With no more than these it is the scale that a run of
the campaign chooses, and a database built from either is the same."""


class Views(Protocol):
    """Reference views that come one after the other."""

    source: Source
    camera: CameraModel
    n_views: int

    def read(self) -> Iterator[ReferenceView]:
        """Give the views, each when it is needed."""
        ...


class DatasetViews:
    """The reference views of a dataset."""

    def __init__(self, path: Path) -> None:
        """Look what the dataset has.

        Raises:
            DatasetError: It cannot be read, or has no reference views.
        """
        self._path = path
        with Dataset(path) as dataset:
            self.n_views = dataset.n_references
            self.camera = dataset.camera
            rig_name = dataset.provenance.rig_name
            identity = dataset.uuid or f"plan {dataset.provenance.plan_sha256}"
        if not self.n_views:
            raise DatasetError(
                f"{path}: has no reference views to find landmarks in; name its campaign instead:"
                " tronlab database build CAMPAIGN.yaml"
            )
        self.source = Source(
            kind="dataset",
            name=path.name,
            identity=identity,
            rig=rig_name,
            camera=self.camera.to_dict(),
            views="reference views of the dataset",
        )

    def read(self) -> Iterator[ReferenceView]:
        """Read the views and verify their checksums."""
        with Dataset(self._path) as dataset:
            for i in range(dataset.n_references):
                yield dataset.reference(i)


@dataclass(frozen=True)
class Choice:
    """Which poses a campaign is rendered from: a file's, a spread, or else its own."""

    poses_path: Path | None
    spread: Spread | None

    @property
    def is_own(self) -> bool:
        """Tell whether the campaign's own database poses are meant."""
        return self.poses_path is None and self.spread is None


class CampaignViews:
    """Views rendered by a campaign's database renderer, with its calibrated camera and lamp."""

    def __init__(self, path: Path, choice: Choice, *, live: "Live", accepts: bool) -> None:
        """Read the campaign, load its terrain and choose the poses.

        Raises:
            TronlabError: A file says what cannot be, or a pose is not possible.
        """
        from tronlab.campaign.acceptance import Acceptance
        from tronlab.campaign.job import Files, read_job

        acceptance = Acceptance(accepts, warn=live.announce)
        self._job = read_job(Files(path), seed=None, acceptance=acceptance)
        self._live = live
        self._heightmap = self._job.rig.load_heightmap(live.announce)
        self._poses, how = _poses(self._job, self._heightmap, choice)
        self.camera = self._job.calibration.camera
        self.n_views = len(self._poses)
        self.source = Source(
            kind="campaign",
            name=path.name,
            identity=_identity(self._job),
            rig=self._job.rig.name,
            camera=self.camera.to_dict(),
            views=how,
        )

    def read(self) -> Iterator[ReferenceView]:
        """Render the views."""
        from tronlab.campaign.rendering import Scene
        from tronlab.render.registry import open_renderer

        config = self._job.database_images
        renderer = open_renderer(
            config.renderer, self._heightmap, every_n=config.every_n, announce=self._live.announce
        )
        scene = Scene(
            name="database",
            renderer=renderer,
            renderer_name=config.renderer,
            camera=self.camera,
            poses=self._poses,
            lamp=self._job.lamp,
            settings=config,
        )
        return render_views(
            scene,
            self._heightmap,
            on_sample=lambda n_done, n_all: self._live.advance(
                "grey scale", n_done=n_done, n_all=n_all
            ),
        )


def open_views(path: Path, choice: Choice, *, live: "Live", accepts: bool) -> Views:
    """Open what a person names as a source of views.

    Raises:
        TronlabError: It cannot serve.
    """
    from tronlab.dataset.location import dataset_in

    if path.suffix.lower() in YAML_SUFFIXES:
        return CampaignViews(path, choice, live=live, accepts=accepts)
    return DatasetViews(dataset_in(path))


def check_choice(paths: Sequence[Path], choice: Choice) -> None:
    """Refuse poses that nobody would render.

    Raises:
        ConfigError: Poses are asked for, and there is no campaign.
    """
    has_campaign = any(path.suffix.lower() in YAML_SUFFIXES for path in paths)
    if not (choice.is_own or has_campaign):
        raise ConfigError(
            "--poses and --views say what a campaign's renderer shall render, and no CAMPAIGN.yaml"
            " is named; the views of a dataset are those it was recorded with"
        )


@dataclass(frozen=True, slots=True)
class _Seen:
    """What is kept of a rendering."""

    radiance: NDArray[np.float32]
    depth_m: NDArray[np.float32]


def render_views(
    scene: "Scene", heightmap: "HeightMap", *, on_sample: Callable[[int, int], None]
) -> Iterator[ReferenceView]:
    """Render views one by one: a sample first, for the grey scale that serves them all.

    The sample waits on disk for its turn, so that memory has room for one view, not for all these.

    Args:
        scene: What to render.
        heightmap: The terrain, for the outline of the model.
        on_sample: Told (views done, views in all) of the sample.

    Raises:
        RenderError: The renderer cannot do what is asked.
        PlanError: No view of the sample shows any lit terrain.
    """
    ids = list(scene.poses)
    sampled = [ids[i] for i in database_indices(len(ids), n_views=min(N_SAMPLED, len(ids)))]
    others = _render(scene, [i for i in ids if i not in sampled])
    with TemporaryFile() as spool:
        scale = _scale(scene, sampled, spool, on_sample)
        spool.seek(0)
        for view_id in ids:
            seen = _Seen(np.load(spool), np.load(spool)) if view_id in sampled else next(others)
            trs_from_cam = scene.poses[view_id]
            is_model = model_mask(heightmap, scene.camera, trs_from_cam)
            yield ReferenceView(
                view_id=view_id,
                # As a dataset stores it: the last bits, too, shall be those of its reference views.
                trs_from_cam=pose_from_xyz_quat(xyz_quat_from_pose(trs_from_cam)),
                image=scale.grey(seen.radiance),
                depth_m=seen.depth_m,
                mask=is_model & np.isfinite(seen.depth_m),
            )


def _scale(
    scene: "Scene", view_ids: Sequence[int], spool: IO[bytes], on_view: Callable[[int, int], None]
) -> GreyScale:
    """Render a sample of the views to disk, and choose the grey scale."""
    radiances: list[NDArray[np.float32]] = []
    for seen in _render(scene, view_ids):
        np.save(spool, seen.radiance)
        np.save(spool, seen.depth_m)
        radiances.append(seen.radiance)
        on_view(len(radiances), len(view_ids))
    return GreyScale.of(radiances)


def _render(scene: "Scene", view_ids: Sequence[int]) -> Iterator[_Seen]:
    poses = [scene.poses[i] for i in view_ids]
    for rendering in scene.renderer.render_batch(scene.camera, poses, scene.lamp, scene.settings):
        yield _Seen(rendering.radiance, rendering.depth_m)


def _poses(
    job: "Job", heightmap: "HeightMap", choice: Choice
) -> "tuple[Mapping[int, RigidTransform], str]":
    """Give the poses by number, and how they were chosen."""
    from tronlab.campaign.rendering import database_poses
    from tronlab.trajectory.poses import read_poses

    if choice.spread is not None:
        spread, (x_m, y_m, _) = choice.spread, heightmap.origin_trs_m
        mean_m = heightmap.mean_height_trs_m
        poses = spread_poses(
            spread,
            corner_trs_m=np.array([x_m, y_m, mean_m]),
            size_m=heightmap.size_m,
            clearance_m=heightmap.statistics.highest_m - heightmap.statistics.mean_m,
        )
        nearest_m, farthest_m = spread.range_m
        how = (
            f"spread over the model, {nearest_m:g} to {farthest_m:g} m, tilted up to"
            f" {np.degrees(spread.max_tilt_rad):g} degrees, seed {spread.seed}"
        )
        return dict(enumerate(poses, start=1)), how
    if choice.poses_path is not None:
        poses = read_poses(choice.poses_path)
        return dict(enumerate(poses, start=1)), f"poses of {choice.poses_path.name}"
    return database_poses(job), "database poses of the campaign"


def _identity(job: "Job") -> str:
    texts = job.campaign.whole_text, job.rig.whole_text, job.calibration_text
    return hashlib.blake2b("\0".join(texts).encode(), digest_size=20).hexdigest()
