"""Laboratories, calibrated and used: errors are as large as the covariances say.

Each has mountings, a lens, a bowed board and a place of the tracker of its own, drawn by the twin.
The tracker measures with its stated noise; corners are projected and get noise, not rendered. With
TRONLAB_LABORATORIES=200 in the environment there are so many; benchmarks/calibration.py has images.
"""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from records import make_record
from scipy.spatial.transform import RigidTransform
from scipy.stats import binom, chi2

from tronlab.calib.camera.board import BoardView, corner_points
from tronlab.calib.camera.bow import bowed
from tronlab.calib.inputs import (
    CameraValues,
    FrameInput,
    Inputs,
    PoseInput,
    StationInput,
    StationsInput,
    ViewInput,
    points_of,
)
from tronlab.calib.solve import solve
from tronlab.calib.wizard.stations import plan_stations
from tronlab.calib.wizard.tracker import mean_reading
from tronlab.campaign.rig import load_rig
from tronlab.devices.readings import PointReading
from tronlab.geometry.poses import FloatArray, pose_along_boresight, rotation_angle_rad
from tronlab.geometry.uncertainty import pose_difference
from tronlab.twin.instruments import TrackerOptics
from tronlab.twin.truth import deviate
from tronlab.twin.world import World, WorldSetup

TWIN_YAML = Path(__file__).parents[3] / "campaigns" / "rigs" / "twin.yaml"
N_CHUNKS = 4
N_A_CHUNK = int(os.environ.get("TRONLAB_LABORATORIES", "48")) // N_CHUNKS
N_STATIONS = 20
N_REFLECTOR_READINGS = 8
CORNER_SIGMA_PX = 0.05
EDGE_PX = 3.0
RANGE_M = (0.5, 4.9)
RESULTS = ("frame", "hand-eye", "shot")


@dataclass(frozen=True)
class Outcome:
    """How far a laboratory's calibration is off."""

    misfits: FloatArray
    """Squared error of frame, hand-eye and truth of a shot in units of its covariance."""
    centre_error_m: float
    turn_error_rad: float


class Laboratory:
    """A laboratory somebody calibrates."""

    def __init__(self, setup: WorldSetup, plan: Sequence[RigidTransform], seed: int) -> None:
        config = setup.config.model_copy(update={"seed": seed})
        self.world = World(WorldSetup(config, setup.laboratory, setup.load_heightmap))
        self.spec = setup.laboratory
        self._plan = plan
        self._rng = np.random.default_rng(seed)
        self.tracker = TrackerOptics(self.world, self._rng)
        self._trs_from_board = deviate(
            self.spec.board.trs_from_board.pose, config.board.placement, self._rng
        )

    def inputs(self) -> Inputs:
        date = "2026-01-02T03:04:05Z"
        reflectors = self.spec.reflectors
        frame = FrameInput(
            measured_utc=date,
            reflectors=reflectors,
            points=points_of({name: self.reflector(name) for name in reflectors.points_m}),
        )
        stations = StationsInput(
            measured_utc=date,
            pattern=self.spec.board.pattern,
            nominal=CameraValues.of(self.spec.camera.nominal_model),
            stations=tuple(self.stations()),
        )
        return Inputs(frame=frame, hand_eye=stations)

    def reflector(self, name: str) -> PointReading:
        readings = [self.tracker.point(name) for _ in range(N_REFLECTOR_READINGS)]
        return mean_reading(readings)[0]

    def stations(self) -> Iterator[StationInput]:
        for trs_from_cam in self._plan:
            self.drive(trs_from_cam)
            yield StationInput(
                reading=PoseInput.of(self.tracker.pose()), view=ViewInput.of(self.view())
            )

    def drive(self, trs_from_cam: RigidTransform) -> None:
        """Drive to a nominal pose; where that is depends on the true mounting."""
        target = self.spec.mounting.nominal.robot_target(trs_from_cam)
        self.world.stand_robot(target, actual=target)

    def view(self) -> BoardView:
        camera, pattern = self.world.laboratory.camera, self.spec.board.pattern
        flat = corner_points(pattern)
        cam_from_board = self.world.truth.trs_from_cam.inv() * self._trs_from_board
        corners = bowed(flat, pattern, self.world.laboratory.board_bow_m)
        uv = camera.project(cam_from_board.apply(corners))
        is_seen = ((uv > EDGE_PX) & (uv < [camera.width_px - 4, camera.height_px - 4])).all(axis=1)
        uv += CORNER_SIGMA_PX * self._rng.standard_normal(uv.shape)
        return BoardView(np.flatnonzero(is_seen), flat[is_seen], uv[is_seen])

    def shoot(self) -> None:
        """Stand where a campaign may take an image."""
        place = [*self._rng.uniform([0.6, 1.2], [1.6, 3.0]), self._rng.uniform(*RANGE_M)]
        self.drive(pose_along_boresight(place, boresight=[0, 0, -1], right=[0, 1, 0]))


