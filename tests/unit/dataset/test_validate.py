import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.dataset import schema
from tronlab.dataset.journal import Journal
from tronlab.dataset.records import Provenance, ReferenceView, Session, ShotRecord
from tronlab.dataset.sessions import only_session
from tronlab.dataset.validate import Examination, examine, validate
from tronlab.dataset.writer import DatasetWriter
from tronlab.errors import DatasetError
from tronlab.geometry.poses import pose_from_xyz_quat, xyz_quat_from_pose

MakeShot = Callable[..., ShotRecord]
MakeProvenance = Callable[..., Provenance]


def spoilt(path: Path, where: str, index: Any, value: Any) -> list[str]:
    with h5py.File(path, "r+") as file:
        file[where][index] = value
    return validate(path)


def findings_of(
    path: Path, provenance: Provenance, shots: list[ShotRecord], views: list[ReferenceView]
) -> list[str]:
    with DatasetWriter(path, provenance) as writer:
        if views:
            writer.add_references(views)
        for shot in shots:
            writer.commit(shot)
        writer.finish("complete")
    return validate(path)


def test_a_good_dataset_is_valid(small_dataset: Path) -> None:
    assert validate(small_dataset) == []


def test_16_bit_is_valid(
    tmp_path: Path, make_shot: MakeShot, make_provenance: MakeProvenance
) -> None:
    shots = [make_shot(i, dtype=np.uint16) for i in range(2)]
    assert findings_of(tmp_path / "a.h5", make_provenance(2), shots, []) == []


def test_what_cannot_be_opened_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="no such file"):
        validate(tmp_path / "a.h5")


def test_an_aborted_recording_is_sound_but_told(
    tmp_path: Path, make_shot: MakeShot, make_provenance: MakeProvenance
) -> None:
    with DatasetWriter(tmp_path / "a.h5", make_provenance(5)) as writer:
        writer.commit(make_shot(0))
        writer.finish("aborted", "operator")
    Journal(writer.path).write("skipped", "shot 3: beam lost 3 times", shot_id=3)
    Journal(writer.path).write("skipped", "beam lost 3 times", shot_id=0)  # taken later
    Journal(writer.path).write("skipped", "somebody wrote this", shot_id="seven")
    assert examine(writer.path) == Examination(
        findings=(),
        notes=(
            "the recording ended with status aborted: operator",
            "1 of 5 planned shots are there",
            "shot 3 was skipped: beam lost 3 times",
        ),
    )


def test_progress_is_told(small_dataset: Path) -> None:
    steps: list[tuple[int, int]] = []
    examine(small_dataset, on_shot=lambda n_done, n_all: steps.append((n_done, n_all)))
    assert steps == [(n, 5) for n in range(1, 6)]


