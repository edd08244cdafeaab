"""Run a campaign: from its YAML file to a recorded dataset."""

import os
from collections.abc import Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from tronlab.calib.record import CalibrationRecord
from tronlab.campaign.acceptance import Acceptance
from tronlab.campaign.accuracy import describe_accuracy
from tronlab.campaign.config import Campaign, load_campaign
from tronlab.campaign.drift import Vigil, begin_vigil, open_watch
from tronlab.campaign.engine import RunListener, run_shots
from tronlab.campaign.live import Live, SilentLive
from tronlab.campaign.policy import MAX_ATTEMPTS
from tronlab.campaign.provenance import device_identities, software_versions
from tronlab.campaign.reference import render_references
from tronlab.campaign.rig import Rig, load_rig
from tronlab.campaign.shot import ShotTaker, TruthSource
from tronlab.campaign.stop import RunStoppedError, StopRequest, stopped_by_ctrl_c
from tronlab.dataset.records import Provenance, ReferenceView
from tronlab.dataset.writer import DatasetWriter
from tronlab.devices.registry import Devices, connected
from tronlab.errors import CalibrationError, ConfigError, DatasetError, PlanError
from tronlab.nav.cores import known_cores
from tronlab.planning.shots import (
    Plan,
    check_reach,
    check_terrain_in_view,
    database_indices,
    make_plan,
)
from tronlab.render.heightfield import HeightfieldRenderer
from tronlab.render.renderer import Lamp
from tronlab.terrain.heightmap import HeightMap
from tronlab.trajectory.poses import camera_poses
from tronlab.yaml_models import read_text

DATASET_NAME = "dataset.h5"
DEFAULT_OUT_DIR = Path("out")


class CampaignInterrupted(KeyboardInterrupt):  # it is no error that a person stops
    """The run was stopped by a person; the dataset is closed and readable."""


@dataclass(frozen=True)
class _Job:
    """Everything read from files, checked against each other before a device is asked."""

    campaign: Campaign
    rig: Rig
    calibration: CalibrationRecord
    calibration_text: str
    acceptance: Acceptance
    plan: Plan
    reference_indices: tuple[int, ...]
    seed: int
    dataset_path: Path


def run_campaign(
    campaign_path: Path,
    *,
    rig_path: Path | None = None,
    calibration_path: Path | None = None,
    out_dir: Path | None = None,
    seed: int | None = None,
    is_calibration_accepted: bool = False,
    live: Live | None = None,
    stop: StopRequest | None = None,
) -> Path:
    """Record the dataset of a campaign.

    Args:
        campaign_path: The campaign file.
        rig_path: Rig file to use instead of the one the campaign names.
        calibration_path: Calibration record to use instead of the one the campaign names.
        out_dir: Folder of the dataset, new or empty; by default out/NAME of the campaign.
        seed: Instead of the campaign's.
        is_calibration_accepted: Whether to go on with a calibration record that has expired, is of
            another rig or other devices, or whose reflectors have moved; the dataset says so.
        live: Shows the run.
        stop: How another thread stops the run; Ctrl-C does in the main thread.

    Returns:
        Path of the dataset.

    Raises:
        ConfigError: A file says something that cannot be, or ``out_dir`` is in use.
        CalibrationError: The calibration record lacks a part, has expired, is of another rig or
            other devices, or its reflectors have moved: before the run, or beyond
            ``drift.limit_m`` while it went on; the dataset then has status ``failed``.
        PlanError: The plan is empty, or the robot cannot reach a shot.
        DeviceError: A device failed; the dataset has status ``failed`` and is readable.
        DatasetError: A shot could not be written.
        CampaignInterrupted: Stopped by a person; the dataset has status ``aborted``.
    """
    live = live or SilentLive()
    stop = stop or StopRequest()
    job = _read_job(
        campaign_path,
        rig_path=rig_path,
        calibration_path=calibration_path,
        out_dir=out_dir,
        seed=seed,
        acceptance=Acceptance(is_calibration_accepted, warn=live.announce),
    )

    @cache
    def heightmap() -> HeightMap:
        return job.rig.load_heightmap(live.announce)

    live.announce(f"rig '{job.rig.name}': connecting devices")
    devices = job.rig.open_devices(job.seed, load_heightmap=heightmap)
    with connected(devices):
        provenance = _check_devices(job, devices)
        vigil = _vigil(job, devices, live)
        _record(job, devices, provenance, vigil, heightmap=heightmap(), live=live, stop=stop)
    return job.dataset_path


