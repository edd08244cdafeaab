"""A calibration record with readings, corners and results that fit, made without a rig."""

from dataclasses import replace
from typing import Any

import numpy as np
from records import make_record
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.calib.camera.board import BoardView, corner_points
from tronlab.calib.camera.bow import bowed
from tronlab.calib.camera.projection import (
    N_INTRINSICS,
    free_intrinsics,
    intrinsics_of,
    with_intrinsics,
)
from tronlab.calib.inputs import (
    CameraValues,
    FrameInput,
    Inputs,
    PoseInput,
    StationInput,
    StationsInput,
    ViewInput,
    numbers_of,
    point_readings,
    points_of,
)
from tronlab.calib.record import CalibrationRecord
from tronlab.calib.reflectors.frame import solve_frame
from tronlab.calib.results import (
    CameraResult,
    FrameResult,
    HandEyeResult,
    LampResult,
    Results,
    RobotResult,
)
from tronlab.devices.laboratory import PatternSpec, ReflectorsSpec
from tronlab.devices.readings import PointReading, PoseReading
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray
from tronlab.geometry.uncertainty import perturb

PATTERN = PatternSpec(columns=10, rows=8, square_m=0.05, marker_m=0.035)
REFLECTORS = ReflectorsSpec(bottom_left_m=(2.16, 0.0, 0.0), top_right_m=(0.0, 4.16, 0.0))
CAMERA = CameraModel(1024, 1024, 764.2, 764.9, 515.3, 506.8, (-0.1, 0.09, 4e-4, -3e-4, 0.0))
BOW_M = np.array([0.4e-3, -0.2e-3, 0.1e-3])
SIGMA_PX = 0.05
TURN_SIGMA_RAD = np.radians(0.01) / np.sqrt(3)
HAND_EYE_SIGMAS = np.array([2e-5] * 3 + [1.5e-5] * 3)
FRAME_SIGMAS = np.array([1e-5] * 3 + [4e-5] * 3)
LAMP_SIGMA_M = 1e-4
TRS_FROM_TRK = RigidTransform.from_components([1.1, 4.6, 2.8], Rotation.from_euler("x", 30, True))
TMAC_FROM_CAM = RigidTransform.from_components(
    [0.18, 0.0, -0.05], Rotation.from_euler("y", 180, True)
)
TRS_FROM_BOARD = RigidTransform.from_components(
    [0.88, 1.83, 0.7], Rotation.from_matrix([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
)


def tracker_sigma_m(distance_m: float) -> float:
    """Give the stated accuracy of one coordinate."""
    return 15e-6 + 6e-6 * distance_m


def measured_record(
    *, seed: int = 0, n_stations: int = 12, tracker_noise: float = 1.0, **fields: Any
) -> CalibrationRecord:
    """Give a record whose results are off by their covariance, drawn by ``seed``.

    ``tracker_noise`` is how much the T-MAC's readings scatter, in units of the stated accuracy.
    """
    rng = np.random.default_rng(seed)
    inputs = Inputs(
        frame=_frame_input(rng),
        hand_eye=StationsInput(
            measured_utc="2026-01-02T03:00:00Z",
            pattern=PATTERN,
            nominal=CameraValues.of(replace(CAMERA, distortion=())),
            stations=tuple(_station(rng, tracker_noise) for _ in range(n_stations)),
        ),
    )
    return make_record(_results(inputs, rng), inputs=inputs, **fields)


def _results(inputs: Inputs, rng: np.random.Generator) -> Results:
    frame = solve_frame(point_readings(inputs.frame.points), REFLECTORS)
    free = free_intrinsics("brown")
    sigmas = np.zeros(N_INTRINSICS)
    sigmas[free] = [0.02, 0.02, 0.03, 0.03, 1e-4, 3e-4, 1e-5, 1e-5, 2e-4]
    robot_sigmas = np.array([1e-4] * 3 + [1e-4] * 3 + [2e-5] * 3 + [1e-4] * 3 + [5e-5] * 3)
    robot = robot_sigmas * rng.normal(size=15)
    return Results(
        frame=FrameResult(
            perturb(TRS_FROM_TRK, FRAME_SIGMAS * rng.normal(size=6)),
            np.diag(FRAME_SIGMAS**2),
            frame.statistics,
        ),
        camera=CameraResult(_drawn(CAMERA, sigmas, rng), np.diag(sigmas**2), "brown", BOW_M),
        hand_eye=HandEyeResult(
            perturb(TMAC_FROM_CAM, HAND_EYE_SIGMAS * rng.normal(size=6)),
            np.diag(HAND_EYE_SIGMAS**2),
            statistics={
                "trk_from_board": numbers_of(TRS_FROM_TRK.inv() * TRS_FROM_BOARD),
                "corner_sigma_px": SIGMA_PX,
                "outlier_stations": [],
            },
        ),
        lamp=LampResult(
            np.array([-3.0, -2.5, 3.5]) + LAMP_SIGMA_M * rng.normal(size=3),
            LAMP_SIGMA_M**2 * np.eye(3),
        ),
        robot=RobotResult(
            perturb(RigidTransform.from_translation([2.3, 2.08, 6.0]), robot[:6]),
            np.array([1.0, 0.0, 0.0]) + robot[6:9],
            perturb(RigidTransform.from_translation([0.0, -0.09, 0.04]), robot[9:]),
            np.diag(robot_sigmas**2),
        ),
    )


def _drawn(camera: CameraModel, sigmas: FloatArray, rng: np.random.Generator) -> CameraModel:
    return with_intrinsics(camera, intrinsics_of(camera) + sigmas * rng.normal(size=N_INTRINSICS))


def _frame_input(rng: np.random.Generator) -> FrameInput:
    readings = {}
    for name, p_trs in REFLECTORS.points_m.items():
        p_trk = TRS_FROM_TRK.inv().apply(p_trs)
        sigma_m = tracker_sigma_m(float(np.linalg.norm(p_trk)))
        p_trk = p_trk + sigma_m * rng.normal(size=3)
        readings[name] = PointReading(name, p_trk, sigma_m**2 * np.eye(3), time_s=0.0)
    return FrameInput(
        measured_utc="2026-01-02T03:00:00Z", reflectors=REFLECTORS, points=points_of(readings)
    )


def _station(rng: np.random.Generator, tracker_noise: float) -> StationInput:
    while True:
        cam_from_board = _pose_before_board(rng)
        view = _view(cam_from_board, rng)
        if len(view) > 15:
            break
    trs_from_cam = TRS_FROM_BOARD * cam_from_board.inv()
    trk_from_tmac = TRS_FROM_TRK.inv() * trs_from_cam * TMAC_FROM_CAM.inv()
    sigma_m = tracker_sigma_m(float(np.linalg.norm(trk_from_tmac.translation)))
    sigmas = tracker_noise * np.array([TURN_SIGMA_RAD] * 3 + [sigma_m] * 3)
    reading = PoseReading(
        perturb(trk_from_tmac, sigmas * rng.normal(size=6)), np.diag(sigmas**2), time_s=0.0
    )
    return StationInput(reading=PoseInput.of(reading), view=ViewInput.of(view))


def _pose_before_board(rng: np.random.Generator) -> RigidTransform:
    middle = np.array([PATTERN.columns, PATTERN.rows, 0.0]) * PATTERN.square_m / 2
    tilt = Rotation.from_euler("xy", rng.uniform(-0.5, 0.5, 2))
    turn = tilt * Rotation.from_euler("z", rng.uniform(-1.4, 1.4))
    aim = rng.uniform(0.4, 0.9) * np.array([*rng.uniform(-0.4, 0.4, 2), 1.0])
    return RigidTransform.from_components(aim - turn.apply(middle), turn)


def _view(cam_from_board: RigidTransform, rng: np.random.Generator) -> BoardView:
    points = corner_points(PATTERN)
    seen = CAMERA.project(cam_from_board.apply(bowed(points, PATTERN, BOW_M)))
    seen = seen + SIGMA_PX * rng.normal(size=seen.shape)
    ids = np.flatnonzero(((seen > 2) & (seen < 1021)).all(axis=1))
    return BoardView(ids, points[ids], seen[ids])