@pytest.mark.parametrize(
    ("where", "index", "value", "expected"),
    [
        (schema.SHOT_ID, 3, 1, "shot 1: is there 2 times"),
        (
            "entry/truth/trs_from_cam",
            (2, 6),
            3.0,
            "shot 2: truth/trs_from_cam is no pose with a unit quaternion",
        ),
        (
            "entry/instrument/tracker/trk_from_tmac",
            (0, 0),
            np.nan,
            "shot 0: instrument/tracker/trk_from_tmac is no pose with a unit quaternion",
        ),
        (
            "entry/truth/trs_from_cam_covariance",
            (4, 0, 1),
            1e-7,
            "shot 4: truth/trs_from_cam_covariance is not a covariance"
            " (symmetric, positive semidefinite)",
        ),
        (
            "entry/truth/trs_from_cam_covariance",
            (1, 5, 5),
            -1e-12,
            "shot 1: truth/trs_from_cam_covariance is not a covariance"
            " (symmetric, positive semidefinite)",
        ),
        ("entry/truth/range_los_m", 1, np.inf, "shot 1: truth/range_los_m is not finite"),
        (
            "entry/instrument/robot/rail_m",
            1,
            9.0,
            "shot 1: the checksum of its values does not match",
        ),
        (schema.IMAGE, (2, 0, 0), 7, "shot 2: image is damaged: its checksum does not match"),
        (schema.MASK, (2, 0, 0), 1, "shot 2: mask is damaged: its checksum does not match"),
        (
            "entry/truth/usable_fraction",
            0,
            0.25,
            "shot 0: usable fraction is 0.25, the mask's is 0.794271",
        ),
        (
            "entry/instrument/camera/pixel_format",
            2,
            b"M\xff\xfe8",
            "shot 2: pixel_format is damaged: b'M\\xff\\xfe8' is not text",
        ),
        (
            "entry/references/depth_m",
            (1, 5, 5),
            1.5,
            "reference view 1 is damaged: its checksum does not match",
        ),
        (
            "entry/references/image",
            (0, slice(10)),
            0,
            "reference view 0 is damaged: its checksum does not match",
        ),
        (
            "entry/references/mask",
            (1, slice(20)),
            0,
            "reference view 1 is damaged: its checksum does not match",
        ),
        (schema.N_COMMITTED, (), 4, "drift: the checks were after 0, 5 shots, which cannot be"),
        ("entry/recording/n_shots_planned", (), 4, "5 shots are there, 4 were planned"),
        (schema.SESSION, 2, 9, "shots 2: taken in session 9, there are 1"),
        (schema.SUPERSEDES, 2, 4, "row 2: supersedes row 4, which is not before it"),
        (schema.SUPERSEDES, 3, 1, "row 3: is shot 3, supersedes shot 1"),
        (
            schema.QUALITY_FLAGS,
            1,
            1 << 20,
            "shot 1: quality/flags is 0x100000, only the lowest 8 bits have a meaning",
        ),
        ("entry/recording/status", (), b"odd", "unknown status 'odd'"),
    ],
)
def test_each_defect_is_found(
    small_dataset: Path, where: str, index: Any, value: Any, expected: str
) -> None:
    findings = spoilt(small_dataset, where, index, value)
    assert any(finding.startswith(expected) for finding in findings), findings


def test_every_damaged_reference_view_is_found(small_dataset: Path) -> None:
    with h5py.File(small_dataset, "r+") as file:
        file["entry/references/depth_m"][...] = 1.5
    findings = validate(small_dataset)
    assert [finding.split(":")[0] for finding in findings] == [
        "reference view 0 is damaged",
        "reference view 1 is damaged",
    ]


def test_reference_views_without_checksums_are_told_once(small_dataset: Path) -> None:
    with h5py.File(small_dataset, "r+") as file:
        del file[schema.REFERENCES_CRC32]
    (finding,) = validate(small_dataset)
    assert finding.startswith("entry/references/crc32 is missing or damaged")


def test_reference_views_that_make_no_sense_are_found(
    tmp_path: Path,
    make_shot: MakeShot,
    make_provenance: MakeProvenance,
    make_view: Callable[[int], ReferenceView],
) -> None:
    behind, unseen = make_view(0), make_view(1)
    behind.depth_m[5, 5] = -1.0
    unseen.depth_m[:] = np.nan
    views = [behind, unseen, replace(make_view(2), view_id=0)]
    shots = [make_shot(0)]
    assert findings_of(tmp_path / "a.h5", make_provenance(1), shots, views) == [
        "reference view 0: a depth is not positive",
        "reference view 1: no terrain is seen",
        "reference views: an id is there twice",
    ]


def test_a_camera_model_that_is_not_the_calibrated_one_is_found(
    tmp_path: Path, make_shot: MakeShot, make_provenance: MakeProvenance
) -> None:
    path = tmp_path / "a.h5"
    provenance = make_provenance(1)
    calibration = {"camera": {"intrinsics": provenance.camera.to_dict()}}
    provenance = replace(provenance, calibration_json=json.dumps(calibration))
    assert findings_of(path, provenance, [make_shot(0)], []) == []
    with h5py.File(path, "r+") as file:
        file[f"{schema.CAMERA}/model"].attrs["fx_px"] = 48.48
    assert validate(path) == [
        "instrument/camera/model: fx_px is 48.48, the calibration record says 48.0"
    ]


