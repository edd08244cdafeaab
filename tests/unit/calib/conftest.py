"""A synthetic calibration: known camera, hand-eye transform and board, seen from many stations."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.calib.camera.board import BoardView, corner_points
from tronlab.calib.hand_eye.bundle import Station
from tronlab.devices.laboratory import BoardSpec, PoseSpec
from tronlab.devices.readings import PoseReading
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.uncertainty import perturb

BOARD = BoardSpec(
    columns=8,
    rows=6,
    square_m=0.08,
    marker_m=0.06,
    trs_from_board=PoseSpec(xyz_m=(1.0, 2.0, 0.5)),
)
CAMERA = CameraModel(
    width_px=1024,
    height_px=1024,
    fx_px=764.2,
    fy_px=764.9,
    cx_px=515.3,
    cy_px=506.8,
    distortion=(-0.1, 0.09, 4e-4, -3e-4, 0.0),
)
NOMINAL = replace(CAMERA, fx_px=744.0, fy_px=744.0, cx_px=511.5, cy_px=511.5, distortion=(0.0,) * 5)
TRACKER_COVARIANCE = np.diag([1e-4] * 3 + [4e-5] * 3) ** 2


@dataclass(frozen=True)
class Scene:
    """The truth, and what was measured of it."""

    tmac_from_cam: RigidTransform
    trk_from_board: RigidTransform
    cam_from_board: tuple[RigidTransform, ...]
    stations: tuple[Station, ...]

    @property
    def views(self) -> list[BoardView]:
        return [station.view for station in self.stations]

    @property
    def readings(self) -> list[RigidTransform]:
        return [station.reading.trk_from_tmac for station in self.stations]


def look_at_board(
    rng: np.random.Generator, turn: Rotation | None = None, *, zoom: float = 1.0
) -> RigidTransform:
    """Give ``cam_from_board`` with the board in view; ``turn`` replaces the random rotation.

    ``zoom`` is how much longer the lens is than that of ``CAMERA``.
    """
    centre = np.array([BOARD.columns, BOARD.rows, 0.0]) * BOARD.square_m / 2
    if turn is None:
        tilt = Rotation.from_euler("xy", rng.uniform(-0.5, 0.5, 2))
        turn = tilt * Rotation.from_euler("z", rng.uniform(-1.4, 1.4))
    distance = zoom * rng.uniform(0.5, 0.9)
    aim = distance * np.array([*(rng.uniform(-0.35, 0.35, 2) / zoom), 1.0])
    return RigidTransform.from_components(aim - turn.apply(centre), turn)


def observe(
    cam_from_board: RigidTransform,
    rng: np.random.Generator,
    sigma_px: float,
    *,
    camera: CameraModel = CAMERA,
    every: int = 1,
) -> BoardView:
    """Give the corners in view; ``every`` thins them out to save time."""
    points = corner_points(BOARD)
    uv = camera.project(cam_from_board.apply(points)) + sigma_px * rng.normal(size=(len(points), 2))
    is_inside = ((uv > 2) & (uv < 1021)).all(axis=1)
    ids = np.flatnonzero(is_inside)[::every]
    return BoardView(ids, points[ids], uv[ids])


def make_scene(
    seed: int,
    *,
    n: int = 20,
    noise: float = 1.0,
    sigma_px: float = 0.05,
    turns: list[Rotation] | None = None,
    every: int = 1,
) -> Scene:
    rng = np.random.default_rng(seed)
    tmac_from_cam = RigidTransform.from_components(
        rng.uniform(-0.2, 0.2, 3), Rotation.random(rng=rng)
    )
    trk_from_board = RigidTransform.from_components(
        rng.uniform(-3.0, 3.0, 3), Rotation.random(rng=rng)
    )
    poses, stations = [], []
    while len(stations) < n:
        turn = turns[len(stations)] if turns is not None else None
        cam_from_board = look_at_board(rng, turn)
        view = observe(cam_from_board, rng, noise * sigma_px, every=every)
        if len(view) < 12:
            continue
        truth = trk_from_board * cam_from_board.inv() * tmac_from_cam.inv()
        error = noise * rng.multivariate_normal(np.zeros(6), TRACKER_COVARIANCE)
        reading = PoseReading(perturb(truth, error), TRACKER_COVARIANCE, time_s=float(n))
        poses.append(cam_from_board)
        stations.append(Station(reading, view))
    return Scene(tmac_from_cam, trk_from_board, tuple(poses), tuple(stations))


@pytest.fixture(scope="session")
def scene() -> Callable[..., Scene]:
    return make_scene


@pytest.fixture(scope="session")
def bench() -> SimpleNamespace:
    """What synthetic views are made of."""
    return SimpleNamespace(
        board=BOARD, camera=CAMERA, nominal=NOMINAL, observe=observe, look_at_board=look_at_board
    )
