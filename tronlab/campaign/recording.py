"""One session of a run: devices, references, shots, and the dataset they go to."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from tronlab.campaign.acceptance import Acceptance
from tronlab.campaign.accuracy import describe_accuracy
from tronlab.campaign.brightness import LightModel
from tronlab.campaign.chronicle import Chronicle, Scope
from tronlab.campaign.console import Console
from tronlab.campaign.continuation import Recorded
from tronlab.campaign.drift import Vigil, begin_vigil, n_checks, open_watch
from tronlab.campaign.engine import run_shots
from tronlab.campaign.foresight import Foresight
from tronlab.campaign.job import Job
from tronlab.campaign.live import Live
from tronlab.campaign.notify import Notifier
from tronlab.campaign.provenance import device_identities, software_versions
from tronlab.campaign.reference import database_renderer, render_references
from tronlab.campaign.session import new_session
from tronlab.campaign.shot import ShotTaker, TruthSource
from tronlab.campaign.stop import StopRequest, stopped_by_ctrl_c
from tronlab.dataset.journal import Journal
from tronlab.dataset.records import (
    Provenance,
    ReferenceView,
    Session,
    SessionKind,
)
from tronlab.dataset.writer import DatasetWriter
from tronlab.devices.registry import Devices, connected
from tronlab.planning.shots import Plan, Shot, check_reach

_SPARE_ROWS = 32
"""Room in the dataset for shots that are taken again during the run."""
_SPARE_CHECKS = 8
"""Likewise for drift checks: whoever has shots taken again after the last one gets another."""


@dataclass(frozen=True)
class Assignment:
    """What a session shall record, and where."""

    job: Job
    foresight: Foresight
    dataset_path: Path
    kind: SessionKind
    shots: tuple[Shot, ...]
    """To take, in this order; none is left if a run was killed after its last shot."""
    acceptances: tuple[Acceptance, ...]
    """The first one is about the calibration record."""
    recorded: Recorded | None = None
    """What is in the dataset already; None: it is a new one."""

    @property
    def number(self) -> int:
        """Get the number of the session."""
        return 1 + (len(self.recorded.sessions) if self.recorded else 0)

    @property
    def scope(self) -> Scope:
        """Get which shots the dataset shall have, and which of them now."""
        planned = frozenset(shot.shot_id for shot in self.job.plan.shots)
        to_take = frozenset(shot.shot_id for shot in self.shots)
        if self.recorded is None:
            return Scope(planned, to_take)
        recorded = self.recorded.shot_ids
        if self.recorded.status == "complete":  # what is missing was left out on purpose
            return Scope(planned | recorded, to_take)
        looked_at = {shot.shot.shot_id for shot in self.foresight.assessment.shots}
        return Scope(planned | recorded, to_take, planned - recorded - looked_at)

    @property
    def accepted(self) -> tuple[str, ...]:
        """Get everything that was accepted, one line each."""
        return tuple(line for acceptance in self.acceptances for line in acceptance.accepted)


def record(
    assignment: Assignment, *, live: Live, stop: StopRequest, console: Console | None
) -> None:
    """Take the shots of a session.

    Raises:
        TronlabError: As ``run_campaign``.
        CampaignInterrupted: Stopped by a person.
    """
    job = assignment.job
    live.announce(f"rig '{job.rig.name}': connecting devices")
    devices = job.rig.open_devices(
        job.seed,
        # another session of simulated devices has other noise
        session="run" if assignment.number == 1 else f"run, session {assignment.number}",
        load_heightmap=lambda: assignment.foresight.heightmap,
    )
    _go_on_in_time(assignment.recorded, devices)
    with connected(devices):
        session = _begin_session(assignment, devices)
        vigil = _vigil(assignment, devices, live)
        session = replace(session, accepted=assignment.accepted)
        _record(assignment, devices, session, vigil, live=live, stop=stop, console=console)


def _go_on_in_time(recorded: Recorded | None, devices: Devices) -> None:
    """Let a simulated laboratory go on where it was: its time begins anew in every process."""
    if recorded is not None and devices.clock.is_simulated:
        devices.clock.advance(max(0.0, recorded.last_time_s - devices.clock.now_s))


def _begin_session(assignment: Assignment, devices: Devices) -> Session:
    """Find out who answers, and whether they can do what is planned, before anything moves."""
    job = assignment.job
    identities = device_identities(devices)
    assignment.acceptances[0].let_pass(lambda: job.calibration.check_devices(identities))
    check_reach(assignment.shots, devices.robot)
    camera = job.campaign.config.camera
    devices.camera.configure(
        exposure_s=camera.exposure_s, gain_db=camera.gain_db, pixel_format=camera.pixel_format
    )
    return new_session(
        job,
        number=assignment.number,
        kind=assignment.kind,
        software=software_versions(),
        devices={name: str(identity) for name, identity in identities.items()},
        accepted=(),
    )


def _vigil(assignment: Assignment, devices: Devices, live: Live) -> Vigil | None:
    """Begin to watch for drift, if the campaign wants it and the record allows it."""
    job = assignment.job
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
        assignment.acceptances[0],
        on_retry=lambda attempt, error: live.announce(f"drift check, attempt {attempt}: {error}"),
        retry=job.campaign.config.retry,
        sleep=devices.clock.advance,
    )
    if vigil.first.is_within:
        live.announce(watch.describe(vigil.first))
    return vigil


def _record(
    assignment: Assignment,
    devices: Devices,
    session: Session,
    vigil: Vigil | None,
    *,
    live: Live,
    stop: StopRequest,
    console: Console | None,
) -> None:
    job, path = assignment.job, assignment.dataset_path
    views = () if assignment.recorded else _references(assignment, live)
    taker = _taker(assignment, devices, vigil, warn=live.announce)
    notifier = Notifier(
        job.campaign.config.notify, campaign=job.campaign.name, dataset=path, warn=live.announce
    )
    with notifier, _open_writer(assignment, session, vigil) as writer:
        chronicle = Chronicle(writer, Journal(path), live, notifier, scope=assignment.scope)
        if views:
            writer.add_references(views)
        with (
            chronicle.of_session(session, taker),
            stopped_by_ctrl_c(stop, announce=live.announce, can_pause=console is not None),
        ):
            drift = vigil and vigil.checks(writer.commit_drift, announce=live.announce)
            if assignment.shots:
                live.expect(
                    {
                        shot.shot.shot_id: shot.duration.move_s
                        for shot in assignment.foresight.assessment.shots
                    }
                )
                devices.room.switch_lamp(on=True)
                outcome = run_shots(
                    Plan(assignment.shots),
                    taker,
                    commit=chronicle.commit,
                    drift=drift,
                    stop=stop,
                    listener=chronicle.listener,
                    console=console,
                    free_bytes=lambda: shutil.disk_usage(path.parent).free,
                    n_spare_rows=_SPARE_ROWS,
                )
                chronicle.note_skipped(outcome.skipped)
    if path.exists():
        live.announce(describe_accuracy(path))


def _taker(
    assignment: Assignment, devices: Devices, vigil: Vigil | None, *, warn: Callable[[str], None]
) -> ShotTaker:
    job, foresight = assignment.job, assignment.foresight
    calibration, config = job.calibration, job.campaign.config
    taker = ShotTaker(
        devices=devices,
        config=config,
        truth_source=TruthSource(
            calibration,
            foresight.heightmap,
            foresight.renderer,
            job.rig.config.terrain.registration,
        ),
        drift_watch=vigil and vigil.watch,
        light=LightModel(
            renderer=foresight.renderer,
            heightmap=foresight.heightmap,
            camera=calibration.camera,
            lamp=job.lamp,
            photometry=job.database_images.photometry,
        ),
        warn=warn,
        session=assignment.number,
    )
    if assignment.recorded is not None:
        for quality, range_los_m in assignment.recorded.standard:
            taker.gate.learn(quality, range_los_m=range_los_m)
    return taker


def _open_writer(assignment: Assignment, session: Session, vigil: Vigil | None) -> DatasetWriter:
    """Begin a dataset, or make room in one that is there."""
    segment_shots = assignment.job.campaign.config.recording.segment_shots
    n_rows = len(assignment.shots) + _SPARE_ROWS
    if assignment.recorded is not None:
        writer = DatasetWriter.reopen(
            assignment.dataset_path,
            session,
            n_rows=n_rows,
            segment_shots=segment_shots,
            n_shots_planned=len(assignment.scope.planned),
        )
    else:
        writer = DatasetWriter(
            assignment.dataset_path,
            provenance_of(assignment, session),
            session=session,
            segment_shots=segment_shots,
            n_spare_rows=_SPARE_ROWS,
        )
    if vigil is not None:
        n_planned = n_checks(n_rows, vigil.watch.config) + _SPARE_CHECKS
        writer.plan_drift_checks(vigil.watch.reflectors, n_planned)
    return writer


def provenance_of(assignment: Assignment, session: Session) -> Provenance:
    """Say where a new dataset comes from."""
    job = assignment.job
    return Provenance(
        campaign_name=job.campaign.name,
        campaign_yaml=job.campaign.whole_text,
        rig_name=job.rig.name,
        rig_yaml=job.rig.whole_text,
        calibration_json=job.calibration_text,
        seed=job.seed,
        software=dict(session.software),
        devices=dict(session.devices),
        plan_sha256=job.plan.sha256,
        n_shots_planned=len(job.plan.shots),
        camera=job.calibration.camera,
        accepted=session.accepted,
    )


def _references(assignment: Assignment, live: Live) -> tuple[ReferenceView, ...]:
    job, foresight = assignment.job, assignment.foresight
    config = job.database_images
    live.announce("renderer: getting ready; its first use after an installation compiles")
    live.advance("reference views", n_done=0, n_all=len(job.reference_poses))
    return render_references(
        job.reference_poses,
        heightmap=foresight.heightmap,
        renderer=database_renderer(
            config, foresight.heightmap, at_hand=foresight.renderer, announce=live.announce
        ),
        camera=job.calibration.camera,
        lamp=job.lamp,
        config=config,
        on_view=lambda n_done, n_all: live.advance("reference views", n_done=n_done, n_all=n_all),
    )