def test_a_truth_that_does_not_follow_from_the_raw_reading_is_found(
    tmp_path: Path, make_shot: MakeShot, make_provenance: MakeProvenance
) -> None:
    shot = make_shot(1)
    moved = replace(shot.truth, trs_from_cam=make_shot(2).truth.trs_from_cam)
    shots = [make_shot(0), replace(shot, truth=moved)]
    findings = findings_of(tmp_path / "a.h5", make_provenance(2), shots, [])
    assert len(findings) == 1
    assert findings[0].startswith("shot 1: truth does not follow from the tracker's reading")
    assert findings[0].endswith("mm apart")


def test_a_calibration_that_says_nothing_is_passed_over(small_dataset: Path) -> None:
    for calibration_json in (
        "",
        "not JSON",
        "[1]",
        '{"trs_from_trk": 1}',
        '{"camera": 1}',
        '{"camera": {"fx_px": 1}}',
        '{"camera": {"width_px": Infinity, "height_px": 1, "fx_px": 1, "fy_px": 1, "cx_px": 1,'
        ' "cy_px": 1, "distortion": [0, 0, 0, 0, 0]}}',
    ):
        with h5py.File(small_dataset, "r+") as file:
            del file["entry/calibration/data"]
            file["entry/calibration/data"] = calibration_json
        assert validate(small_dataset) == []


@pytest.mark.parametrize(
    ("dtype", "expected"),
    [
        (
            np.uint8,
            {0: "shot 0: the image is black", 255: "shot 1: the image is saturated"},
        ),
        (
            np.uint16,
            {
                4095: "shot 0: the image is saturated",
                5000: "shot 1: a grey value is 5000, but Mono12 ends at 4095",
            },
        ),
    ],
)
def test_an_image_that_shows_nothing_is_found(
    tmp_path: Path,
    make_shot: MakeShot,
    make_provenance: MakeProvenance,
    dtype: type,
    expected: dict[int, str],
) -> None:
    shots = [make_shot(i, dtype=dtype) for i in range(len(expected))]
    for shot, value in zip(shots, expected, strict=True):
        shot.frame.image[:] = value
    findings = findings_of(tmp_path / "a.h5", make_provenance(2), shots, [])
    assert set(expected.values()) <= set(findings)


def test_a_mask_that_is_empty_or_in_two_parts_is_found(
    tmp_path: Path, make_shot: MakeShot, make_provenance: MakeProvenance
) -> None:
    empty, parted = make_shot(0), make_shot(1)
    empty.mask[:] = False
    parted.mask[:, 30:33] = False
    shots = [
        replace(shot, truth=replace(shot.truth, usable_fraction=float(shot.mask.mean())))
        for shot in (empty, parted)
    ]
    assert findings_of(tmp_path / "a.h5", make_provenance(2), shots, []) == [
        "shot 0: the mask is empty",
        "shot 1: the mask falls into 2 parts, expected one outline",
    ]


def session_of(provenance: Provenance, number: int = 1, **changes: Any) -> Session:
    session = only_session(provenance, start_utc="2026-11-22T12:00:00.000+00:00")
    return replace(session, number=number, **changes)


def with_robot(provenance: Provenance, shot: ShotRecord) -> dict[str, Any]:
    """Give the calibration record by which robot and rail are where truth has the camera."""
    record = json.loads(provenance.calibration_json)
    tmac_from_cam = pose_from_xyz_quat(record["hand_eye"]["tmac_from_cam"]["xyz_m_quat_xyzw"])
    assert shot.robot is not None
    axis = np.array([0.999, 0.002, -0.001])
    flange_from_tmac = RigidTransform.from_components(
        [0.1, -0.09, 0.05], Rotation.from_rotvec([0.1, 0.2, 0.3])
    )
    rail_from_base = RigidTransform.from_translation(shot.robot.rail_m * axis)
    rail_from_cam = rail_from_base * shot.robot.base_from_flange * flange_from_tmac * tmac_from_cam
    poses = {
        "trs_from_rail": shot.truth.trs_from_cam * rail_from_cam.inv(),
        "flange_from_tmac": flange_from_tmac,
    }
    robot = {
        name: {"xyz_m_quat_xyzw": xyz_quat_from_pose(pose).tolist()} for name, pose in poses.items()
    }
    return {**record, "robot": {**robot, "rail_axis_m_per_m": axis.tolist()}}


