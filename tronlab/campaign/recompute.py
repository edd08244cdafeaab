"""Ground truth computed again from the raw readings of a dataset, with another record."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from hashlib import sha256
from pathlib import Path

import numpy as np

import tronlab
from tronlab.calib.record import CalibrationRecord
from tronlab.campaign.acceptance import Acceptance
from tronlab.campaign.accuracy import sigmas_of
from tronlab.campaign.drift import judge
from tronlab.campaign.live import Live, SilentLive
from tronlab.campaign.recorded import (
    recorded_database,
    recorded_heightmap,
    recorded_lamp,
    recorded_terrain,
)
from tronlab.campaign.reference import database_renderer, render_references
from tronlab.campaign.shot import TruthSource
from tronlab.dataset.drift import spans
from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import (
    DriftRecord,
    Provenance,
    Recomputation,
    ReferenceView,
    Truth,
)
from tronlab.dataset.rewriter import DatasetRewriter, rewritten, sha256_of
from tronlab.dataset.skeleton import utc_now
from tronlab.dataset.summary import calibrated_utc
from tronlab.dataset.transcript import OnStage
from tronlab.devices.readings import DeviceIdentity
from tronlab.errors import CalibrationError, DatasetError
from tronlab.geometry.poses import FloatArray
from tronlab.geometry.uncertainty import pose_difference
from tronlab.render.heightfield import HeightfieldRenderer
from tronlab.terrain.heightmap import HeightMap
from tronlab.yaml_models import read_text


@dataclass(frozen=True, slots=True)
class TruthChange:
    """How far the ground truth of a dataset moved, one value a shot."""

    shift_m: FloatArray
    turn_rad: FloatArray
    shift_sigmas: FloatArray
    """In one sigma of the truth that was replaced; NaN where that claimed to be exact."""
    turn_sigmas: FloatArray

    def __str__(self) -> str:
        """Give median and maximum in a line."""
        if not self.shift_m.size:
            return "truth: there are no shots"
        shift = _median_and_max(self.shift_m * 1e3, "mm", self.shift_sigmas)
        turn = _median_and_max(np.degrees(self.turn_rad), "deg", self.turn_sigmas)
        return f"truth moved by {shift}; turned by {turn}"


def recompute_truth(
    dataset_path: Path,
    calibration_path: Path,
    *,
    out: Path,
    rig_path: Path | None = None,
    is_calibration_accepted: bool = False,
    live: Live | None = None,
) -> TruthChange:
    """Write a copy of a dataset whose truth follows from another calibration record.

    Truth, masks, reference views, the camera model and the verdicts of the drift checks are made
    anew; raw readings and images stay. The record of the recording gives the same truth, bit for
    bit.

    Args:
        dataset_path: The dataset; it stays as it is.
        calibration_path: The calibration record.
        out: The new file.
        rig_path: Where to find the terrain's file, if the recorded rig names one.
        is_calibration_accepted: Whether to use a record of another rig or other devices, or one
            that had expired when the dataset was recorded.
        live: Shows how far it is.

    Raises:
        DatasetError: The dataset cannot be read or is damaged, or ``out`` exists or cannot be made.
        CalibrationError: The record cannot be read, lacks a part, or should not serve.
        ConfigError: The terrain cannot be found.
    """
    live = live or SilentLive()
    text = read_text(calibration_path)
    record = CalibrationRecord.from_json(text, source=str(calibration_path))
    record.check_complete()
    acceptance = Acceptance(is_calibration_accepted, warn=live.announce)
    with Dataset(dataset_path) as dataset:
        _check_dataset(dataset)
        _check_record(record, dataset, acceptance)
        provenance = _provenance(dataset, record, text, tuple(acceptance.accepted))
        heightmap = recorded_heightmap(dataset.provenance, rig_path, announce=live.announce)
        live.announce("renderer: preparing the terrain")
        renderer = HeightfieldRenderer(heightmap)
        with rewritten(dataset_path, out, on_stage=_stages(live)) as rewriter:
            terrain = recorded_terrain(dataset.provenance.rig_yaml)
            source = TruthSource(record, heightmap, renderer, terrain.registration)
            change = _rewrite_shots(dataset, rewriter, source, live)
            if dataset.n_references:
                rewriter.write_references(_views(dataset, record, heightmap, renderer, live))
            _rewrite_drift(dataset, rewriter, record, live)
            rewriter.write_provenance(provenance)
    return change


def _stages(live: Live) -> OnStage:
    return lambda stage, n_done, n_all: live.advance(stage, n_done=n_done, n_all=n_all)


def _check_dataset(dataset: Dataset) -> None:
    """Refuse a dataset whose truth cannot follow from one record.

    Raises:
        DatasetError: It was imported, or its sessions were calibrated differently.
    """
    if any(session.kind == "import" for session in dataset.sessions):
        raise DatasetError(
            f"{dataset.path}: was imported: there are no readings of a tracker to compute its truth"
            " from"
        )
    sessions_of: dict[str, list[int]] = {}
    for session in dataset.sessions:
        sessions_of.setdefault(session.calibration_json, []).append(session.number)
    if len(sessions_of) > 1:
        listed = "; ".join(
            f"sessions {spans(numbers)}: record of {calibrated_utc(text) or 'unknown date'}"
            for text, numbers in sessions_of.items()
        )
        raise DatasetError(
            f"{dataset.path}: its sessions have different calibration records, so that no single"
            f" one can serve them all ({listed});\ntake the shots of all but one of these again"
            " with one record (tronlab run --retake DIR --shots LIST), or keep truth as it is"
        )


def _check_record(record: CalibrationRecord, dataset: Dataset, acceptance: Acceptance) -> None:
    """Refuse a record that cannot be of the recording."""
    recorded = dataset.provenance
    acceptance.let_pass(lambda: record.check_rig(recorded.rig_name))
    acceptance.let_pass(lambda: _check_devices(record, recorded.devices))
    acceptance.let_pass(lambda: record.check_validity(datetime.fromisoformat(dataset.start_time)))
    if record.camera.shape != dataset.camera.shape:
        raise CalibrationError(
            f"calibration record {record.source}: the camera was calibrated for images of"
            f" {_size(record.camera.shape)} pixels, those of {dataset.path} have"
            f" {_size(dataset.camera.shape)}"
        )


def _check_devices(record: CalibrationRecord, recorded: Mapping[str, str]) -> None:
    others = [
        f"{name}: record '{device}', dataset '{recorded.get(name, 'none')}'"
        for name, device in record.devices.items()
        if not _is_named(device, recorded.get(name, ""))
    ]
    if others:
        raise CalibrationError(
            f"calibration record {record.source}: of other devices than the dataset:"
            f" {'; '.join(others)};\nname a record of the rig that recorded it"
        )


def _is_named(device: DeviceIdentity, recorded: str) -> bool:
    """Tell whether a recorded identity is the device's: by serial number, else by model."""
    word = re.escape(device.serial or device.model)
    return re.search(rf"(^|\s){word}(\s|$)", recorded) is not None


