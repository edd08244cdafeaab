"""Everything a run reads from files, checked against each other before a device is asked."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from scipy.spatial.transform import RigidTransform

from tronlab.calib.record import CalibrationRecord
from tronlab.campaign.acceptance import Acceptance
from tronlab.campaign.config import Campaign, load_campaign
from tronlab.campaign.reference import database_images
from tronlab.campaign.rig import Rig, load_rig
from tronlab.dataset.location import DATASET_NAME
from tronlab.dataset.places import images_folder, journal_path, lock_path, part_of
from tronlab.errors import CalibrationError, ConfigError, PlanError, ScoreError
from tronlab.nav.cores import is_built_in
from tronlab.nav.specs import parse_core
from tronlab.planning.shots import Plan, database_indices, make_plan
from tronlab.render.registry import check_renderer
from tronlab.render.renderer import Lamp, RenderError, lamp_as_designed
from tronlab.render.settings import RenderedImages
from tronlab.trajectory.config import TrajectoryConfig
from tronlab.trajectory.poses import camera_poses
from tronlab.yaml_models import read_text

DEFAULT_OUT_DIR = Path("out")


@dataclass(frozen=True)
class Files:
    """Which files a run shall use; None: those that the campaign names."""

    campaign: Path
    rig: Path | None = None
    calibration: Path | None = None


@dataclass(frozen=True)
class Job:
    """Campaign, rig, calibration record and what follows from them without any device."""

    campaign: Campaign
    rig: Rig
    calibration: CalibrationRecord
    calibration_path: Path
    calibration_text: str
    plan: Plan
    """All shots, in the order of the trajectory."""
    reference_poses: tuple[RigidTransform, ...]
    """``trs_from_cam`` of the reference views."""
    database_images: RenderedImages
    """How these are rendered."""
    seed: int

    @property
    def lamp(self) -> Lamp:
        """Get the lamp where it was measured, of intensity 1."""
        return lamp_as_designed(self.rig.config.laboratory.lamp, self.calibration.p_lamp_trs_m)


def read_job(files: Files, *, seed: int | None, acceptance: Acceptance) -> Job:
    """Read all files, and find every contradiction that needs no device.

    Args:
        files: Which.
        seed: Instead of the campaign's.
        acceptance: Whether a record of another rig, or one that has expired, may serve.

    Raises:
        ConfigError: A file says something that cannot be.
        CalibrationError: The record lacks a part, or should not serve.
        PlanError: There is no shot.
    """
    brought = {"rig": files.rig, "calibration": files.calibration}
    campaign = load_campaign(
        files.campaign, overridden={key for key, path in brought.items() if path is not None}
    )
    rig = load_rig(files.rig or campaign.config.rig)
    calibration_path = files.calibration or campaign.config.calibration
    calibration_text = read_text(calibration_path)
    calibration = CalibrationRecord.from_json(calibration_text, source=str(calibration_path))
    calibration.check_complete()
    acceptance.let_pass(lambda: calibration.check_rig(rig.name))
    acceptance.let_pass(calibration.check_validity)
    _check_image_size(calibration, rig)
    _check_cores(campaign)
    _check_renderers(campaign, rig)
    poses = campaign_poses(campaign)
    plan = make_plan(poses, mounting=calibration.mounting(rig.config.laboratory.mounting))
    return Job(
        campaign=campaign,
        rig=rig,
        calibration=calibration,
        calibration_path=calibration_path,
        calibration_text=calibration_text,
        plan=plan.every(campaign.config.plan.every_n),
        reference_poses=_reference_poses(campaign, poses),
        database_images=_database_images(campaign, calibration),
        seed=campaign.config.seed if seed is None else seed,
    )


def campaign_poses(campaign: Campaign) -> tuple[RigidTransform, ...]:
    """Give ``trs_from_cam`` of every pose of a campaign's trajectory, in their order.

    Raises:
        ConfigError: A pose file cannot be read, or no lander could fly so.
    """
    return _placed_poses(campaign, campaign.config.trajectory)


def _placed_poses(
    campaign: Campaign, trajectory: TrajectoryConfig, *section: str
) -> tuple[RigidTransform, ...]:
    """Give the poses of a trajectory; what cannot be flown is said where the file says so."""
    try:
        return camera_poses(trajectory)
    except ConfigError as error:
        raise campaign.placed(error, *section) from None


def new_dataset_path(out_dir: Path) -> Path:
    """Give where the dataset goes in a folder that is new or empty.

    What a run leaves that was killed before its first shot does not count.

    Raises:
        ConfigError: It is a file, is in use, or cannot be made.
    """
    check_can_be_made(out_dir)
    if (out_dir / DATASET_NAME).exists():
        raise ConfigError(
            f"--out {out_dir}: exists and is not empty, nothing is overwritten; name another folder"
            f" with --out, or go on with that recording: tronlab run --resume {out_dir}"
        )
    path = out_dir / DATASET_NAME
    remnants = {part_of(path), journal_path(path), lock_path(path), images_folder(path)}
    if out_dir.is_dir() and not remnants.issuperset(out_dir.iterdir()):
        raise ConfigError(
            f"--out {out_dir}: exists and is not empty, nothing is overwritten;"
            " name another folder with --out"
        )
    return path


def check_can_be_made(out_dir: Path) -> None:
    """Refuse a folder that is a file, or that cannot be made or written to.

    Raises:
        ConfigError: It is so.
    """
    if out_dir.exists() and not out_dir.is_dir():
        raise ConfigError(f"--out {out_dir}: is a file, expected a folder; name another with --out")
    nearest = next(path for path in (out_dir, *out_dir.absolute().parents) if path.exists())
    if not (nearest.is_dir() and os.access(nearest, os.W_OK)):
        raise ConfigError(
            f"--out {out_dir}: cannot be made, {nearest} is no folder that can be written to;"
            " name another folder with --out"
        )


def _check_cores(campaign: Campaign) -> None:
    """Find a mistyped core before the recording, not when it shall be scored."""
    for i, text in enumerate(campaign.config.score.cores):
        try:
            is_built_in(parse_core(text))
        except ScoreError as error:
            raise campaign.error(str(error), "score", "cores", i) from None


def _check_renderers(campaign: Campaign, rig: Rig) -> None:
    try:
        check_renderer(campaign.config.database.renderer)
    except RenderError as error:
        raise campaign.error(str(error), "database", "renderer") from None
    world = rig.config.world
    try:
        if world is not None:
            check_renderer(world.surface.renderer)
    except RenderError as error:
        raise rig.error(str(error), "world", "surface", "renderer") from None


def _reference_poses(
    campaign: Campaign, poses: Sequence[RigidTransform]
) -> tuple[RigidTransform, ...]:
    """Choose the poses of the reference views: by default of the campaign's own trajectory."""
    database = campaign.config.database
    if database.trajectory is not None:
        poses = _placed_poses(campaign, database.trajectory, "database")
    try:
        chosen = database_indices(len(poses), n_views=database.n_views or len(poses))
    except PlanError as error:
        raise campaign.error(str(error), "database", "n_views") from None
    return tuple(poses[i] for i in chosen)


def _database_images(campaign: Campaign, calibration: CalibrationRecord) -> RenderedImages:
    try:
        return database_images(campaign.config.database, calibration)
    except CalibrationError as error:
        raise campaign.error(str(error), "database", "photometry") from None


def _check_image_size(calibration: CalibrationRecord, rig: Rig) -> None:
    camera = rig.config.laboratory.camera
    calibrated = calibration.camera.width_px, calibration.camera.height_px
    if calibrated != (camera.width_px, camera.height_px):
        raise CalibrationError(
            f"{calibration.source}: the camera was calibrated for images of {calibrated[0]} x"
            f" {calibrated[1]} pixels, but {rig.path} reads out {camera.width_px} x"
            f" {camera.height_px}; calibrate again: tronlab calibrate"
        )
