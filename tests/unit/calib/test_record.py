import json
from collections.abc import Callable
from dataclasses import fields, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from records import make_record
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.calib.camera.board import BoardView
from tronlab.calib.inputs import (
    CameraValues,
    FrameInput,
    Inputs,
    IntrinsicsInput,
    LampInput,
    PointInput,
    PoseInput,
    RobotInput,
    RobotStationInput,
    StationInput,
    StationsInput,
    ViewInput,
    points_of,
)
from tronlab.calib.record import CalibrationRecord, signature_of
from tronlab.calib.results import (
    CameraResult,
    FrameResult,
    HandEyeResult,
    LampResult,
    Results,
    RobotResult,
)
from tronlab.devices.laboratory import (
    LampSpec,
    MountingSpec,
    PatternSpec,
    PoseSpec,
    ReflectorsSpec,
)
from tronlab.devices.readings import DeviceIdentity, PointReading, PoseReading, RobotReading
from tronlab.errors import CalibrationError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.uncertainty import perturb, pose_difference

MEASURED = "2026-01-02T03:00:00Z"
OLDER = "2026-01-01T03:00:00Z"


def random_covariance(rng: np.random.Generator, n: int, sigma: float) -> np.ndarray:
    root = rng.normal(scale=sigma, size=(n, n))
    return root @ root.T


def random_pose(rng: np.random.Generator) -> RigidTransform:
    return RigidTransform.from_components(rng.normal(size=3), Rotation.random(rng=rng))


def random_results(rng: np.random.Generator) -> Results:
    camera = CameraModel(
        width_px=1024,
        height_px=1024,
        fx_px=760.125,
        fy_px=759.5,
        cx_px=511.1,
        cy_px=510.9,
        distortion=(-0.1, 0.05, 1e-4, -2e-4, 1e-3),
    )
    return Results(
        frame=FrameResult(random_pose(rng), random_covariance(rng, 6, 1e-5), {"n": 3}),
        camera=CameraResult(
            camera, random_covariance(rng, 12, 1e-2), "brown", rng.normal(size=3), {"rms_px": 0.1}
        ),
        hand_eye=HandEyeResult(random_pose(rng), random_covariance(rng, 6, 1e-5)),
        lamp=LampResult(np.array([-2.5, -1.5, 2.5]), random_covariance(rng, 3, 1e-5)),
        robot=RobotResult(
            random_pose(rng),
            np.array([1.0001, 1e-4, -2e-4]),
            random_pose(rng),
            random_covariance(rng, 15, 1e-5),
        ),
    )


def random_inputs(rng: np.random.Generator) -> Inputs:
    def reading() -> PoseReading:
        return PoseReading(random_pose(rng), random_covariance(rng, 6, 1e-5), time_s=1.5)

    def points() -> dict[str, PointInput]:
        names = ("top_left", "bottom_left", "top_right")
        return points_of(
            {
                name: PointReading(name, rng.normal(size=3), random_covariance(rng, 3, 1e-5), 2.0)
                for name in names
            }
        )

    pattern = PatternSpec(columns=5, rows=4, square_m=0.1, marker_m=0.07)
    seen = BoardView(np.arange(3), np.zeros((3, 3)), rng.uniform(0, 1000, (3, 2)))
    view, nominal = (
        ViewInput.of(seen),
        CameraValues(width_px=9, height_px=9, fx_px=9.0, fy_px=9.0, cx_px=4.0, cy_px=4.0),
    )
    reflectors = ReflectorsSpec(bottom_left_m=(2.0, 0.0, 0.0), top_right_m=(0.0, 4.0, 0.0))
    station = StationInput(reading=PoseInput.of(reading()), view=view)
    robot = RobotReading(rail_m=0.5, base_from_flange=random_pose(rng), time_s=3.0)
    return Inputs(
        frame=FrameInput(measured_utc=MEASURED, reflectors=reflectors, points=points()),
        intrinsics=IntrinsicsInput(
            measured_utc=MEASURED, pattern=pattern, nominal=nominal, views=(view,)
        ),
        hand_eye=StationsInput(
            measured_utc=MEASURED, pattern=pattern, nominal=nominal, stations=(station,)
        ),
        lamp=LampInput(
            measured_utc=OLDER,
            lamp=LampSpec(p_trs_m=(0.0, 0.0, 5.0)),
            reflectors=reflectors,
            points=points(),
            point=points()["top_left"],
        ),
        robot=RobotInput(
            measured_utc=MEASURED,
            mounting=MountingSpec(
                trs_from_rail=PoseSpec(xyz_m=(0.0, 0.0, 6.0)),
                flange_from_cam=PoseSpec(xyz_m=(0.0, 0.0, 0.1)),
                flange_from_tmac=PoseSpec(xyz_m=(0.0, 0.1, 0.1)),
                rail_range_m=(0.0, 4.0),
                arm_forward_m=1.0,
            ),
            reflectors=reflectors,
            points=points(),
            stations=(RobotStationInput.of(robot, reading()),),
        ),
    )


