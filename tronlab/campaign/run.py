"""Run a campaign: from its YAML file to a recorded dataset, in one session or several."""

from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path

from tronlab.campaign.acceptance import Acceptance
from tronlab.campaign.chronicle import CampaignInterrupted
from tronlab.campaign.console import Console
from tronlab.campaign.continuation import (
    GivenFiles,
    Recorded,
    chosen_shots,
    dataset_in,
    failed_shots,
    files_of,
    missing_shots,
    read_recorded,
)
from tronlab.campaign.foresight import Foresight, foresee, refuse
from tronlab.campaign.job import DEFAULT_OUT_DIR, Files, Job, new_dataset_path, read_job
from tronlab.campaign.live import Live, SilentLive
from tronlab.campaign.recording import Assignment, record
from tronlab.campaign.session import refuse_changes, refuse_other_images
from tronlab.campaign.stop import StopRequest
from tronlab.dataset.lock import run_lock
from tronlab.dataset.records import SessionKind
from tronlab.errors import ConfigError
from tronlab.planning.shots import Shot
from tronlab.planning.summary import brief_summary
from tronlab.trajectory.config import PoweredDescent
from tronlab.trajectory.descent import fly
from tronlab.trajectory.summary import describe_rejected

__all__ = ["CampaignInterrupted", "resume_campaign", "retake_shots", "run_campaign"]


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
    console: Console | None = None,
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
        console: Who is asked when the run is paused; without one it ends instead.

    Returns:
        Path of the dataset.

    Raises:
        ConfigError: A file says something that cannot be, or ``out_dir`` is in use.
        CalibrationError: The calibration record lacks a part, has expired, is of another rig or
            other devices, or its reflectors have moved: before the run, or beyond
            ``drift.limit_m`` while it went on; the dataset then has status ``failed``.
        PlanError: The plan is empty, or shots of it cannot be taken.
        DeviceError: A device failed; the dataset has status ``failed`` and is readable.
        DatasetError: A shot could not be written, or another process writes this dataset.
        CampaignInterrupted: Stopped by a person; the dataset has status ``aborted``.
    """
    live = live or SilentLive()
    acceptance = Acceptance(is_calibration_accepted, warn=live.announce)
    files = Files(campaign_path, rig_path, calibration_path)
    job = read_job(files, seed=seed, acceptance=acceptance)
    _tell_of_rejected_starts(job, live)
    path = new_dataset_path(out_dir or DEFAULT_OUT_DIR / job.campaign.name)
    with _folder(path.parent), run_lock(path):
        foresight = _foresee(job, job.plan.shots, live)
        record(
            Assignment(
                job=job,
                foresight=foresight,
                dataset_path=path,
                kind="run",
                shots=foresight.plan.shots,
                acceptances=(acceptance,),
            ),
            live=live,
            stop=stop or StopRequest(),
            console=console,
        )
    return path


def resume_campaign(
    folder: Path,
    *,
    files: GivenFiles | None = None,
    is_calibration_accepted: bool = False,
    are_changes_accepted: bool = False,
    live: Live | None = None,
    stop: StopRequest | None = None,
    console: Console | None = None,
) -> Path:
    """Take the shots that are missing in a dataset: none is lost, none is there twice.

    Args:
        folder: Of the dataset.
        files: To use instead of those of the dataset's last session.
        is_calibration_accepted: As for ``run_campaign``.
        are_changes_accepted: Whether to go on although plan, rig or calibration record are not
            what they were; the dataset says so.
        live: Shows the run.
        stop: How another thread stops the run.
        console: Who is asked when the run is paused.

    Returns:
        Path of the dataset.

    Raises:
        ChangedError: Plan, rig or calibration record are not what they were.
        ConfigError: There is no dataset, a file of it is not there any more, or as above.
        TronlabError: As ``run_campaign``.
    """
    return _go_on(
        folder,
        "resume",
        lambda job, recorded: missing_shots(job.plan, recorded),
        files=files or GivenFiles(),
        is_calibration_accepted=is_calibration_accepted,
        are_changes_accepted=are_changes_accepted,
        live=live or SilentLive(),
        stop=stop or StopRequest(),
        console=console,
    )


def retake_shots(
    folder: Path,
    shot_ids: Sequence[int] | None,
    *,
    files: GivenFiles | None = None,
    is_calibration_accepted: bool = False,
    are_changes_accepted: bool = False,
    live: Live | None = None,
    stop: StopRequest | None = None,
    console: Console | None = None,
) -> Path:
    """Take shots of a dataset again; the new ones count, the old ones stay in the file.

    Args:
        folder: Of the dataset.
        shot_ids: Which; None: those that are missing, and those a quality gate flagged.
        files: As for ``resume_campaign``, likewise the others.
        is_calibration_accepted: Likewise.
        are_changes_accepted: Likewise.
        live: Likewise.
        stop: Likewise.
        console: Likewise.

    Returns:
        Path of the dataset.

    Raises:
        PlanError: The plan has no such shot, or as ``resume_campaign``.
    """

    def choose(job: Job, recorded: Recorded) -> tuple[Shot, ...]:
        if shot_ids is None:
            return failed_shots(job.plan, recorded)
        return chosen_shots(job.plan, shot_ids)

    return _go_on(
        folder,
        "retake",
        choose,
        files=files or GivenFiles(),
        is_calibration_accepted=is_calibration_accepted,
        are_changes_accepted=are_changes_accepted,
        live=live or SilentLive(),
        stop=stop or StopRequest(),
        console=console,
    )


def _go_on(
    folder: Path,
    kind: SessionKind,
    choose: Callable[[Job, Recorded], tuple[Shot, ...]],
    *,
    files: GivenFiles,
    is_calibration_accepted: bool,
    are_changes_accepted: bool,
    live: Live,
    stop: StopRequest,
    console: Console | None,
) -> Path:
    path = dataset_in(folder)
    with run_lock(path):
        recorded = read_recorded(path)
        calibration = Acceptance(is_calibration_accepted, warn=live.announce)
        changes = Acceptance(are_changes_accepted, live.announce, option="--accept-changes")
        last = recorded.last_session
        job = read_job(files_of(last, files), seed=last.seed, acceptance=calibration)
        refuse_other_images(recorded, job)
        changes.let_pass(lambda: refuse_changes(last, job))
        shots = choose(job, recorded)
        if not shots and recorded.status == "complete":
            live.announce(f"{path}: nothing is left to take")
            return path
        foresight = _foresee(job, shots, live)
        possible = foresight.shots
        wanted = {shot.shot_id for shot in shots}
        if refused := sorted(wanted - {shot.shot_id for shot in possible}):
            live.announce(f"left out, the plan refuses them: {', '.join(map(str, refused))}")
            if not possible and recorded.status == "complete":
                return path
        assignment = Assignment(
            job=job,
            foresight=foresight,
            dataset_path=path,
            kind=kind,
            shots=possible,
            acceptances=(calibration, changes),
            recorded=recorded,
        )
        record(assignment, live=live, stop=stop, console=console)
    return path


def _tell_of_rejected_starts(job: Job, live: Live) -> None:
    """Say which perturbed starts were drawn anew; the descents themselves are found already."""
    trajectory = job.campaign.config.trajectory
    if isinstance(trajectory, PoweredDescent):
        for line in describe_rejected(fly(trajectory)):
            live.announce(line)


def _foresee(job: Job, shots: Sequence[Shot], live: Live) -> Foresight:
    """See, before anything moves, whether all shots of a session can be taken.

    Raises:
        PlanError: One cannot, and the campaign does not want it skipped.
    """
    foresight = foresee(job, shots, live=live, max_tries=0)
    if shots:
        live.announce(brief_summary(foresight.assessment, begun=datetime.now().astimezone()))
    if job.campaign.config.plan.on_refused == "stop":
        refuse(foresight)
    return foresight


@contextmanager
def _folder(folder: Path) -> Generator[None]:
    """Make a folder, and remove it again if nothing came into it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"--out {folder}: cannot be made: {error.strerror}") from error
    try:
        yield
    finally:
        with suppress(OSError):  # there is something in it
            folder.rmdir()
