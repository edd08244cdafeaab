"""Rendered laboratories, calibrated by the wizard: are the errors what the covariances say?

    python benchmarks/calibration.py [--laboratories N] [--first SEED] [--shots N]

Every laboratory is another one: mountings, lens, bow of the board, places of tracker and lamp. The
wizard runs on it from beginning to end, unattended, on whole images of the board in front of the
terrain. Then truth is measured at random poses of the camera, 0.5 to 4.9 m from the model. Prints a
line a laboratory and, in the end, a table: mean squared error in units of the covariance with its
99 % bounds, how often a 95 % region holds the truth, and the median errors.
"""

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform
from scipy.stats import chi2

from tronlab.calib.record import CalibrationRecord
from tronlab.calib.results import Results
from tronlab.calib.wizard.bench import Bench
from tronlab.calib.wizard.dialogue import Unattended
from tronlab.calib.wizard.session import ALL_PARTS, calibrate
from tronlab.campaign.rig import load_rig
from tronlab.devices.registry import KINDS, DeviceContext, Devices, make_device
from tronlab.geometry.poses import FloatArray, pose_along_boresight, rotation_angle_rad
from tronlab.geometry.uncertainty import pose_difference
from tronlab.render.heightfield import HeightfieldRenderer
from tronlab.twin.devices import WORLD_KEY
from tronlab.twin.world import World, WorldSetup

TWIN_YAML = Path(__file__).parents[1] / "campaigns" / "rigs" / "twin.yaml"
DATE = "2026-01-01T00:00:00Z"
RANGE_M = (0.5, 4.9)


@dataclass(frozen=True)
class Misfit:
    """An error, and its square in units of the covariance."""

    chi_square: float
    distance_m: float
    angle_rad: float


@dataclass(frozen=True)
class Outcome:
    """What came of one laboratory."""

    frame: Misfit
    hand_eye: Misfit
    shots: tuple[Misfit, ...]
    missed_m: tuple[float, ...]
    """By how much the camera missed the pose it was sent to, each shot."""


class Quiet:
    """Tells nothing: a line a laboratory is enough."""

    def announce(self, _text: str) -> None:
        """Say nothing."""

    def advance(self, _stage: str, *, n_done: int, n_all: int) -> None:
        """Say nothing."""


def open_laboratory(
    setup: WorldSetup, renderer: HeightfieldRenderer, seed: int
) -> tuple[World, Devices]:
    config = setup.config.model_copy(update={"seed": seed})
    setup = WorldSetup(config, setup.laboratory, setup.load_heightmap)
    world = World(setup, make_renderer=lambda _heightmap: renderer)
    devices = {}
    for kind in KINDS:
        context = DeviceContext(kind, options={}, seed=seed, world=setup)
        context.shared[WORLD_KEY] = world
        devices[kind] = make_device(f"twin.{kind}", kind, context)
        devices[kind].connect()
    return world, Devices(**devices)


def misfit(found: RigidTransform, truth: RigidTransform, covariance: FloatArray) -> Misfit:
    error = pose_difference(found, truth)
    return Misfit(
        chi_square=float(error @ np.linalg.solve(covariance, error)),
        distance_m=float(np.linalg.norm(error[3:])),
        angle_rad=rotation_angle_rad(found, truth),
    )


def calibrated(world: World, devices: Devices) -> CalibrationRecord:
    bench = Bench(
        devices, world.spec, Unattended(Quiet()), world.spec.mounting.nominal, utc_now=lambda: DATE
    )
    draft = CalibrationRecord("twin", DATE, software={}, devices={}, results=Results())
    return calibrate(ALL_PARTS, bench, draft)


def shoot(
    world: World, devices: Devices, record: CalibrationRecord, rng: np.random.Generator
) -> tuple[Misfit, float]:
    """Give the error of truth, and by how much the camera misses the pose it was sent to."""
    place = [*rng.uniform([0.6, 1.2], [1.6, 3.0]), rng.uniform(*RANGE_M)]
    wanted = pose_along_boresight(place, boresight=[0, 0, -1], right=[0, 1, 0])
    target = record.mounting(world.spec.mounting).robot_target(wanted)
    devices.robot.move(target, timeout_s=1e3)
    found, covariance = record.trs_from_cam(devices.tracker.measure_pose(window_s=2.0))
    truth = world.truth.trs_from_cam
    missed_m = float(np.linalg.norm(truth.translation - wanted.translation))
    return misfit(found, truth, covariance), missed_m