def _read_job(
    campaign_path: Path,
    *,
    rig_path: Path | None,
    calibration_path: Path | None,
    out_dir: Path | None,
    seed: int | None,
    acceptance: Acceptance,
) -> _Job:
    """Read all files, and find every contradiction that needs no device."""
    brought = {"rig": rig_path, "calibration": calibration_path}
    campaign = load_campaign(
        campaign_path, overridden={key for key, path in brought.items() if path is not None}
    )
    dataset_path = _new_dataset_path(out_dir or DEFAULT_OUT_DIR / campaign.name)
    rig = load_rig(rig_path or campaign.config.rig)
    calibration_path = calibration_path or campaign.config.calibration
    calibration_text = read_text(calibration_path)
    calibration = CalibrationRecord.from_json(calibration_text, source=str(calibration_path))
    calibration.check_complete()
    acceptance.let_pass(lambda: calibration.check_rig(rig.name))
    acceptance.let_pass(calibration.check_validity)
    _check_image_size(calibration, rig, source=calibration_path)
    plan = make_plan(
        camera_poses(campaign.config.trajectory),
        mounting=calibration.mounting(rig.config.laboratory.mounting),
    )
    _check_cores(campaign)
    return _Job(
        campaign=campaign,
        rig=rig,
        calibration=calibration,
        calibration_text=calibration_text,
        acceptance=acceptance,
        plan=plan,
        reference_indices=_reference_indices(campaign, len(plan.shots)),
        seed=campaign.config.seed if seed is None else seed,
        dataset_path=dataset_path,
    )


def _check_cores(campaign: Campaign) -> None:
    """Find a mistyped core before the recording, not when it shall be scored."""
    known = known_cores()
    for i, name in enumerate(campaign.config.score.cores):
        if name not in known:
            raise campaign.error(
                f"no navigation core '{name}'; known cores: {', '.join(sorted(known))}",
                "score", "cores", i,
            )  # fmt: skip


def _reference_indices(campaign: Campaign, n_poses: int) -> tuple[int, ...]:
    try:
        return database_indices(n_poses, n_views=campaign.config.database.n_views)
    except PlanError as error:
        raise campaign.error(str(error), "database", "n_views") from None


def _new_dataset_path(out_dir: Path) -> Path:
    if out_dir.exists() and not out_dir.is_dir():
        raise ConfigError(f"--out {out_dir}: is a file, expected a folder; name another with --out")
    if out_dir.is_dir() and any(out_dir.iterdir()):
        raise ConfigError(
            f"--out {out_dir}: exists and is not empty, nothing is overwritten;"
            " name another folder with --out"
        )
    nearest = next(path for path in (out_dir, *out_dir.absolute().parents) if path.exists())
    if not (nearest.is_dir() and os.access(nearest, os.W_OK)):
        raise ConfigError(
            f"--out {out_dir}: cannot be made, {nearest} is no folder that can be written to;"
            " name another folder with --out"
        )
    return out_dir / DATASET_NAME


def _check_image_size(calibration: CalibrationRecord, rig: Rig, *, source: Path) -> None:
    camera = rig.config.laboratory.camera
    calibrated = calibration.camera.width_px, calibration.camera.height_px
    if calibrated != (camera.width_px, camera.height_px):
        raise CalibrationError(
            f"{source}: the camera was calibrated for images of {calibrated[0]} x {calibrated[1]}"
            f" pixels, but {rig.path} reads out {camera.width_px} x {camera.height_px};"
            " calibrate again: tronlab calibrate"
        )


def _check_devices(job: _Job, devices: Devices) -> Provenance:
    """Find out who answers, and whether they can do what is planned, before anything moves."""
    identities = device_identities(devices)
    job.acceptance.let_pass(lambda: job.calibration.check_devices(identities))
    check_reach(job.plan, devices.robot)
    camera = job.campaign.config.camera
    devices.camera.configure(
        exposure_s=camera.exposure_s, gain_db=camera.gain_db, pixel_format=camera.pixel_format
    )
    return Provenance(
        campaign_name=job.campaign.name,
        campaign_yaml=job.campaign.text,
        rig_name=job.rig.name,
        rig_yaml=job.rig.whole_text,
        calibration_json=job.calibration_text,
        seed=job.seed,
        software=software_versions(),
        devices={name: str(identity) for name, identity in identities.items()},
        plan_sha256=job.plan.sha256,
        n_shots_planned=len(job.plan.shots),
        camera=job.calibration.camera,
    )