def _rewrite_shots(
    dataset: Dataset, rewriter: DatasetRewriter, source: TruthSource, live: Live
) -> TruthChange:
    before: list[Truth] = []
    after: list[Truth] = []
    live.advance("shots", n_done=0, n_all=dataset.n_shots)
    for i in range(dataset.n_shots):
        shot = dataset.shot(i)
        if shot.tracker is None:
            raise DatasetError(
                f"{dataset.path}: shot {shot.shot_id} was imported: there is no tracker's reading"
                " to compute its truth from"
            )
        truth, mask = source.derive(shot.tracker)
        rewriter.write_truth(i, shot, truth, mask)
        before.append(shot.truth)
        after.append(truth)
        live.advance("shots", n_done=i + 1, n_all=dataset.n_shots)
    return _change(before, after)


def _views(
    dataset: Dataset,
    record: CalibrationRecord,
    heightmap: HeightMap,
    renderer: HeightfieldRenderer,
    live: Live,
) -> tuple[ReferenceView, ...]:
    """Render the reference views as the record has camera and lamp; their poses are nominal."""
    recorded, config = dataset.references(), recorded_database(dataset.provenance, record)
    live.advance("reference views", n_done=0, n_all=len(recorded))
    return render_references(
        [view.trs_from_cam for view in recorded],
        heightmap=heightmap,
        renderer=database_renderer(config, heightmap, at_hand=renderer, announce=live.announce),
        camera=record.camera,
        lamp=recorded_lamp(dataset.provenance, record.p_lamp_trs_m),
        config=config,
        on_view=lambda n_done, n_all: live.advance("reference views", n_done=n_done, n_all=n_all),
    )


def _rewrite_drift(
    dataset: Dataset, rewriter: DatasetRewriter, record: CalibrationRecord, live: Live
) -> None:
    """Compare the reflectors measured then with those of the new record."""
    frame_input, frame = record.inputs.frame, record.results.frame
    checks: list[DriftRecord] = []
    if frame_input is None or frame is None:
        live.announce("drift checks: the record has no reflectors, so no shot is vouched for")
    else:
        checks += [
            judge(
                check.readings,
                n_shots_before=check.n_shots_before,
                frame_input=frame_input,
                frame=frame,
                limit_m=check.limit_m,
            )
            for check in dataset.drift_checks
        ]
    if dataset.drift_checks:
        rewriter.write_drift_checks(checks)


def _provenance(
    dataset: Dataset, record: CalibrationRecord, record_text: str, accepted: tuple[str, ...]
) -> Provenance:
    old = dataset.provenance
    return replace(
        old,
        calibration_json=record_text,
        camera=record.camera,
        accepted=accepted,
        recomputation=Recomputation(
            time_utc=utc_now(),
            version=tronlab.__version__,
            dataset_name=dataset.path.name,
            dataset_sha256=sha256_of(dataset.path),
            calibration_sha256=sha256(old.calibration_json.encode()).hexdigest(),
        ),
    )


def _change(before: list[Truth], after: list[Truth]) -> TruthChange:
    differences = np.array(
        [
            pose_difference(old.trs_from_cam, new.trs_from_cam)
            for old, new in zip(before, after, strict=True)
        ]
    ).reshape(-1, 6)
    turn_rad = np.linalg.norm(differences[:, :3], axis=1)
    shift_m = np.linalg.norm(differences[:, 3:], axis=1)
    sigmas = np.array([sigmas_of(old.covariance) for old in before]).reshape(-1, 2)
    sigmas[sigmas == 0.0] = np.nan
    return TruthChange(shift_m, turn_rad, shift_m / sigmas[:, 1], turn_rad / sigmas[:, 0])


def _median_and_max(values: FloatArray, unit: str, sigmas: FloatArray) -> str:
    def number(of: Callable[[FloatArray], float]) -> str:
        return f"{of(values):.4f} {unit} ({of(sigmas):.2f} sigma)"

    return f"{number(np.median)} in the median, {number(np.max)} at most"


def _size(shape: tuple[int, int]) -> str:
    return f"{shape[1]} x {shape[0]}"
