import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.calib.record import CalibrationRecord
from tronlab.devices.readings import DeviceIdentity, PoseReading
from tronlab.errors import CalibrationError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.uncertainty import perturb, pose_difference


def random_covariance(rng: np.random.Generator, n: int, sigma: float) -> np.ndarray:
    root = rng.normal(scale=sigma, size=(n, n))
    return root @ root.T


def random_pose(rng: np.random.Generator) -> RigidTransform:
    return RigidTransform.from_components(rng.normal(size=3), Rotation.random(rng=rng))


@pytest.fixture
def record() -> CalibrationRecord:
    rng = np.random.default_rng(1)
    return CalibrationRecord(
        rig_name="twin",
        created_utc="2026-01-02T03:04:05Z",
        software={"tronlab": "0.1.0"},
        devices={
            "camera": DeviceIdentity("A", "cam", "1", "f1"),
            "tracker": DeviceIdentity("B", "trk", "2", "f2"),
            "tmac": DeviceIdentity("B", "tmac", "3", ""),
        },
        camera=CameraModel(
            width_px=1024,
            height_px=1024,
            fx_px=760.125,
            fy_px=759.5,
            cx_px=511.1,
            cy_px=510.9,
            distortion=(-0.1, 0.05, 1e-4, -2e-4, 1e-3),
        ),
        camera_covariance=random_covariance(rng, 9, 1e-2),
        trs_from_trk=random_pose(rng),
        trs_from_trk_covariance=random_covariance(rng, 6, 1e-5),
        tmac_from_cam=random_pose(rng),
        tmac_from_cam_covariance=random_covariance(rng, 6, 1e-5),
        p_lamp_trs_m=np.array([-2.5, -1.5, 2.5]),
        p_lamp_trs_covariance_m2=random_covariance(rng, 3, 1e-5),
        statistics={"rms_px": 0.1},
        inputs={"stations": [{"uv_px": [[1.0, 2.5], [3.25, 4.0]], "ids": [0, 1]}]},
    )


def edited(record: CalibrationRecord, edit: Callable[[dict[str, Any]], object]) -> str:
    values = json.loads(record.to_json())
    edit(values)
    return json.dumps(values)


def test_a_record_comes_back_as_it_was(record: CalibrationRecord, tmp_path: Path) -> None:
    path = tmp_path / "new" / "twin.json"
    record.save(path)
    loaded = CalibrationRecord.load(path)
    assert loaded.camera == record.camera
    np.testing.assert_array_equal(loaded.camera_covariance, record.camera_covariance)
    difference = pose_difference(loaded.tmac_from_cam, record.tmac_from_cam)
    np.testing.assert_allclose(difference, 0.0, atol=1e-15)
    assert loaded.inputs == record.inputs
    assert loaded.statistics == record.statistics
    assert [p.name for p in path.parent.iterdir()] == ["twin.json"]


def test_a_record_can_be_read_by_people(record: CalibrationRecord) -> None:
    lines = record.to_json().splitlines()
    assert '  "parent": "tmac",' in "\n".join(lines)
    assert any(line.strip().startswith('"xyz_m_quat_xyzw": [') for line in lines)
    assert "          [1.0, 2.5]," in lines


def test_the_shot_pose_is_the_composition(record: CalibrationRecord) -> None:
    rng = np.random.default_rng(2)
    reading = PoseReading(random_pose(rng), np.diag([1e-8] * 3 + [1e-10] * 3), time_s=0.0)
    trs_from_cam, _ = record.trs_from_cam(reading)
    p_cam = np.array([0.1, 0.2, 0.3])
    p_tmac = record.tmac_from_cam.apply(p_cam)
    p_trs = record.trs_from_trk.apply(reading.trk_from_tmac.apply(p_tmac))
    np.testing.assert_allclose(trs_from_cam.apply(p_cam), p_trs, atol=1e-12)


def test_the_shot_covariance_is_that_of_many_draws(record: CalibrationRecord) -> None:
    rng = np.random.default_rng(3)
    reading = PoseReading(random_pose(rng), random_covariance(rng, 6, 1e-5), time_s=0.0)
    trs_from_cam, covariance = record.trs_from_cam(reading)

    def drawn(pose: RigidTransform, cov: np.ndarray) -> RigidTransform:
        return perturb(pose, rng.multivariate_normal(np.zeros(6), cov))

    differences = []
    for _ in range(1200):
        truth = (
            drawn(record.trs_from_trk, record.trs_from_trk_covariance)
            * drawn(reading.trk_from_tmac, reading.covariance)
            * drawn(record.tmac_from_cam, record.tmac_from_cam_covariance)
        )
        differences.append(pose_difference(trs_from_cam, truth))
    scale = np.sqrt(np.diag(covariance))
    sampled = np.cov(np.array(differences).T)
    np.testing.assert_allclose(
        sampled / np.outer(scale, scale), covariance / np.outer(scale, scale), atol=0.15
    )


def test_a_missing_file_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"none\.json: No such file(.|\n)*tronlab calibrate"):
        CalibrationRecord.load(tmp_path / "none.json")


