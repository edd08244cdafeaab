"""The hand-eye transform by our least squares against all closed forms of OpenCV, on the same sets.

    python benchmarks/hand_eye.py [--sets 40] [--stations 20] [--opencv4 .opencv4]

Each set is a laboratory of its own: random camera, board bow, hand-eye transform and place of the
board, seen from random stations, with noise in corners and readings. Both sides get the same
corners and readings; the closed forms get the poses of the board by our calibrated camera, bow and
all. OpenCV 5 has no hand-eye calibration, so OpenCV 4.14 is taken from the folder where `make test`
lays it. Prints median errors and their ratio to ours; exit code 1 if any method is better.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.calib.camera.board import BoardView, corner_points
from tronlab.calib.camera.bow import bowed
from tronlab.calib.camera.intrinsics import solve_intrinsics
from tronlab.calib.hand_eye.bundle import Station
from tronlab.calib.hand_eye.solution import solve_hand_eye
from tronlab.devices.laboratory import PatternSpec
from tronlab.devices.readings import PoseReading
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import rotation_angle_rad
from tronlab.geometry.uncertainty import perturb

FOLDER = Path(__file__).parent
PATTERN = PatternSpec(columns=10, rows=8, square_m=0.05, marker_m=0.035)
NOMINAL = CameraModel(
    width_px=1024, height_px=1024, fx_px=744.2, fy_px=744.2, cx_px=511.5, cy_px=511.5
)
SIGMA_PX = 0.1
BOW_SIGMA_M = 2e-4
SIGMA_M, SIGMA_RAD = 22e-6, np.radians(0.005)
"""Of the T-MAC: half of 15 um + 6 um/m at 5 m, and half of 0.01 deg."""
MIN_CORNERS = 20
OURS = "least squares"


@dataclass(frozen=True)
class SolvedSet:
    """One set, the truth, and what came out."""

    stations: list[Station]
    cam_from_board: tuple[RigidTransform, ...]
    truth: RigidTransform
    found: RigidTransform
    seconds: float


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sets", type=int, default=40)
    parser.add_argument("--stations", type=int, default=20)
    parser.add_argument("--opencv4", type=Path, default=FOLDER.parent / ".opencv4")
    options = parser.parse_args()
    sets = [solve_set(seed, options.stations) for seed in track(range(options.sets))]
    errors = {OURS: np.array([error(one.found, one.truth) for one in sets])}
    errors |= opencv_errors(sets, options.opencv4)
    print_table(errors)
    print(f"least squares: {1e3 * np.median([one.seconds for one in sets]):.0f} ms a set")
    medians = {name: np.median(values, axis=0) for name, values in errors.items()}
    sys.exit(0 if all((medians[OURS] <= median).all() for median in medians.values()) else 1)


def solve_set(seed: int, n_stations: int) -> SolvedSet:
    """Make a laboratory and solve it."""
    rng = np.random.default_rng(seed)
    tmac_from_cam = RigidTransform.from_components(
        rng.uniform(-0.2, 0.2, 3), Rotation.random(rng=rng)
    )
    stations = make_stations(rng, n_stations, tmac_from_cam)
    intrinsics = solve_intrinsics([station.view for station in stations], NOMINAL, PATTERN)
    begin = time.perf_counter()
    solution = solve_hand_eye(stations, intrinsics, PATTERN)
    return SolvedSet(
        stations=stations,
        cam_from_board=intrinsics.cam_from_board,
        truth=tmac_from_cam,
        found=solution.hand_eye.tmac_from_cam,
        seconds=time.perf_counter() - begin,
    )


def make_stations(rng: np.random.Generator, n: int, tmac_from_cam: RigidTransform) -> list[Station]:
    """Measure a board from random stations."""
    camera = CameraModel(
        width_px=NOMINAL.width_px,
        height_px=NOMINAL.height_px,
        fx_px=NOMINAL.fx_px * rng.normal(1.0, 0.01),
        fy_px=NOMINAL.fy_px * rng.normal(1.0, 0.01),
        cx_px=NOMINAL.cx_px + rng.normal(0.0, 8.0),
        cy_px=NOMINAL.cy_px + rng.normal(0.0, 8.0),
        distortion=tuple(rng.normal([-0.1, 0.05, 0.0, 0.0], [0.02, 0.02, 2e-4, 2e-4])),
    )
    p_board_m = bowed(corner_points(PATTERN), PATTERN, BOW_SIGMA_M * rng.normal(size=3))
    trk_from_board = RigidTransform.from_components(
        rng.uniform(-3.0, 3.0, 3), Rotation.random(rng=rng)
    )
    stations: list[Station] = []
    while len(stations) < n:
        cam_from_board = random_view(rng)
        view = observe(camera, cam_from_board, p_board_m, rng)
        if len(view) >= MIN_CORNERS:
            trk_from_tmac = trk_from_board * cam_from_board.inv() * tmac_from_cam.inv()
            stations.append(Station(read(trk_from_tmac, rng), view))
    return stations


def random_view(rng: np.random.Generator) -> RigidTransform:
    """Give ``cam_from_board`` with the board more or less in view."""
    centre = np.array([PATTERN.columns, PATTERN.rows, 0.0]) * PATTERN.square_m / 2
    turn = Rotation.from_euler("xyz", rng.uniform(-1, 1, 3) * [0.5, 0.5, 1.4])
    aim = rng.uniform(0.4, 0.8) * np.array([*rng.uniform(-0.35, 0.35, 2), 1.0])
    return RigidTransform.from_components(aim - turn.apply(centre), turn)


def observe(
    camera: CameraModel,
    cam_from_board: RigidTransform,
    p_board_m: np.ndarray,
    rng: np.random.Generator,
) -> BoardView:
    """Give the corners in the image, with noise."""
    uv = camera.project(cam_from_board.apply(p_board_m))
    uv += SIGMA_PX * rng.normal(size=uv.shape)
    ids = np.flatnonzero(
        ((uv > 2) & (uv < [camera.width_px - 3, camera.height_px - 3])).all(axis=1)
    )
    return BoardView(ids, corner_points(PATTERN)[ids], uv[ids])


def read(trk_from_tmac: RigidTransform, rng: np.random.Generator) -> PoseReading:
    """Measure a pose with the tracker's noise."""
    sigma = np.repeat([SIGMA_RAD, SIGMA_M], 3)
    noisy = perturb(trk_from_tmac, sigma * rng.normal(size=6))
    return PoseReading(noisy, np.diag(sigma**2), time_s=0.0)


