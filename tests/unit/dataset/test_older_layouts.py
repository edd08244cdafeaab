"""Files of layout 1.2, as tronlab wrote them before sessions and segments."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from tronlab.dataset.columns import checksum
from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import DriftRecord, Provenance, ShotRecord
from tronlab.geometry.poses import xyz_quat_from_pose

Row = dict[str, Any]


def values_1_2(shot: ShotRecord) -> Row:
    """Give what layout 1.2 stores of a shot, in the order of its checksum."""
    assert shot.robot is not None
    assert shot.tracker is not None
    assert shot.room is not None
    camera, room, tracker = (f"entry/instrument/{name}" for name in ("camera", "room", "tracker"))
    return {
        "entry/shots/shot_id": np.int64(shot.shot_id),
        "entry/shots/attempt": np.int64(shot.attempt),
        "entry/shots/trs_from_cam_nominal": xyz_quat_from_pose(shot.trs_from_cam_nominal),
        "entry/instrument/robot/rail_m": shot.robot.rail_m,
        "entry/instrument/robot/base_from_flange": xyz_quat_from_pose(shot.robot.base_from_flange),
        "entry/instrument/robot/time_s": shot.robot.time_s,
        f"{tracker}/trk_from_tmac": xyz_quat_from_pose(shot.tracker.trk_from_tmac),
        f"{tracker}/trk_from_tmac_covariance": shot.tracker.covariance,
        f"{tracker}/time_s": shot.tracker.time_s,
        f"{room}/air_temperature_k": shot.room.air_temperature_k,
        f"{room}/air_pressure_pa": shot.room.air_pressure_pa,
        f"{room}/relative_humidity": shot.room.relative_humidity,
        f"{room}/is_door_closed": np.uint8(shot.room.is_door_closed),
        f"{room}/is_lamp_on": np.uint8(shot.room.is_lamp_on),
        f"{room}/time_s": shot.room.time_s,
        f"{camera}/pixel_format": np.array(shot.frame.pixel_format.encode(), "S16"),
        f"{camera}/exposure_s": shot.frame.exposure_s,
        f"{camera}/gain_db": shot.frame.gain_db,
        f"{camera}/frame_id": np.int64(shot.frame.frame_id),
        f"{camera}/time_s": shot.frame.time_s,
        "entry/truth/trs_from_cam": xyz_quat_from_pose(shot.truth.trs_from_cam),
        "entry/truth/trs_from_cam_covariance": shot.truth.covariance,
        "entry/truth/range_los_m": shot.truth.range_los_m,
        "entry/truth/usable_fraction": shot.truth.usable_fraction,
        f"{tracker}/air_temperature_k": np.nan,
        f"{tracker}/air_pressure_pa": np.nan,
        f"{tracker}/relative_humidity": np.nan,
        f"{camera}/device_time_s": np.nan,
    }


def drift_1_2(check: DriftRecord) -> Row:
    points = check.readings.values()
    return {
        "entry/drift/n_shots_before": np.int64(check.n_shots_before),
        "entry/drift/time_s": check.time_s,
        "entry/drift/p_trk_m": np.array([point.p_trk_m for point in points]),
        "entry/drift/p_trk_covariance_m2": np.array([point.covariance_m2 for point in points]),
        "entry/drift/p_trk_time_s": np.array([point.time_s for point in points]),
        "entry/drift/shift": check.shift,
        "entry/drift/max_shift_m": check.max_shift_m,
        "entry/drift/limit_m": check.limit_m,
        "entry/drift/is_within": np.uint8(check.is_within),
    }


def write_rows(file: h5py.File, rows: list[Row], crc32: str) -> None:
    for path in rows[0]:
        stacked = np.stack([row[path] for row in rows])
        file.create_dataset(
            path, data=stacked, maxshape=(None, *stacked.shape[1:]), chunks=stacked.shape
        )
    file[crc32] = np.array([checksum(map(np.atleast_1d, row.values())) for row in rows], "<u4")
    file[crc32].attrs["order"] = list(rows[0])


@pytest.fixture
def dataset_1_2(
    tmp_path: Path,
    make_shot: Callable[..., ShotRecord],
    make_provenance: Callable[..., Provenance],
    make_drift: Callable[..., DriftRecord],
) -> Path:
    """Three shots between two drift checks."""
    path, shots, provenance = (
        tmp_path / "old.h5",
        [make_shot(i) for i in range(3)],
        make_provenance(3),
    )
    checks = [make_drift(0), make_drift(3)]
    with h5py.File(path, "w") as file:
        file.attrs["tronlab_schema"] = "1.2"
        write_rows(file, [values_1_2(shot) for shot in shots], "entry/shots/values_crc32")
        write_rows(file, [drift_1_2(check) for check in checks], "entry/drift/crc32")
        file["entry/drift"].attrs["reflectors"] = list(checks[0].readings)
        file["entry/drift/n_committed"] = np.int64(2)
        stacks = {
            "image": [shot.frame.image for shot in shots],
            "mask": [shot.mask.astype(np.uint8) for shot in shots],
        }
        for name, stack in stacks.items():
            where = f"entry/instrument/camera/{name}"
            file.create_dataset(where, data=np.array(stack), chunks=(1, 48, 64))
            file[f"{where}_crc32"] = np.array([checksum([array]) for array in stack], "<u4")
        texts = {
            "title": provenance.campaign_name,
            "start_time": "2026-11-20T10:00:00.000+00:00",
            "end_time": b"2026-11-20T11:00:00.000+00:00",
            "campaign/data": provenance.campaign_yaml,
            "rig/data": provenance.rig_yaml,
            "calibration/data": provenance.calibration_json,
            "instrument/name": provenance.rig_name,
            "recording/plan_sha256": provenance.plan_sha256,
            "recording/reason": "",
            "recording/status": b"complete",
        }
        for name, text in texts.items():
            file[f"entry/{name}"] = text
        for name, number in {"seed": 42, "n_shots_planned": 3, "n_committed": 3}.items():
            file[f"entry/recording/{name}"] = np.int64(number)
        for name in ("software", "devices"):
            file.create_group(f"entry/{name}").attrs.update(getattr(provenance, name))
        model = file.create_group("entry/instrument/camera/model")
        model.attrs.update(provenance.camera.to_dict())
    return path


def test_a_file_of_layout_1_2_is_read_as_one_session_without_quality(
    dataset_1_2: Path,
    make_shot: Callable[..., ShotRecord],
    make_provenance: Callable[..., Provenance],
) -> None:
    with Dataset(dataset_1_2) as dataset:
        assert dataset.schema_version == "1.2"
        assert dataset.provenance == make_provenance(3)
        assert (dataset.n_shots, dataset.n_rows, dataset.superseded_rows) == (3, 3, ())
        assert dataset.shots_with_damaged_values() == ()
        assert dataset.truth_states == ("good",) * 3
        (session,) = dataset.sessions
        assert (session.number, session.kind) == (1, "run")
        assert session.start_utc == "2026-11-20T10:00:00.000+00:00"
        assert session.calibration_json == make_provenance(3).calibration_json
        assert (dataset.uuid, dataset.segments, dataset.can_go_on) == (None, (), False)
        for i in range(3):
            found, given = dataset.shot(i), make_shot(i)
            np.testing.assert_array_equal(found.frame.image, given.frame.image)
            np.testing.assert_array_equal(found.mask, given.mask)
            np.testing.assert_array_equal(found.truth.covariance, given.truth.covariance)
            assert found.room == given.room
            assert (found.quality, found.timing, found.session) == (None, None, 1)
            assert not found.n_failures