def outcome(world: World, devices: Devices, *, n_shots: int, seed: int) -> Outcome:
    record = calibrated(world, devices)
    rng = np.random.default_rng(seed)
    shots, missed_m = zip(
        *(shoot(world, devices, record, rng) for _ in range(n_shots)), strict=True
    )
    frame, hand_eye, truth = record.results.frame, record.results.hand_eye, world.truth
    assert frame is not None
    assert hand_eye is not None
    tmac_from_cam = truth.trs_from_tmac.inv() * truth.trs_from_cam
    return Outcome(
        frame=misfit(frame.trs_from_trk, truth.trk_from_trs.inv(), frame.covariance),
        hand_eye=misfit(hand_eye.tmac_from_cam, tmac_from_cam, hand_eye.covariance),
        shots=shots,
        missed_m=missed_m,
    )


def row(name: str, misfits: list[Misfit]) -> str:
    n = len(misfits)
    chi_squares = np.array([misfit.chi_square for misfit in misfits])
    low, high = chi2.ppf([0.005, 0.995], 6 * n) / n
    inside = 100 * np.mean(chi_squares < chi2.ppf(0.95, 6))
    distances = [misfit.distance_m for misfit in misfits]
    angles = [misfit.angle_rad for misfit in misfits]
    return (
        f"{name:10}{n:5}{chi_squares.mean():8.2f}   {low:5.2f} to {high:5.2f}{inside:8.1f}"
        f"{1e3 * np.median(distances):11.4f}{np.degrees(np.median(angles)):11.5f}"
    )


def print_table(outcomes: list[Outcome]) -> None:
    print(f"{'':10}    n    mean    99 % bounds 95 % in  median mm median deg")
    print(row("frame", [one.frame for one in outcomes]))
    print(row("hand-eye", [one.hand_eye for one in outcomes]))
    print(row("shots", [one.shots[0] for one in outcomes]))
    print("Shots of one laboratory share its calibration; those above are the first of each.")
    shots = [shot for one in outcomes for shot in one.shots]
    missed_mm = 1e3 * np.concatenate([one.missed_m for one in outcomes])
    print(
        f"All {len(shots)} shots, medians: camera centre"
        f" {1e3 * np.median([shot.distance_m for shot in shots]):.4f} mm,"
        f" {np.degrees(np.median([shot.angle_rad for shot in shots])):.5f} deg;"
        f" poses missed by {np.median(missed_mm):.2f} mm, at most {missed_mm.max():.2f} mm"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--laboratories", type=int, default=20, metavar="N")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="of the laboratories")
    parser.add_argument("--shots", type=int, default=5, metavar="N", help="a laboratory")
    arguments = parser.parse_args()
    setup = load_rig(TWIN_YAML).world_setup()
    assert setup is not None
    print("making the terrain", flush=True)
    heightmap = setup.load_heightmap()
    setup = WorldSetup(setup.config, setup.laboratory, lambda: heightmap)
    renderer = HeightfieldRenderer(heightmap)
    outcomes: list[Outcome] = []
    n, began_s = arguments.laboratories, time.monotonic()
    for seed in range(arguments.first, arguments.first + n):
        world, devices = open_laboratory(setup, renderer, seed)
        one = outcome(world, devices, n_shots=arguments.shots, seed=seed)
        outcomes.append(one)
        each_s = (time.monotonic() - began_s) / len(outcomes)
        print(
            f"{len(outcomes)} of {n}, seed {seed}: chi-squares of 6: frame"
            f" {one.frame.chi_square:.1f}, hand-eye {one.hand_eye.chi_square:.1f}, shot"
            f" {one.shots[0].chi_square:.1f}; {each_s:.0f} s each,"
            f" {(n - len(outcomes)) * each_s / 60:.0f} min left",
            flush=True,
        )
    print_table(outcomes)


if __name__ == "__main__":
    main()