def opencv_errors(sets: list[SolvedSet], folder: Path) -> dict[str, np.ndarray]:
    """Run OpenCV 4 in a process of its own, since one process has one OpenCV."""
    if not (folder / "cv2").exists():
        sys.exit(f"{folder}: no OpenCV 4.14 there; `make test` lays it there, or give --opencv4")
    poses = [
        {
            "trk_from_tmac": [
                station.reading.trk_from_tmac.as_matrix().tolist() for station in one.stations
            ],
            "cam_from_board": [pose.as_matrix().tolist() for pose in one.cam_from_board],
        }
        for one in sets
    ]
    answer = subprocess.run(
        [sys.executable, FOLDER / "opencv_hand_eye.py"],
        input=json.dumps(poses),
        env={**os.environ, "PYTHONPATH": str(folder)},
        capture_output=True,
        text=True,
        check=True,
    )
    solutions = json.loads(answer.stdout)
    return {
        name: np.array(
            [
                error_of_matrix(found[name], one.truth)
                for found, one in zip(solutions, sets, strict=True)
            ]
        )
        for name in solutions[0]
    }


def error_of_matrix(matrix: list | None, truth: RigidTransform) -> tuple[float, float]:
    """Give the error of a method that may have found nothing."""
    if matrix is None:
        return np.inf, np.inf
    return error(RigidTransform.from_matrix(matrix), truth)


def error(found: RigidTransform, truth: RigidTransform) -> tuple[float, float]:
    """Give the errors of position, m, and angle, rad."""
    shift = found.translation - truth.translation
    return float(np.linalg.norm(shift)), rotation_angle_rad(found, truth)


def print_table(errors: dict[str, np.ndarray]) -> None:
    """Print a line a method."""
    table = Table("method", "position um", "ratio", "angle mdeg", "ratio", "ours is nearer")
    for name, values in errors.items():
        position, angle = np.median(values, axis=0)
        ratios = np.median(values, axis=0) / np.median(errors[OURS], axis=0)
        nearer = (errors[OURS] < values).mean(axis=0)
        table.add_row(
            name,
            f"{1e6 * position:.1f}",
            f"{ratios[0]:.2f}",
            f"{1e3 * np.degrees(angle):.3f}",
            f"{ratios[1]:.2f}",
            "" if name == OURS else f"{nearer[0]:.0%} / {nearer[1]:.0%}",
        )
    Console().print(table)


if __name__ == "__main__":
    main()
