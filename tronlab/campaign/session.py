"""A session: one time that somebody records into a dataset, and what changed since the last."""

import os
import socket
from collections.abc import Iterator, Mapping

from tronlab.campaign.continuation import Recorded
from tronlab.campaign.job import Job
from tronlab.dataset.records import Session, SessionKind
from tronlab.dataset.skeleton import utc_now
from tronlab.errors import ChangedError
from tronlab.yaml_variants import recorded_values

_HARMLESS = frozenset({"title", "score", "plan", "retry", "suspend", "recording", "notify"})
"""Sections of a campaign file that a shot looks the same without."""
_COMPARED_BY_CONTENT = frozenset({"trajectory", "rig", "calibration", "seed"})
"""What they lead to is compared: another path to the same rig is no change. The seed stays that of
the last session."""
_BYTES_PER_PIXEL = {"Mono8": 1, "Mono12": 2}
_ANEW = "record a new one: tronlab run CAMPAIGN.yaml --out DIR"


def new_session(
    job: Job,
    *,
    number: int,
    kind: SessionKind,
    software: Mapping[str, str],
    devices: Mapping[str, str],
    accepted: tuple[str, ...],
) -> Session:
    """Describe the session that begins now in this process."""
    return Session(
        number=number,
        kind=kind,
        start_utc=utc_now(),
        campaign_path=str(job.campaign.path.absolute()),
        rig_path=str(job.rig.path.absolute()),
        calibration_path=str(job.calibration_path.absolute()),
        campaign_yaml=job.campaign.whole_text,
        rig_yaml=job.rig.whole_text,
        calibration_json=job.calibration_text,
        plan_sha256=job.plan.sha256,
        seed=job.seed,
        software=software,
        devices=devices,
        host=socket.gethostname(),
        pid=os.getpid(),
        accepted=accepted,
    )


def refuse_changes(last: Session, job: Job) -> None:
    """See that a dataset goes on as it was begun.

    Comments and sections that do not touch the shots may differ.

    Args:
        last: The dataset's last session.
        job: What shall go on.

    Raises:
        ChangedError: Plan, rig or calibration record are others.
    """
    changes = list(_changes(last, job))
    if changes:
        raise ChangedError(
            f"since the last session of the dataset changed: {', '.join(changes)};\n"
            "put back what was there, or record a new dataset: tronlab run CAMPAIGN.yaml --out DIR"
        )


def refuse_other_images(recorded: Recorded, job: Job) -> None:
    """See that images will be as those in the dataset: it has one camera model and one type.

    Raises:
        ChangedError: They will not; nobody can accept that.
    """
    if recorded.camera != job.calibration.camera:
        raise ChangedError(
            f"{job.calibration.source}: has another camera model than the dataset, and a dataset"
            f" has only one; {_ANEW}"
        )
    pixel_format = job.campaign.config.camera.pixel_format
    n_bytes = recorded.image_dtype.itemsize if recorded.image_dtype else None
    if n_bytes not in (None, _BYTES_PER_PIXEL[pixel_format]):
        raise ChangedError(
            f"{job.campaign.path}: camera.pixel_format: {pixel_format}, but the images of the"
            f" dataset are {recorded.image_dtype}, and a dataset has only one type; {_ANEW}"
        )


def _changes(last: Session, job: Job) -> Iterator[str]:
    if last.plan_sha256 != job.plan.sha256:
        yield "the plan (poses of the shots, or the mounting they follow from)"
    campaign_yaml, rig_yaml = job.campaign.whole_text, job.rig.whole_text
    if last.campaign_yaml != campaign_yaml:
        before, now = recorded_values(last.campaign_yaml), recorded_values(campaign_yaml)
        for name in sorted((before.keys() | now.keys()) - _HARMLESS - _COMPARED_BY_CONTENT):
            if before.get(name) != now.get(name):
                yield f"{name} of the campaign"
    # Comments and the way the keys are spread over files that extend each other do not count.
    if last.rig_yaml != rig_yaml and recorded_values(last.rig_yaml) != recorded_values(rig_yaml):
        yield f"the rig ({job.rig.path})"
    if last.calibration_json != job.calibration_text:
        yield f"the calibration record ({job.calibration.source})"
