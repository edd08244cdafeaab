"""Steps that calibrate the study's laboratories."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

from tronlab.dataset.location import DATASET_NAME
from tronlab.study.keys import RECORDING_CODE, key_of
from tronlab.study.recording import record_dataset
from tronlab.study.steps import Desk, Step
from tronlab.study.study import Study, record_file
from tronlab.study.variants import Variant
from tronlab.study.writing import replace_text
from tronlab.yaml_models import read_text

_CALIBRATE_S, _PHOTOMETRY_S = 90.0, 25.0


@dataclass(frozen=True, slots=True)
class CalibratedRig:
    """A rig to be calibrated; ``record`` is relative to the study's folder."""

    name: str
    """As the steps call it."""
    file: Path
    kept: Path
    """The record kept with the campaigns."""
    record: Path
    photometry: Path | None
    """Campaign whose images show how the model reflects light."""


def calibration_steps(study: Study) -> list[Step]:
    """Calibrate each laboratory: a full study measures, a quick one takes the records kept."""
    return [_copy_step(rig) if study.quick else _measure_step(rig) for rig in _rigs(study)]


def _rigs(study: Study) -> list[CalibratedRig]:
    rigs: list[CalibratedRig] = []
    for name in study.laboratories:
        one = study.config.laboratories[name]
        rigs.append(CalibratedRig(name, one.rig, one.record, record_file(name), one.photometry))
        is_larger = any(study.laboratory_name(dataset) == name for dataset in study.larger)
        if is_larger and one.larger is not None and one.larger_record is not None:
            record = record_file(name, larger=True)
            named = f"{name}, larger terrain"
            rigs.append(CalibratedRig(named, one.larger, one.larger_record, record, one.photometry))
    return rigs


def _copy_step(rig: CalibratedRig) -> Step:
    return Step(
        f"calibration of {rig.name}: take the record kept",
        key_of(files=[rig.kept]),
        cost=0.1,
        run=partial(_copy, rig=rig),
        results=(rig.record,),
    )


def _measure_step(rig: CalibratedRig) -> Step:
    campaigns = [] if rig.photometry is None else [rig.photometry]
    return Step(
        f"calibrate {rig.name}",
        key_of(files=campaigns, code=RECORDING_CODE, rig=Variant(rig.file).key),
        cost=_CALIBRATE_S + _PHOTOMETRY_S * len(campaigns),
        run=partial(_measure, rig=rig),
        results=(rig.record,),
    )


def _copy(desk: Desk, *, rig: CalibratedRig) -> None:
    replace_text(desk.out / rig.record, read_text(rig.kept))


def _measure(desk: Desk, *, rig: CalibratedRig) -> None:
    """Measure everything, without anybody at the rig."""
    _measure_geometry(desk, rig)
    if rig.photometry is not None:
        _measure_photometry(desk, rig, rig.photometry)


def _measure_geometry(desk: Desk, rig: CalibratedRig) -> None:
    from tronlab.calib.wizard import ALL_PARTS, Unattended
    from tronlab.campaign.calibrating import measure_parts
    from tronlab.campaign.rig import load_rig

    measured = measure_parts(
        ALL_PARTS,
        load_rig(rig.file),
        None,
        dialogue=Unattended(desk.live),
        seed=0,
        keep=lambda _: None,  # it takes a minute, and whatever ends it, it begins anew
    )
    path = desk.out / rig.record
    path.parent.mkdir(parents=True, exist_ok=True)
    measured.save(path)


def _measure_photometry(desk: Desk, rig: CalibratedRig, campaign: Path) -> None:
    """Take images of the model, and add to the record how it reflects light."""
    from tronlab.calib.record import CalibrationRecord
    from tronlab.campaign.photometry import measure_photometry, with_photometry

    path = desk.out / rig.record
    folder = path.with_name(f"{path.stem}_photometry")
    record_dataset(desk, campaign=campaign, rig=rig.file, record=path, folder=folder)
    measured = measure_photometry(folder / DATASET_NAME, rig_path=rig.file, live=desk.live)
    with_photometry(CalibrationRecord.load(path), measured).save(path)
