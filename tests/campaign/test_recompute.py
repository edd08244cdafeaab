"""Truth computed again from raw readings: the same with the same record, as told with another."""

import json
from collections.abc import Callable
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform
from typer.testing import CliRunner

from tronlab.calib.record import CalibrationRecord
from tronlab.campaign.recompute import recompute_truth
from tronlab.campaign.run import run_campaign
from tronlab.cli import dataset as command
from tronlab.dataset import columns, schema
from tronlab.dataset.admission import drift_values_of
from tronlab.dataset.reader import Dataset
from tronlab.dataset.sessions import write_session
from tronlab.dataset.skeleton import reference_arrays
from tronlab.dataset.validate import validate
from tronlab.errors import CalibrationError, DatasetError, IntegrityError

DERIVED = (schema.TRUTH, schema.MASK, schema.VALUES_CRC32, schema.REFERENCES, schema.DRIFT)
SHIFT_M = np.array([0.0, 0.0, 1e-3])


@pytest.fixture
def recorded(campaign_path: Path, tmp_path: Path) -> Path:
    return run_campaign(campaign_path, out_dir=tmp_path / "out")


@pytest.fixture
def record_path(tmp_path: Path) -> Path:
    return tmp_path / "record.json"


def arrays_of(path: Path) -> dict[str, np.ndarray]:
    """Give all numbers of a dataset by the path they have in the file."""
    with Dataset(path) as dataset:
        found = {column.path: dataset.rows(column.path) for column in columns.ROW_COLUMNS}
        shots = range(dataset.n_shots)
        found[schema.IMAGE] = np.array([dataset.image(i) for i in shots])
        found[schema.MASK] = np.array([dataset.mask(i) for i in shots])
        found |= {
            f"{schema.REFERENCES}/{name}": array
            for name, array in reference_arrays(dataset.references()).items()
        }
        for check in dataset.drift_checks:
            for name, value in drift_values_of(path, check, dataset.drift_reflectors).items():
                found[name] = np.array([*found.get(name, []), value])
    return found


def differing(a: Path, b: Path) -> set[str]:
    ours, theirs = arrays_of(a), arrays_of(b)
    return {
        name
        for name in ours.keys() | theirs.keys()
        if name not in ours or name not in theirs or ours[name].tobytes() != theirs[name].tobytes()
    }


def moved_camera(path: Path) -> Path:
    """Write a record whose camera sits 1 mm farther along its optical axis."""
    record = CalibrationRecord.load(path)
    hand_eye = record.results.hand_eye
    assert hand_eye is not None
    moved = replace(
        hand_eye, tmac_from_cam=hand_eye.tmac_from_cam * RigidTransform.from_translation(SHIFT_M)
    )
    target = path.with_name("moved.json")
    replace(record, results=replace(record.results, hand_eye=moved)).save(target)
    return target


def test_the_same_record_gives_the_same_truth_bit_for_bit(
    recorded: Path, record_path: Path, tmp_path: Path
) -> None:
    new = tmp_path / "new.h5"
    change = recompute_truth(recorded, record_path, out=new)
    assert change.shift_m.tolist() == [0.0] * 5
    np.testing.assert_allclose(change.turn_rad, 0.0, atol=1e-15)  # R R^T rounds
    assert differing(recorded, new) == set()
    assert validate(new) == []


def test_another_record_moves_truth_and_leaves_what_was_measured(
    recorded: Path, record_path: Path, tmp_path: Path
) -> None:
    before = recorded.read_bytes()
    moved, new = moved_camera(record_path), tmp_path / "new.h5"
    change = recompute_truth(recorded, moved, out=new)
    assert recorded.read_bytes() == before
    np.testing.assert_allclose(change.shift_m, 1e-3, rtol=1e-9)
    np.testing.assert_allclose(change.turn_rad, 0.0, atol=1e-12)
    assert str(change).startswith("truth moved by 1.0000 mm (")
    changed = differing(recorded, new)
    assert schema.IMAGE not in changed
    assert {name for name in changed if not name.startswith(DERIVED)} == set()
    assert validate(new) == []
    with Dataset(recorded) as old, Dataset(new) as dataset:
        assert dataset.provenance.calibration_json == moved.read_text()
        origin = dataset.provenance.recomputation
        assert origin is not None
        assert origin.dataset_name == "dataset.h5"
        assert origin.dataset_sha256 == sha256(before).hexdigest()
        text = old.provenance.calibration_json
        assert origin.calibration_sha256 == sha256(text.encode()).hexdigest()
        for i in range(old.n_shots):
            shift = old.truth(i).trs_from_cam.inv() * dataset.truth(i).trs_from_cam
            np.testing.assert_allclose(shift.translation, SHIFT_M, atol=1e-12)
            assert dataset.truth(i).range_los_m == pytest.approx(
                old.truth(i).range_los_m - 1e-3, abs=1e-4
            )