@pytest.fixture
def record() -> CalibrationRecord:
    rng = np.random.default_rng(1)
    return make_record(
        random_results(rng),
        inputs=random_inputs(rng),
        devices={
            "camera": DeviceIdentity("A", "cam", "1", "f1"),
            "tracker": DeviceIdentity("B", "trk", "2", "f2"),
            "tmac": DeviceIdentity("B", "tmac", "3", ""),
        },
        valid_days=30.0,
    )


def signed(values: dict[str, Any]) -> str:
    return json.dumps({**values, "signature": signature_of(values)})


def edited(record: CalibrationRecord, edit: Callable[[dict[str, Any]], object]) -> str:
    values = json.loads(record.to_json())
    edit(values)
    return signed(values)


def test_a_record_comes_back_as_it_was(record: CalibrationRecord, tmp_path: Path) -> None:
    path = tmp_path / "new" / "twin.json"
    record.save(path)
    loaded = CalibrationRecord.load(path)
    assert loaded.inputs == record.inputs
    assert loaded.camera == record.camera
    for part in ("frame", "camera", "hand_eye", "lamp", "robot"):
        kept, found = getattr(record.results, part), getattr(loaded.results, part)
        for name in (field.name for field in fields(kept)):
            a, b = getattr(kept, name), getattr(found, name)
            if isinstance(a, RigidTransform):  # read back, a quaternion is normalised
                np.testing.assert_allclose(pose_difference(a, b), 0.0, atol=1e-15)
            else:
                np.testing.assert_array_equal(a, b)
    assert [p.name for p in path.parent.iterdir()] == ["twin.json"]


def test_readings_come_back_as_they_were(record: CalibrationRecord) -> None:
    again = CalibrationRecord.from_json(record.to_json()).inputs
    assert isinstance(again.hand_eye, StationsInput)
    station = again.hand_eye.stations[0]
    kept = record.inputs.hand_eye
    assert isinstance(kept, StationsInput)
    reading, before = station.reading.reading, kept.stations[0].reading.reading
    difference = pose_difference(reading.trk_from_tmac, before.trk_from_tmac)
    np.testing.assert_allclose(difference, 0.0, atol=1e-15)
    np.testing.assert_array_equal(reading.covariance, before.covariance)
    view = station.view.view(again.hand_eye.pattern)
    np.testing.assert_allclose(view.p_board_m, [[0.1, 0.1, 0], [0.2, 0.1, 0], [0.3, 0.1, 0]])
    assert ViewInput.of(view) == station.view


def test_a_record_can_be_read_by_people(record: CalibrationRecord) -> None:
    text = record.to_json()
    assert '"parent": "tmac",' in text
    lines = text.splitlines()
    assert any(line.strip().startswith('"xyz_m_quat_xyzw": [') for line in lines)
    u, v = record.inputs.intrinsics.views[0].uv_px[0]  # type: ignore[union-attr]
    assert f"[{u}, {v}]," in [line.strip() for line in lines]


def test_an_edited_record_is_refused(record: CalibrationRecord) -> None:
    text = record.to_json().replace('"rig_name": "twin"', '"rig_name": "lab"')
    with pytest.raises(CalibrationError, match=r"changed after .*\n.*tronlab calibrate rerun f "):
        CalibrationRecord.from_json(text, source="f")
    assert CalibrationRecord.from_json(text, check_signature=False).rig_name == "lab"


def test_a_record_expires_with_its_oldest_part(record: CalibrationRecord) -> None:
    end = datetime(2026, 1, 31, 3, tzinfo=UTC)
    assert record.expires_utc == end
    record.check_validity(end)
    with pytest.raises(CalibrationError, match=r"expired at 2026-01-31 .*lamp was measured at"):
        record.check_validity(end + timedelta(seconds=1))
    endless = replace(record, valid_days=None)
    endless.check_validity(datetime(2126, 1, 1, tzinfo=UTC))


