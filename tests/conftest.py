"""Fixtures shared by all tests: a seeded generator, a small camera, shots and a small dataset."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.dataset import schema
from tronlab.dataset.records import (
    DriftRecord,
    Provenance,
    ReferenceView,
    Session,
    ShotQuality,
    ShotRecord,
    ShotTiming,
    Truth,
)
from tronlab.dataset.writer import DatasetWriter
from tronlab.devices.readings import (
    Frame,
    PointReading,
    PoseReading,
    RobotReading,
    RoomReading,
)
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import xyz_quat_from_pose

TRS_FROM_TRK = RigidTransform.from_components([0.4, -1.0, 3.0], Rotation.from_rotvec([0.2, 2.9, 0]))
TMAC_FROM_CAM = RigidTransform.from_components([0.1, 0.02, 0.05], Rotation.from_rotvec([0, 0.1, 1]))
LOOKING_DOWN = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
REFLECTORS = ("top_left", "bottom_left", "top_right")

SMALL_CAMERA = CameraModel(
    width_px=64,
    height_px=48,
    fx_px=48.0,
    fy_px=48.2,
    cx_px=31.4,
    cy_px=23.7,
    distortion=(-0.11, 0.03, 1e-4, -2e-4, 0.0),
)


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator that gives every test the same numbers."""
    return np.random.default_rng(20261122)


@pytest.fixture
def small_camera() -> CameraModel:
    """A camera of 64 x 48 pixels with a little distortion."""
    return SMALL_CAMERA


@pytest.fixture
def make_shot() -> Callable[..., ShotRecord]:
    """The factory ``make_shot(i, shot_id=..., attempt=..., dtype=..., trs_from_cam=...)``."""
    return fake_shot


@pytest.fixture
def make_provenance() -> Callable[..., Provenance]:
    """The factory ``make_provenance(n_shots_planned=5)``."""
    return fake_provenance


@pytest.fixture
def make_view() -> Callable[[int], ReferenceView]:
    """The factory ``make_view(i)`` of reference views."""
    return fake_view


@pytest.fixture
def make_drift() -> Callable[..., DriftRecord]:
    """The factory ``make_drift(n_shots_before, is_within=True)`` of drift checks."""
    return fake_drift


@pytest.fixture
def make_session() -> Callable[..., Session]:
    """The factory ``make_session(number, kind="run", ...)`` of sessions."""
    return fake_session


