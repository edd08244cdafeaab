"""What the figures of a study show besides scores: trajectories, poses and the model's mask."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.campaign.acceptance import Acceptance
from tronlab.campaign.job import Files, Job, read_job
from tronlab.campaign.reference import GreyScale
from tronlab.dataset.location import DATASET_NAME
from tronlab.dataset.reader import Dataset
from tronlab.geometry.poses import FloatArray
from tronlab.render.mask import model_mask
from tronlab.render.registry import open_renderer
from tronlab.report.study.gallery import MaskedView, Scenery
from tronlab.report.trajectory_scene import ModelOutline
from tronlab.study.config import DatasetName
from tronlab.study.recording import recording_of
from tronlab.study.steps import Desk
from tronlab.study.study import Study
from tronlab.terrain.heightmap import HeightMap
from tronlab.trajectory.config import PoweredDescent
from tronlab.trajectory.descent import fly
from tronlab.trajectory.poses import camera_poses

_STRAIGHT_LINE: DatasetName = "dataset_0"
_WIDE_NOMINAL: DatasetName = "dataset_1_nominal"
"""The set of the lens that figure 6 is taken with."""

_Poses = Sequence[RigidTransform]


def scenery_of(study: Study, desk: Desk, datasets: Sequence[str]) -> Scenery:
    """Gather what the figures show of some datasets that were recorded.

    Args:
        study: The study.
        desk: Its folder, and who is told of slow steps.
        datasets: Those that have scores; at least one.

    Raises:
        TronlabError: A file of the study is damaged.
    """
    jobs: dict[DatasetName, Job] = {
        name: _job_of(study, desk, name) for name in study.datasets if name in datasets
    }
    flown = {name: camera_poses(job.campaign.config.trajectory) for name, job in jobs.items()}
    leading = jobs.get(_WIDE_NOMINAL, next(iter(jobs.values())))
    heightmap = leading.rig.load_heightmap(desk.live.announce)
    nominal = [pose for name, poses in flown.items() if name.endswith("_nominal") for pose in poses]
    has_view = _WIDE_NOMINAL in jobs
    line = flown.get(_STRAIGHT_LINE)
    return Scenery(
        model=_outline(heightmap),
        flown={name: _positions_m(poses) for name, poses in flown.items()},
        taken=_taken(study, desk, list(jobs)),
        first_pose=line[0] if line else None,
        first_view=_first_view(leading, heightmap, nominal, desk) if has_view else None,
        rejected=_rejected(jobs),
    )


def _job_of(study: Study, desk: Desk, dataset: DatasetName) -> Job:
    """Read the files that a dataset was recorded with."""
    campaign = desk.out / "campaigns" / recording_of(study, dataset).slug
    # The dataset is there: whether its calibration record may serve was settled before.
    acceptance = Acceptance(is_given=True, warn=desk.live.announce)
    return read_job(Files(campaign), seed=None, acceptance=acceptance)


def _taken(study: Study, desk: Desk, datasets: Sequence[DatasetName]) -> dict[str, FloatArray]:
    paths = {name: study.dataset_folder(desk.out, name) / DATASET_NAME for name in datasets}
    return {name: _true_positions_m(path) for name, path in paths.items() if path.exists()}


def _true_positions_m(path: Path) -> FloatArray:
    with Dataset(path) as dataset:
        return _positions_m([dataset.truth(i).trs_from_cam for i in range(dataset.n_shots)])


def _first_view(job: Job, heightmap: HeightMap, nominal: _Poses, desk: Desk) -> MaskedView:
    """Render what the wide lens sees from the first, highest point of the nominal trajectory."""
    pose = max(nominal, key=lambda trs_from_cam: float(trs_from_cam.translation[2]))
    config, camera = job.database_images, job.calibration.camera
    renderer = open_renderer(
        config.renderer, heightmap, every_n=config.every_n, announce=desk.live.announce
    )
    (rendering,) = renderer.render_batch(camera, [pose], job.lamp, config)
    return MaskedView(
        image=GreyScale.of([rendering.radiance]).grey(rendering.radiance),
        mask=model_mask(heightmap, camera, pose),
        told=(
            "from the first point of the nominal trajectory,"
            f" {pose.translation[2]:.1f} m above the model, rendered as the database is"
        ),
    )


def _rejected(jobs: Mapping[DatasetName, Job]) -> dict[str, int]:
    trajectories = {name: job.campaign.config.trajectory for name, job in jobs.items()}
    return {
        name: len(fly(trajectory).rejected)
        for name, trajectory in trajectories.items()
        if isinstance(trajectory, PoweredDescent) and trajectory.perturbed is not None
    }


def _outline(heightmap: HeightMap) -> ModelOutline:
    x_m, y_m = (float(value) for value in heightmap.origin_trs_m[:2])
    return ModelOutline((x_m, y_m, heightmap.mean_height_trs_m), heightmap.size_m)


def _positions_m(poses: _Poses) -> FloatArray:
    return np.array([pose.translation for pose in poses], dtype=np.float64).reshape(-1, 3)