def test_drift_is_judged_by_the_new_record(
    campaign_path: Path, rig_path: Path, edit_yaml: Callable[..., None], tmp_path: Path
) -> None:
    """The tracker was pushed and the frame is measured anew: shots after the push are mended."""
    edit_yaml(campaign_path, "drift", {"every_n_shots": 2, "on_drift": "continue"})
    fault = {"device": "tracker", "call": "measure_point", "at": 4, "error": "moved"}
    edit_yaml(rig_path, "world.faults", [{**fault, "moved_m": [0.0, 0.0, 0.005]}])
    path = run_campaign(campaign_path, out_dir=tmp_path / "out")
    record = CalibrationRecord.load(tmp_path / "record.json")
    frame = record.inputs.frame
    with Dataset(path) as dataset:
        assert set(dataset.truth_states) == {"suspect"}
        last = dataset.drift_checks[-1]
    assert frame is not None
    assert record.results.frame is not None
    points = {
        name: point.model_copy(update={"p_trk_m": tuple(last.readings[name].p_trk_m.tolist())})
        for name, point in frame.points.items()
    }
    results = replace(
        record.results,
        frame=replace(
            record.results.frame,
            trs_from_trk=RigidTransform.from_translation(-last.shift[3:])
            * record.results.frame.trs_from_trk,
        ),
    )
    inputs = record.inputs.with_parts(frame=frame.model_copy(update={"points": points}))
    replace(record, results=results, inputs=inputs).save(tmp_path / "anew.json")
    new = tmp_path / "new.h5"
    recompute_truth(path, tmp_path / "anew.json", out=new)
    with Dataset(new) as dataset:
        assert dataset.truth_states == ("suspect", "suspect", "good", "good", "good")


def test_a_record_without_reflectors_vouches_for_nothing(
    recorded: Path, record_path: Path, tmp_path: Path
) -> None:
    record = CalibrationRecord.load(record_path)
    replace(record, inputs=record.inputs.with_parts(frame=None)).save(record_path)
    recompute_truth(recorded, record_path, out=tmp_path / "new.h5")
    with Dataset(tmp_path / "new.h5") as dataset:
        assert set(dataset.truth_states) == {"unchecked"}


def test_a_record_of_another_rig_or_other_devices_is_refused_unless_accepted(
    recorded: Path, record_path: Path, tmp_path: Path
) -> None:
    record = CalibrationRecord.load(record_path)
    camera = replace(record.devices["camera"], serial="other")
    other = replace(record, rig_name="other", devices={**record.devices, "camera": camera})
    other.save(record_path)
    new = tmp_path / "new.h5"
    with pytest.raises(CalibrationError, match=r"another rig(.|\n)*--accept-calibration"):
        recompute_truth(recorded, record_path, out=new)
    replace(other, rig_name=record.rig_name).save(record_path)
    with pytest.raises(CalibrationError, match=r"other devices than the dataset: camera: record"):
        recompute_truth(recorded, record_path, out=new)
    assert list(tmp_path.glob("new*")) == []
    other.save(record_path)
    recompute_truth(recorded, record_path, out=new, is_calibration_accepted=True)
    with Dataset(new) as dataset:
        assert len(dataset.provenance.accepted) == 2


def test_a_record_for_images_of_another_size_is_refused(
    recorded: Path, record_path: Path, tmp_path: Path
) -> None:
    record = CalibrationRecord.load(record_path)
    camera = record.results.camera
    assert camera is not None
    wide = replace(camera, camera=replace(camera.camera, width_px=128))
    replace(record, results=replace(record.results, camera=wide)).save(record_path)
    with pytest.raises(CalibrationError, match=r"images of 128 x 64 pixels, those of .* 64 x 64"):
        recompute_truth(
            recorded, record_path, out=tmp_path / "new.h5", is_calibration_accepted=True
        )


def test_what_cannot_be_done_leaves_nothing_behind(
    recorded: Path, record_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    new = tmp_path / "new.h5"
    with pytest.raises(DatasetError, match="exists already and is never overwritten"):
        recompute_truth(recorded, record_path, out=recorded)
    for nowhere in (tmp_path / "nowhere", recorded):
        with pytest.raises(DatasetError, match=rf"new\.h5: the directory {nowhere} does not exist"):
            recompute_truth(recorded, record_path, out=nowhere / "new.h5")

    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    def interrupt(_: object, target: Path, **__: object) -> None:
        target.write_bytes(b"half a copy")
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("tronlab.dataset.rewriter.DatasetRewriter.write_references", fail)
        with pytest.raises(DatasetError, match=r"new\.h5: cannot be made: .*No space left"):
            recompute_truth(recorded, record_path, out=new)
    with monkeypatch.context() as patch:
        patch.setattr("tronlab.dataset.rewriter.transcribe", interrupt)
        with pytest.raises(KeyboardInterrupt):
            recompute_truth(recorded, record_path, out=new)
    with h5py.File(recorded, "r+") as file:
        file["entry/instrument/tracker/time_s"][1] = 0.0
    with pytest.raises(IntegrityError, match="values of shots 2 are damaged"):
        recompute_truth(recorded, record_path, out=new)
    assert list(tmp_path.glob("*new*")) == []


def test_sessions_with_different_records_are_refused(
    recorded: Path, record_path: Path, tmp_path: Path
) -> None:
    with Dataset(recorded) as dataset:
        (first,) = dataset.sessions
    other = json.loads(first.calibration_json) | {"created_utc": "2026-02-01T00:00:00Z"}
    with h5py.File(recorded, "r+") as file:
        write_session(file, replace(first, number=2, calibration_json=json.dumps(other)))
    expected = r"different calibration records.*sessions 1: .*; sessions 2: record of 2026-02-01"
    with pytest.raises(DatasetError, match=expected):
        recompute_truth(recorded, record_path, out=tmp_path / "new.h5")


def test_the_command_says_how_far_truth_moved_and_where_the_new_file_is(
    recorded: Path, record_path: Path
) -> None:
    moved = moved_camera(record_path)
    result = CliRunner().invoke(
        command.dataset, ["recompute-truth", str(recorded), "--calibration", str(moved)]
    )
    assert result.exit_code == 0, result.output
    lines = result.stdout.splitlines()
    assert lines[-2].startswith("truth moved by 1.0000 mm (")
    assert lines[-1] == str(recorded.with_name("dataset.recomputed.h5"))
    info = CliRunner().invoke(command.dataset, ["info", lines[-1]]).stdout
    assert "truth recomputed" in info
    assert "5 good" in info