def test_a_robot_that_was_elsewhere_is_found(
    tmp_path: Path, make_shot: MakeShot, make_provenance: MakeProvenance
) -> None:
    shot = make_shot(0)
    record = with_robot(make_provenance(1), shot)
    provenance = replace(make_provenance(2), calibration_json=json.dumps(record))
    assert shot.robot is not None
    near, far = (
        replace(shot, shot_id=1, robot=replace(shot.robot, rail_m=shot.robot.rail_m + shift_m))
        for shift_m in (0.008, 0.012)
    )
    assert findings_of(tmp_path / "near.h5", provenance, [shot, near], []) == []
    (finding,) = findings_of(tmp_path / "far.h5", provenance, [shot, far], [])
    assert finding == (
        "shot 1: robot and rail have the camera 12.0 mm and 0.00 deg from truth,"
        " allowed 10 mm and 0.5 deg"
    )


@pytest.fixture
def segmented(tmp_path: Path, make_shot: MakeShot, make_provenance: MakeProvenance) -> Path:
    """Five shots in segments of 2, the third of them taken again in another session."""
    path = tmp_path / "dataset.h5"
    provenance = make_provenance(5)
    with DatasetWriter(path, provenance, session=session_of(provenance), segment_shots=2) as writer:
        for i in range(5):
            writer.commit(make_shot(i))
        writer.finish("complete")
    again = session_of(provenance, 2, kind="retake")
    with DatasetWriter.reopen(path, again, n_rows=1, segment_shots=2) as writer:
        writer.commit(make_shot(7, shot_id=2), replaces=True)
        writer.finish("complete")
    return path


def test_a_dataset_of_several_sessions_and_segments_is_valid(segmented: Path) -> None:
    assert examine(segmented) == Examination((), ())


def test_truth_follows_from_the_record_of_the_session(
    tmp_path: Path, make_shot: MakeShot, make_provenance: MakeProvenance
) -> None:
    provenance, path = make_provenance(2), tmp_path / "dataset.h5"
    record = json.loads(provenance.calibration_json)
    record["frame"]["trs_from_trk"]["xyz_m_quat_xyzw"][0] += 0.25
    shot = make_shot(1)
    moved = RigidTransform.from_translation([0.25, 0.0, 0.0]) * shot.truth.trs_from_cam
    with DatasetWriter(path, provenance, session=session_of(provenance), segment_shots=9) as writer:
        writer.commit(make_shot(0))
        writer.finish("aborted")
    second = session_of(provenance, 2, kind="resume", calibration_json=json.dumps(record))
    with DatasetWriter.reopen(path, second, n_rows=1, segment_shots=9) as writer:
        writer.commit(replace(shot, truth=replace(shot.truth, trs_from_cam=moved)))
        writer.finish("complete")
    assert validate(path) == []


def test_missing_and_foreign_segments_are_found(segmented: Path) -> None:
    first, second, last, _ = sorted((segmented.parent / "dataset.images").iterdir())
    second.rename(second.with_name("spare.h5"))
    (finding,) = validate(segmented)
    assert finding.startswith(f"the images of rows 2 to 3 are in {second}, which is missing")
    (note, stranger) = examine(segmented).notes
    assert note.startswith("row 2, superseded, of shot 2: the images of rows 2 to 3")
    assert stranger == f"{second.with_name('spare.h5')}: is no file of this dataset"
    second.write_bytes(first.read_bytes())
    (finding,) = validate(segmented)
    assert "is another segment" in finding
    with h5py.File(last, "r+") as file:
        file[schema.SEGMENT_IMAGE][0, 0] = 0
    assert "shot 4: image is damaged: its checksum does not match" in "\n".join(validate(segmented))