def _record(
    job: _Job,
    devices: Devices,
    provenance: Provenance,
    vigil: Vigil | None,
    *,
    heightmap: HeightMap,
    live: Live,
    stop: StopRequest,
) -> None:
    live.announce("renderer: preparing the terrain")
    renderer = HeightfieldRenderer(heightmap)
    check_terrain_in_view(job.plan, renderer)
    views = _references(job, heightmap=heightmap, renderer=renderer, live=live)
    taker = ShotTaker(
        devices=devices,
        config=job.campaign.config,
        truth_source=TruthSource(job.calibration, heightmap, renderer),
        drift_watch=vigil and vigil.watch,
        warn=live.announce,
    )
    provenance = replace(provenance, accepted=tuple(job.acceptance.accepted))
    with _writer(job, provenance, taker=taker, live=live) as writer:
        writer.add_references(views)
        drift = vigil and vigil.checks(
            writer, n_shots=len(job.plan.shots), stop=stop, announce=live.announce
        )
        with stopped_by_ctrl_c(stop, announce=live.announce):
            devices.room.switch_lamp(on=True)
            run_shots(
                job.plan,
                taker,
                commit=writer.commit,
                drift=drift,
                stop=stop,
                listener=_listener(writer, len(job.plan.shots), live),
            )
    live.announce(describe_accuracy(job.dataset_path))


def _vigil(job: _Job, devices: Devices, live: Live) -> Vigil | None:
    """Begin to watch for drift, if the campaign wants it and the record allows it."""
    watch = open_watch(
        devices.tracker,
        job.calibration,
        job.campaign.config.drift,
        advice="measure the frame anew: tronlab calibrate frame"
        f" --rig {job.rig.path} --record {job.calibration.source}",
    )
    if watch is None:
        live.announce("drift checks: none, so the truth of no shot is vouched for")
        return None
    vigil = begin_vigil(
        watch,
        job.acceptance,
        on_retry=lambda attempt, error: live.announce(f"drift check, attempt {attempt}: {error}"),
    )
    if vigil.first.is_within:
        live.announce(watch.describe(vigil.first))
    return vigil


def _references(
    job: _Job, *, heightmap: HeightMap, renderer: HeightfieldRenderer, live: Live
) -> tuple[ReferenceView, ...]:
    live.announce("renderer: getting ready; its first use after an installation compiles")
    live.advance("reference views", n_done=0, n_all=len(job.reference_indices))
    return render_references(
        [job.plan.shots[i].trs_from_cam_nominal for i in job.reference_indices],
        heightmap=heightmap,
        renderer=renderer,
        camera=job.calibration.camera,
        lamp=Lamp(p_trs_m=job.calibration.p_lamp_trs_m, intensity=1.0),
        config=job.campaign.config.database,
        on_view=lambda n_done, n_all: live.advance("reference views", n_done=n_done, n_all=n_all),
    )


@contextmanager
def _writer(
    job: _Job, provenance: Provenance, *, taker: ShotTaker, live: Live
) -> Generator[DatasetWriter]:
    """Open the dataset; however the run ends, the file says how."""
    path, n_planned = job.dataset_path, len(job.plan.shots)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"--out {path.parent}: cannot be made: {error.strerror}") from error
    with DatasetWriter(path, provenance) as writer:

        def so_far() -> str:
            return f"{writer.n_committed} of {n_planned} shots are in {path}"

        try:
            yield writer
        except (RunStoppedError, KeyboardInterrupt):
            writer.finish("aborted", reason="stopped by the operator")
            raise CampaignInterrupted(f"stopped: {so_far()}") from None
        except Exception as error:
            with suppress(DatasetError):  # a full disk must not hide why the run failed
                writer.finish("failed", reason=f"{taker.in_hand}: {error}")
            live.announce(f"the run failed at {taker.in_hand}; {so_far()}")
            raise
        writer.finish("complete")
        live.announce(so_far())


def _listener(writer: DatasetWriter, n_all: int, live: Live) -> RunListener:
    live.advance("shots", n_done=0, n_all=n_all)
    return RunListener(
        on_shot=lambda _record: live.advance("shots", n_done=writer.n_committed, n_all=n_all),
        on_retry=lambda task, attempt, error: live.announce(
            f"{task}, attempt {attempt}: {error} (after {MAX_ATTEMPTS} failures the run stops)"
        ),
        on_wait=lambda task, error: live.announce(
            f"waiting before {task}: {error}; the run goes on by itself"
        ),
        on_resume=lambda task: live.announce(f"safe again: {task} goes on"),
    )