@pytest.fixture(scope="module")
def setup() -> WorldSetup:
    setup = load_rig(TWIN_YAML).world_setup()
    assert setup is not None
    return setup


@pytest.fixture(scope="module")
def plan(setup: WorldSetup) -> tuple[RigidTransform, ...]:
    return plan_stations(setup.laboratory)[:N_STATIONS]


def calibrate_and_shoot(laboratory: Laboratory) -> Outcome:
    results = solve(laboratory.inputs())
    assert results.frame is not None
    assert results.hand_eye is not None
    laboratory.shoot()
    truth = laboratory.world.truth
    found, covariance = make_record(results).trs_from_cam(laboratory.tracker.pose())
    tmac_from_cam = truth.trs_from_tmac.inv() * truth.trs_from_cam
    frame, hand_eye = results.frame, results.hand_eye
    return Outcome(
        misfits=np.array(
            [
                misfit(frame.trs_from_trk, truth.trk_from_trs.inv(), frame.covariance),
                misfit(hand_eye.tmac_from_cam, tmac_from_cam, hand_eye.covariance),
                misfit(found, truth.trs_from_cam, covariance),
            ]
        ),
        centre_error_m=float(np.linalg.norm(found.translation - truth.trs_from_cam.translation)),
        turn_error_rad=rotation_angle_rad(found, truth.trs_from_cam),
    )


def misfit(found: RigidTransform, truth: RigidTransform, covariance: FloatArray) -> float:
    """Give the squared error in units of its covariance; chi-square of 6."""
    error = pose_difference(found, truth)
    return float(error @ np.linalg.solve(covariance, error))


@pytest.mark.parametrize("chunk", range(N_CHUNKS))
def test_errors_are_as_large_as_their_covariances_say(
    chunk: int, setup: WorldSetup, plan: tuple[RigidTransform, ...]
):
    """Sums of squares and 95 % regions within 99 % bounds; medians within what is wanted."""
    seeds = range(chunk * N_A_CHUNK, (chunk + 1) * N_A_CHUNK)
    outcomes = [calibrate_and_shoot(Laboratory(setup, plan, seed)) for seed in seeds]
    misfits = np.array([outcome.misfits for outcome in outcomes])
    low, high = chi2.ppf([0.005, 0.995], 6 * N_A_CHUNK)
    for name, total in zip(RESULTS, misfits.sum(axis=0), strict=True):
        assert low < total < high, name
    n_inside = int((misfits < chi2.ppf(0.95, 6)).sum())
    fewest, most = binom.ppf([0.005, 0.995], misfits.size, 0.95)
    assert fewest <= n_inside <= most
    assert np.median([outcome.centre_error_m for outcome in outcomes]) <= 0.15e-3
    assert np.degrees(np.median([outcome.turn_error_rad for outcome in outcomes])) <= 0.015