def test_a_file_that_is_no_json_names_the_line(tmp_path: Path) -> None:
    (tmp_path / "r.json").write_text("{\n  oops\n}")
    with pytest.raises(CalibrationError, match=r"r\.json:2: not JSON"):
        CalibrationRecord.load(tmp_path / "r.json")


def test_a_binary_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "r.json").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(CalibrationError, match="not a text file"):
        CalibrationRecord.load(tmp_path / "r.json")


def _set(dotted: str, value: object) -> Callable[[dict[str, Any]], object]:
    def edit(values: dict[str, Any]) -> None:
        *parents, last = dotted.split(".")
        for parent in parents:
            values = values[parent]
        values[last] = value

    return edit


MISTAKES = {
    "no rig": (lambda v: v.pop("rig_name"), "rig_name: missing"),
    "no pose": (lambda v: v.pop("tmac_from_cam"), r"tmac_from_cam\.parent: missing"),
    "no lamp point": (lambda v: v["lamp"].pop("p_trs_m"), r"lamp\.p_trs_m: missing"),
    "no tmac identity": (lambda v: v["devices"].pop("tmac"), r"devices\.tmac: missing"),
    "other file": (_set("schema", "package-lock"), "schema: is 'package-lock', expected"),
    "newer": (_set("schema_version", 3), "is 3, newer than 2, .*\nupdate tronlab"),
    "no version": (_set("schema_version", "x"), "schema_version: is 'x', expected 2"),
    "frames": (_set("trs_from_trk.child", "cam"), "is trs_from_cam, expected trs_from_trk"),
    "quaternion": (_set("trs_from_trk.xyz_m_quat_xyzw", [0.0] * 7), "norm is 0, expected 1"),
    "short": (_set("trs_from_trk.xyz_m_quat_xyzw", [0.0]), r"shape \(1,\), expected \(7,\)"),
    "ragged": (_set("camera_covariance", [[1], [1, 2]]), "is not numbers of shape"),
    "nan": (_set("lamp.p_trs_m", [0.0, 0.0, float("nan")]), "not finite"),
    "camera": (_set("camera.fx_px", "long"), r"camera\.fx_px: is not numbers"),
    "camera key": (_set("camera.extra", 1.0), "camera: camera model: .*extra"),
    "skewed covariance": (
        _set("lamp.covariance_m2", [[1, 1, 0], [0, 1, 0], [0, 0, 1]]),
        "symmetric",
    ),
    "negative": (_set("lamp.covariance_m2", [[-1, 0, 0], [0, 1, 0], [0, 0, 1]]), "negative"),
    "rig number": (_set("rig_name", 3), "rig_name: is 3, expected a text"),
    "inputs": (_set("inputs", []), "inputs: is a list, expected a mapping"),
    "software": (_set("software", {"a": 1}), r"software\.a: is 1, expected a text"),
}


@pytest.mark.parametrize(("edit", "message"), MISTAKES.values(), ids=MISTAKES.keys())
def test_a_damaged_record_names_file_and_key(
    record: CalibrationRecord, edit: Callable[[dict[str, Any]], object], message: str
) -> None:
    with pytest.raises(CalibrationError, match=f"calibration record some/file: (.|\n)*{message}"):
        CalibrationRecord.from_json(edited(record, edit), source="some/file")


def test_a_list_is_no_record() -> None:
    with pytest.raises(CalibrationError, match="top level is a list"):
        CalibrationRecord.from_json("[1]")


def test_a_value_json_does_not_have_is_not_written(
    record: CalibrationRecord, tmp_path: Path
) -> None:
    bad = replace(record, statistics={"rms_px": float("nan")})
    with pytest.raises(CalibrationError, match="cannot be written"):
        bad.save(tmp_path / "r.json")
    assert not list(tmp_path.iterdir())


def test_a_folder_in_place_of_the_file_is_an_error(
    record: CalibrationRecord, tmp_path: Path
) -> None:
    (tmp_path / "r.json").mkdir()
    with pytest.raises(CalibrationError, match=r"r\.json"):
        record.save(tmp_path / "r.json")


def test_another_rig_is_refused(record: CalibrationRecord) -> None:
    record.check_rig("twin")
    with pytest.raises(CalibrationError, match=r"another rig: .*'twin'.*'other'"):
        record.check_rig("other")


def test_exchanged_devices_are_refused_by_name(record: CalibrationRecord) -> None:
    def camera(serial: str, firmware: str) -> dict[str, DeviceIdentity]:
        return {**record.devices, "camera": DeviceIdentity("A", "cam", serial, firmware)}

    record.check_devices({**record.devices, "robot": DeviceIdentity("", "any", "", "")})
    record.check_devices(camera("1", "new firmware"))
    with pytest.raises(CalibrationError, match=r"camera: record 'A cam 1 f1', now 'A cam 9 f1'"):
        record.check_devices(camera("9", "f1"))
    with pytest.raises(CalibrationError, match=r"tmac: record 'B tmac 3', now 'none'"):
        record.check_devices({k: v for k, v in record.devices.items() if k != "tmac"})