@pytest.fixture(scope="session")
def recorded_datasets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the datasets that ``small_dataset`` and ``segmented_dataset`` copy."""
    folder = tmp_path_factory.mktemp("recorded")
    with DatasetWriter(folder / "dataset.h5", fake_provenance(5)) as writer:
        writer.add_references([fake_view(0), fake_view(1)])
        writer.plan_drift_checks(REFLECTORS, 2)
        writer.commit_drift(fake_drift(0))
        for i in range(5):
            writer.commit(fake_shot(i))
        writer.commit_drift(fake_drift(5))
        writer.finish("complete")
    in_segments = folder / "in_segments/dataset.h5"
    in_segments.parent.mkdir()
    with DatasetWriter(
        in_segments, fake_provenance(5), session=fake_session(1), segment_shots=2, n_spare_rows=3
    ) as writer:
        writer.add_references([fake_view(0)])
        writer.plan_drift_checks(REFLECTORS, 2)
        writer.commit_drift(fake_drift(0))
        for i in range(5):
            writer.commit(fake_shot(i, has_quality=True))
        writer.commit_drift(fake_drift(5))
        writer.finish("aborted", "operator")
    return folder


@pytest.fixture
def small_dataset(recorded_datasets: Path, tmp_path: Path) -> Path:
    """A complete and valid dataset of 5 shots (ids 0 to 4), 2 reference views, 2 drift checks."""
    return Path(shutil.copy(recorded_datasets / "dataset.h5", tmp_path))


@pytest.fixture
def segmented_dataset(recorded_datasets: Path, tmp_path: Path) -> Path:
    """As a run leaves it: 5 shots (ids 0 to 4) in segments of 2, room for 3 more, aborted."""
    folder = shutil.copytree(recorded_datasets / "in_segments", tmp_path / "recorded")
    return folder / "dataset.h5"


@pytest.fixture
def empty_dataset(tmp_path: Path) -> Path:
    """A dataset whose shots do not count: its counter is 0."""
    path = tmp_path / "empty.h5"
    with DatasetWriter(path, fake_provenance(5)) as writer:
        writer.commit(fake_shot(0))
    with h5py.File(path, "r+") as file:
        file[schema.N_COMMITTED][()] = 0
    return path


def fake_shot(
    i: int,
    *,
    shot_id: int | None = None,
    attempt: int = 1,
    dtype: type[np.uint8] | type[np.uint16] = np.uint8,
    trs_from_cam: RigidTransform | None = None,
    has_quality: bool = False,
) -> ShotRecord:
    """Shot ``i`` of the small camera, consistent in itself, all values distinct."""
    rng = np.random.default_rng([7, i])
    if trs_from_cam is None:
        tilt = Rotation.from_rotvec(rng.normal(0.0, 0.02, 3))
        position = [1.1 + 0.01 * i, 2.1, 4.0 - 0.05 * i]
        trs_from_cam = RigidTransform.from_components(position, tilt * LOOKING_DOWN)
    trk_from_tmac = TRS_FROM_TRK.inv() * trs_from_cam * TMAC_FROM_CAM.inv()
    mask = np.zeros(SMALL_CAMERA.shape, dtype=np.bool_)
    mask[4:-4, 3 + i % 5 :] = True
    return ShotRecord(
        shot_id=i if shot_id is None else shot_id,
        attempt=attempt,
        trs_from_cam_nominal=RigidTransform.from_translation([0, 0, 0.001 * (i + 1)])
        * trs_from_cam,
        robot=RobotReading(
            rail_m=0.5 + 0.05 * i,
            base_from_flange=RigidTransform.from_components(
                [1.0, 0.0, 1.5], Rotation.from_rotvec([0.0, 0.3 + 0.001 * i, 0.0])
            ),
            time_s=1.7e9 + 10 * i,
        ),
        tracker=PoseReading(
            trk_from_tmac=trk_from_tmac,
            covariance=_covariance(rng, 1.7e-4, 3e-5),
            time_s=1.7e9 + 10 * i + 1.25,
        ),
        room=RoomReading(
            air_temperature_k=293.15 + 0.01 * i,
            air_pressure_pa=95_000.0 + i,
            relative_humidity=0.4,
            is_door_closed=True,
            is_lamp_on=i % 2 == 0,
            time_s=1.7e9 + 10 * i + 1.5,
        ),
        frame=_frame(rng, i, dtype),
        mask=mask,
        truth=Truth(
            trs_from_cam=trs_from_cam,
            covariance=_covariance(rng, 2e-4, 5e-5),
            range_los_m=4.0 - 0.05 * i,
            usable_fraction=float(mask.mean()),
        ),
        quality=_quality(i) if has_quality else None,
        timing=_timing(i) if has_quality else None,
        n_failures={"tracking_lost": i, "quality": 1} if has_quality and i else {},
    )


def _quality(i: int) -> ShotQuality:
    return ShotQuality(
        settle_shift_m=1e-5 + 1e-7 * i,
        settle_turn_rad=2e-6,
        exposure_shift_m=3e-6,
        exposure_turn_rad=4e-6,
        tracker_sigma_m=1.5e-5,
        robot_shift_m=4e-4,
        robot_turn_rad=1e-4,
        saturated_fraction=0.001 * i,
        contrast=0.4,
        sharpness=0.7,
        brightness=None if i % 2 else 12.5,
        flags=("saturation", "brightness") if i == 3 else (),
    )


def _timing(i: int) -> ShotTiming:
    return ShotTiming(
        move_s=2.0 + i,
        settle_s=0.5,
        tracker_s=0.25,
        camera_s=0.02,
        confirm_s=0.1,
        read_s=0.01,
        lost_s=0.0 if i else 3.5,
    )


def fake_session(number: int = 1, kind: str = "run", **fields: object) -> Session:
    """Session ``number`` of the campaign with the small camera."""
    provenance = fake_provenance()
    values = {
        "start_utc": f"2026-11-2{number}T10:00:00.000+00:00",
        "campaign_path": "/lab/line.yaml",
        "rig_path": "/lab/rig.yaml",
        "calibration_path": "/lab/record.json",
        "campaign_yaml": provenance.campaign_yaml,
        "rig_yaml": provenance.rig_yaml,
        "calibration_json": provenance.calibration_json,
        "plan_sha256": provenance.plan_sha256,
        "seed": provenance.seed,
        "software": provenance.software,
        "devices": provenance.devices,
        "host": "laboratory",
        "pid": 1000 + number,
        "accepted": ("rig: another lamp",) if number > 1 else (),
    }
    return Session(number=number, kind=kind, **{**values, **fields})


def fake_provenance(n_shots_planned: int = 5) -> Provenance:
    """The provenance of a campaign with the small camera."""
    return Provenance(
        campaign_name="straight line",
        campaign_yaml="name: straight line\nn: 5  # µ\n",
        rig_name="twin",
        rig_yaml="name: twin\n",
        calibration_json=_calibration_json(),
        seed=42,
        software={"tronlab": "0.1.0", "python": "3.11.9"},
        devices={"camera": "Prosilica GC1380H 02-2166A 1.42", "t-mac/6": "Leica T-MAC 1 2"},
        plan_sha256="0" * 64,
        n_shots_planned=n_shots_planned,
        camera=SMALL_CAMERA,
    )


def fake_view(i: int) -> ReferenceView:
    """Reference view ``i`` of the small camera."""
    rng = np.random.default_rng([8, i])
    depth_m = rng.uniform(1.0, 4.0, SMALL_CAMERA.shape).astype(np.float32)
    depth_m[:3] = np.nan
    mask = np.ones(SMALL_CAMERA.shape, dtype=np.bool_)
    mask[:4] = False
    return ReferenceView(
        view_id=i,
        trs_from_cam=RigidTransform.from_components([1.1, 2.1, 4.0 - i], LOOKING_DOWN),
        image=rng.integers(1, 255, SMALL_CAMERA.shape, dtype=np.uint8),
        depth_m=depth_m,
        mask=mask,
    )


def fake_drift(n_shots_before: int, *, is_within: bool = True) -> DriftRecord:
    """A drift check after some shots, all values distinct."""
    rng = np.random.default_rng([9, n_shots_before])
    time_s = 1.7e9 + 10 * n_shots_before - 5.0
    return DriftRecord(
        n_shots_before=n_shots_before,
        time_s=time_s,
        readings={
            name: PointReading(
                target=name,
                p_trk_m=rng.normal(0.0, 3.0, 3),
                covariance_m2=np.diag(rng.uniform(1e-10, 1e-9, 3)),
                time_s=time_s + k,
            )
            for k, name in enumerate(REFLECTORS)
        },
        shift=rng.normal(0.0, 1e-5, 6),
        max_shift_m=1e-4 if is_within else 2e-3,
        limit_m=5e-4,
        is_within=is_within,
    )


def _covariance(rng: np.random.Generator, sigma_rad: float, sigma_m: float) -> np.ndarray:
    factor = np.diag([sigma_rad] * 3 + [sigma_m] * 3) @ rng.normal(size=(6, 6))
    return factor @ factor.T


def _frame(
    rng: np.random.Generator,
    i: int,
    dtype: type[np.uint8] | type[np.uint16],
) -> Frame:
    top, pixel_format = (255, "Mono8") if dtype is np.uint8 else (4095, "Mono12")
    return Frame(
        image=rng.integers(0, top + 1, SMALL_CAMERA.shape, dtype=dtype),
        pixel_format=pixel_format,
        exposure_s=0.02 + 0.001 * i,
        gain_db=1.5,
        frame_id=1000 + 3 * i,
        time_s=1.7e9 + 10 * i + 2.0,
    )


def _calibration_json() -> str:
    """The part of a calibration record that truth follows from."""
    return json.dumps(
        {
            "created_utc": "2026-11-20T10:00:00+00:00",
            "frame": {
                "trs_from_trk": {"xyz_m_quat_xyzw": xyz_quat_from_pose(TRS_FROM_TRK).tolist()}
            },
            "hand_eye": {
                "tmac_from_cam": {"xyz_m_quat_xyzw": xyz_quat_from_pose(TMAC_FROM_CAM).tolist()}
            },
        }
    )