def test_a_missing_part_says_how_to_measure_it(record: CalibrationRecord) -> None:
    record.check_complete()
    partial = make_record(replace(record.results, hand_eye=None), source="r.json")
    again = CalibrationRecord.from_json(partial.to_json(), source="r.json")
    assert again.results.hand_eye is None
    match = "r.json: has no hand-eye;\n.*calibrate hand-eye --rig RIG.yaml --record r.json"
    with pytest.raises(CalibrationError, match=match):
        again.check_complete()


def test_the_robot_is_driven_as_calibrated(record: CalibrationRecord) -> None:
    robot = record.results.robot
    assert robot is not None
    assert record.inputs.robot is not None
    nominal = record.inputs.robot.mounting
    mounting = record.mounting(nominal)
    trs_from_cam = random_pose(np.random.default_rng(5))
    target = mounting.robot_target(trs_from_cam)
    rail_from_base = RigidTransform.from_translation(target.rail_m * robot.rail_axis)
    trs_from_tmac = (
        robot.trs_from_rail * rail_from_base * target.base_from_flange * robot.flange_from_tmac
    )
    difference = pose_difference(trs_from_tmac * record.tmac_from_cam, trs_from_cam)
    np.testing.assert_allclose(difference, 0.0, atol=1e-12)
    assert target.base_from_flange.translation[0] == pytest.approx(nominal.arm_forward_m)
    plain = make_record(replace(record.results, robot=None)).mounting(nominal)
    assert plain.robot_target(trs_from_cam).rail_m == pytest.approx(
        nominal.nominal.robot_target(trs_from_cam).rail_m
    )


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
    frame, hand_eye = record.results.frame, record.results.hand_eye
    assert frame is not None
    assert hand_eye is not None

    def drawn(pose: RigidTransform, cov: np.ndarray) -> RigidTransform:
        return perturb(pose, rng.multivariate_normal(np.zeros(6), cov))

    differences = []
    for _ in range(1200):
        truth = (
            drawn(record.trs_from_trk, frame.covariance)
            * drawn(reading.trk_from_tmac, reading.covariance)
            * drawn(record.tmac_from_cam, hand_eye.covariance)
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
    "no pose": (lambda v: v["hand_eye"].pop("tmac_from_cam"), r"tmac_from_cam\.parent: missing"),
    "no lamp point": (lambda v: v["lamp"].pop("p_trs_m"), r"lamp\.p_trs_m: missing"),
    "other file": (_set("schema", "package-lock"), "schema: is 'package-lock', expected"),
    "newer": (_set("schema_version", 4), "is 4, this tronlab reads 3;\nupdate tronlab, or"),
    "older": (_set("schema_version", 2), "is 2, this tronlab reads 3;\nmake a new record"),
    "no version": (_set("schema_version", "x"), "schema_version: is 'x', expected 3"),
    "frames": (_set("frame.trs_from_trk.child", "cam"), "is trs_from_cam, expected trs_from_trk"),
    "quaternion": (_set("frame.trs_from_trk.xyz_m_quat_xyzw", [0.0] * 7), "norm is 0, expected 1"),
    "short": (_set("frame.trs_from_trk.xyz_m_quat_xyzw", [0.0]), r"shape \(1,\), expected \(7,\)"),
    "ragged": (_set("camera.covariance", [[1], [1, 2]]), "is not numbers of shape"),
    "nan": (_set("lamp.p_trs_m", [0.0, 0.0, float("nan")]), "not finite"),
    "camera": (_set("camera.intrinsics.fx_px", "long"), r"intrinsics\.fx_px: is not numbers"),
    "camera key": (_set("camera.intrinsics.extra", 1.0), "intrinsics: camera model: .*extra"),
    "model": (_set("camera.model", "fisheye"), "is 'fisheye', expected one of pinhole, radial"),
    "validity": (_set("valid_days", "long"), "valid_days: is not numbers"),
    "input": (_set("inputs.frame.points.top_left.p_trk_m", [1, 2]), r"top_left\.p_trk_m"),
    "input key": (_set("inputs.frame.extra", 1), r"inputs\.frame\.extra: unknown key"),
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
    frame = replace(record.results.frame, statistics={"rms_m": float("nan")})
    bad = replace(record, results=replace(record.results, frame=frame))
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
