from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2

from tronlab.calib.inputs import RobotStationInput
from tronlab.calib.reflectors.frame import solve_frame
from tronlab.calib.results import FrameResult, RobotResult
from tronlab.calib.robot.fit import fit_robot
from tronlab.calib.robot.model import RobotModel, RobotStations
from tronlab.calib.robot.solution import plan_robot_stations, solve_robot
from tronlab.campaign.rig import Rig, load_rig
from tronlab.devices.laboratory import MountingSpec
from tronlab.devices.mounting import Mounting
from tronlab.devices.readings import PoseReading, RobotReading, RobotTarget
from tronlab.errors import CalibrationError, DegenerateGeometryError
from tronlab.geometry.poses import pose_along_boresight
from tronlab.geometry.uncertainty import perturb, pose_difference
from tronlab.twin.instruments import Positioning, TrackerOptics
from tronlab.twin.reach import posture_at
from tronlab.twin.world import World, WorldSetup

TWIN_YAML = Path(__file__).parents[3] / "campaigns/rigs/twin.yaml"
TRACKER_COVARIANCE = np.diag([1e-4] * 3 + [4e-5] * 3) ** 2
FRAME_COVARIANCE = np.diag([2e-5, 1e-5, 3e-5, 5e-5, 4e-5, 3e-5]) ** 2
SIGMA_RAD, SIGMA_M = 2e-4, 3e-4
"""Of the robot."""


@pytest.fixture(scope="module")
def twin_rig() -> Rig:
    return load_rig(TWIN_YAML)


@pytest.fixture(scope="module")
def mounting(twin_rig: Rig) -> MountingSpec:
    return twin_rig.config.laboratory.mounting


@dataclass(frozen=True)
class Cell:
    """The truth, and what was measured of it."""

    trs_from_trk: RigidTransform
    model: RobotModel
    stations: list[RobotStationInput]

    @property
    def frame(self) -> FrameResult:
        return FrameResult(self.trs_from_trk, FRAME_COVARIANCE)

    def error(self, found: RobotResult) -> np.ndarray:
        """Give truth minus found, in the order of the covariance."""
        trs_from_rail = self.trs_from_trk * self.model.trk_from_rail
        return np.concatenate(
            [
                pose_difference(found.trs_from_rail, trs_from_rail),
                self.model.rail_axis - found.rail_axis,
                pose_difference(found.flange_from_tmac, self.model.flange_from_tmac),
            ]
        )


def make_cell(
    targets: tuple[RobotTarget, ...], *, seed: int = 1, robot: float = 1.0, tracker: float = 1.0
) -> Cell:
    """Draw a cell; robot and tracker are how much of their noise there is."""
    rng = np.random.default_rng(seed)

    def pose(scale):
        return RigidTransform.from_components(scale * rng.normal(size=3), Rotation.random(rng=rng))

    axis = np.array([1.0, 0.0, 0.0]) + 1e-3 * rng.normal(size=3)
    model = RobotModel(pose(3.0), axis, pose(0.1))
    sigma = robot * np.repeat([SIGMA_RAD, SIGMA_M], 3)
    stations = []
    for target in targets:
        came_to = perturb(target.base_from_flange, sigma * rng.normal(size=6))
        one = RobotStations(
            np.array([target.rail_m]),
            RigidTransform.concatenate([came_to]),
            RigidTransform.identity(1),
            TRACKER_COVARIANCE[None],
        )
        truth = (model.trk_from_flange(one) * model.flange_from_tmac)[0]
        noise = tracker * rng.multivariate_normal(np.zeros(6), TRACKER_COVARIANCE)
        reading = PoseReading(perturb(truth, noise), TRACKER_COVARIANCE, 0.0)
        encoders = RobotReading(target.rail_m, target.base_from_flange, 0.0)
        stations.append(RobotStationInput.of(encoders, reading))
    return Cell(pose(3.0), model, stations)


# --- the model ---


def test_jacobian_is_the_derivative_of_the_predictions(mounting) -> None:
    cell = make_cell(plan_robot_stations(mounting), robot=0.0, tracker=0.0)
    stations = RobotStations.of(cell.stations)
    analytic = cell.model.jacobian(stations)
    step = 1e-6
    for i in range(15):
        up, down = (cell.model.moved(sign * step * np.eye(15)[i]) for sign in (1, -1))
        numeric = (down.residuals(stations) - up.residuals(stations)) / (2 * step)
        np.testing.assert_allclose(analytic[:, :, i], numeric, atol=1e-6)


# --- what is found ---


def test_exact_readings_give_the_exact_cell(mounting) -> None:
    """However far the T-MAC and the rail are from where they were meant to be."""
    for seed in range(5):
        cell = make_cell(plan_robot_stations(mounting), seed=seed, robot=0.0, tracker=0.0)
        found = solve_robot(cell.stations, cell.frame, mounting)
        np.testing.assert_allclose(cell.error(found), 0.0, atol=1e-8)
        assert found.statistics["outliers"] == []
        assert found.statistics["held_out_max_m"] < 1e-8


def test_errors_agree_with_the_predicted_covariance(mounting) -> None:
    """Though the robot's own noise is not known beforehand."""
    targets = plan_robot_stations(mounting)
    rng = np.random.default_rng(2)
    nees, sigmas = [], []
    for seed in range(12):
        cell = make_cell(targets, seed=seed)
        off = np.sqrt(np.diag(FRAME_COVARIANCE)) * rng.normal(size=6)
        frame = replace(cell.frame, trs_from_trk=perturb(cell.trs_from_trk, off))
        found = solve_robot(cell.stations, frame, mounting)
        error = cell.error(found)
        nees.append(error @ np.linalg.solve(found.covariance, error))
        names = ("repeatability_sigma_rad", "repeatability_sigma_m")
        sigmas.append([found.statistics[name] for name in names])
    low, high = chi2.ppf([0.005, 0.995], 15 * len(nees))
    assert low < sum(nees) < high
    assert np.mean(np.array(nees) < chi2.ppf(0.95, 15)) >= 0.90
    rms = np.sqrt((np.array(sigmas) ** 2).mean(axis=0))
    np.testing.assert_allclose(rms, [SIGMA_RAD, SIGMA_M], rtol=0.05)


def test_held_out_error_is_that_of_a_fit_without_the_station(mounting) -> None:
    cell = make_cell(plan_robot_stations(mounting))
    fit = fit_robot(RobotStations.of(cell.stations))
    for i in (0, 7, 19):
        rest = [station for j, station in enumerate(cell.stations) if j != i]
        without = fit_robot(RobotStations.of(rest)).model
        error = without.residuals(RobotStations.of([cell.stations[i]]))[0]
        # Without the station the estimate of the noise is a little different too.
        off, own = (np.linalg.norm(r[i] - error) for r in (fit.held_out, fit.residuals))
        assert off < 0.2 * own


def test_outliers_are_listed_and_count_for_nothing(mounting) -> None:
    """Four of twenty: more than least squares alone could tell from noise."""
    cell = make_cell(plan_robot_stations(mounting), seed=3)
    off = {
        2: [0, 0, 0, 0.05, 0, 0],
        9: [0.02, 0, 0, 0, 0, 0],
        10: [0, 0, 0, 0, 0.01, 0],
        17: [0, 0.05, 0, 0, 0, 0.5],
    }
    stations = list(cell.stations)
    for i, difference in off.items():
        reading = stations[i].reading.reading
        moved = perturb(reading.trk_from_tmac, np.array(difference))
        encoders = RobotReading(stations[i].rail_m, stations[i].base_from_flange, 0.0)
        stations[i] = RobotStationInput.of(encoders, replace(reading, trk_from_tmac=moved))
    found = solve_robot(stations, cell.frame, mounting)
    assert found.statistics["outliers"] == list(off)
    rest = [station for i, station in enumerate(stations) if i not in off]
    clean = solve_robot(rest, cell.frame, mounting)
    np.testing.assert_allclose(cell.error(found), cell.error(clean), atol=1e-6)
    np.testing.assert_allclose(found.covariance, clean.covariance, rtol=0.01, atol=1e-12)


# --- what is refused ---


def changed(stations: list[RobotStationInput], **updates) -> list[RobotStationInput]:
    """Change fields of all stations; a function is applied to the old value."""
    return [
        s.model_copy(update={name: change(getattr(s, name)) for name, change in updates.items()})
        for s in stations
    ]


def test_too_few_stations_are_refused(mounting) -> None:
    cell = make_cell(plan_robot_stations(mounting)[:5])
    for n in (0, 5):
        with pytest.raises(DegenerateGeometryError, match=f"{n} stations, at least 6 needed"):
            solve_robot(cell.stations[:n], cell.frame, mounting)


def test_a_rail_that_stood_still_is_refused(mounting) -> None:
    targets = [replace(target, rail_m=2.0) for target in plan_robot_stations(mounting)]
    cell = make_cell(tuple(targets))
    with pytest.raises(
        DegenerateGeometryError, match=r"the rail moved by 0\.0000 m .at least 0\.1"
    ):
        solve_robot(cell.stations, cell.frame, mounting)


@pytest.mark.parametrize(
    ("axes", "message"),
    [((0, 0, 0), r"turned by 0\.00 deg"), ((0, 0, 1), r"about one axis \(.*1\.00\) of base only")],
)
def test_an_arm_that_hardly_turned_is_refused(mounting, axes, message) -> None:
    targets = plan_robot_stations(mounting)
    turned = [
        replace(
            target,
            base_from_flange=RigidTransform.from_components(
                target.base_from_flange.translation,
                Rotation.from_rotvec(0.2 * np.sin(i) * np.array(axes))
                * targets[0].base_from_flange.rotation,
            ),
        )
        for i, target in enumerate(targets)
    ]
    cell = make_cell(tuple(turned))
    with pytest.raises(DegenerateGeometryError, match=message):
        solve_robot(cell.stations, cell.frame, mounting)


def test_turns_that_go_with_the_rail_are_refused(mounting) -> None:
    """A hand that only rolls about its own axis, held in another way at each end of the rail."""
    targets = plan_robot_stations(mounting)
    held = [targets[i].base_from_flange.rotation for i in (0, 1)]
    rolled = [
        RobotTarget(
            rail_m=float(i % 2),
            base_from_flange=RigidTransform.from_components(
                target.base_from_flange.translation,
                held[i % 2] * Rotation.from_rotvec([0.0, 0.0, 0.5 * np.sin(i)]),
            ),
        )
        for i, target in enumerate(targets)
    ]
    cell = make_cell(tuple(rolled))
    with pytest.raises(DegenerateGeometryError, match="turns of the arm and moves of the rail go"):
        solve_robot(cell.stations, cell.frame, mounting)


def in_mm(seven: tuple[float, ...]) -> tuple[float, ...]:
    return (*(1000.0 * v for v in seven[:3]), *seven[3:])


def test_wrong_units_are_named(mounting) -> None:
    cell = make_cell(plan_robot_stations(mounting))
    cases = [
        ({"rail_m": lambda v: 1000.0 * v}, r"the base moves by 0\.0010\d* m .*unit is wrong"),
        (
            {"base_from_flange_xyz_m_quat_xyzw": in_mm},
            r"station \d+: the flange is .*in millimetres",
        ),
        (
            {
                "reading": lambda r: r.model_copy(
                    update={"trk_from_tmac_xyz_m_quat_xyzw": in_mm(r.trk_from_tmac_xyz_m_quat_xyzw)}
                )
            },
            "T-MAC: is .* from the tracker.*millimetres",
        ),
    ]
    for updates, message in cases:
        with pytest.raises(CalibrationError, match=message):
            solve_robot(changed(cell.stations, **updates), cell.frame, mounting)


def test_too_many_outliers_are_refused(mounting) -> None:
    cell, other = (make_cell(plan_robot_stations(mounting), seed=seed) for seed in (4, 5))
    mixed = [*cell.stations[:12], *other.stations[12:]]
    with pytest.raises(CalibrationError, match=r"robot: \d+ of 20 stations contradict the others"):
        solve_robot(mixed, cell.frame, mounting)


# --- on the twin ---


@pytest.fixture(scope="module")
def measured_robots(twin_rig) -> list[tuple[World, Positioning, Mounting, RobotResult]]:
    """Robots of other laboratories, calibrated by what the twin's instruments say."""
    return [_measured_robot(twin_rig, seed) for seed in range(5)]


def _measured_robot(rig, seed: int):
    spec, config = rig.config.laboratory, rig.config.world
    config = config.model_copy(update={"seed": seed})
    world = World(WorldSetup(config, spec, lambda: pytest.fail("nobody looks at the terrain")))
    rng = np.random.default_rng(seed)
    tracker, positioning = TrackerOptics(world, rng), Positioning(world, rng)
    points = {name: tracker.point(name) for name in spec.reflectors.points_m}
    frame = solve_frame(points, spec.reflectors)
    stations = []
    for target in plan_robot_stations(spec.mounting):
        drive(world, positioning, target)
        encoders = RobotReading(target.rail_m, target.base_from_flange, 0.0)
        stations.append(RobotStationInput.of(encoders, tracker.pose()))
    found = solve_robot(stations, frame, spec.mounting)
    lab = world.laboratory
    mounting = Mounting(
        trs_from_rail=found.trs_from_rail,
        rail_axis=found.rail_axis,
        flange_from_cam=found.flange_from_tmac * lab.flange_from_tmac.inv() * lab.flange_from_cam,
        arm_forward_m=spec.mounting.arm_forward_m,
    )
    return world, positioning, mounting, found


def drive(world: World, positioning: Positioning, target: RobotTarget) -> None:
    rail_range_m = world.spec.mounting.rail_range_m
    posture_at(target, near=None, rail_range_m=rail_range_m, device="robot", call="check")
    world.stand_robot(target, actual=positioning.actual(target))


def planned_poses(rng: np.random.Generator, n: int) -> list[RigidTransform]:
    """Give camera poses as campaigns plan them, all over the model, to and fro."""
    return [
        pose_along_boresight(
            [rng.uniform(0.6, 1.6), rng.uniform(1.4, 2.8), rng.uniform(0.9, 4.4)],
            boresight=[*rng.uniform(-0.3, 0.3, 2), -1.0],
            right=[0.0, 1.0, 0.0],
        )
        for _ in range(n)
    ]


def test_planned_camera_poses_are_met_within_a_millimetre(measured_robots) -> None:
    """Where the design alone leads the camera astray by centimetres."""
    misses_m, misses_by_design_m = [], []
    for seed, (world, positioning, calibrated, _) in enumerate(measured_robots):
        for pose in planned_poses(np.random.default_rng(100 + seed), 12):
            for mounting, found in (
                (calibrated, misses_m),
                (world.spec.mounting.nominal, misses_by_design_m),
            ):
                drive(world, positioning, mounting.robot_target(pose))
                reached = world.truth.trs_from_cam.translation
                found.append(np.linalg.norm(reached - pose.translation))
    assert max(misses_m) < 1e-3
    assert np.median(misses_by_design_m) > 5e-3


def test_twin_errors_agree_with_the_predicted_covariance(measured_robots) -> None:
    nees = []
    for world, _, _, found in measured_robots:
        lab = world.laboratory
        error = np.concatenate(
            [
                pose_difference(found.trs_from_rail, lab.trs_from_rail),
                lab.rail_axis - found.rail_axis,
                pose_difference(found.flange_from_tmac, lab.flange_from_tmac),
            ]
        )
        nees.append(error @ np.linalg.solve(found.covariance, error))
        assert found.statistics["repeatability_sigma_m"] == pytest.approx(1e-4, rel=0.5)
    low, high = chi2.ppf([0.005, 0.995], 15 * len(nees))
    assert low < sum(nees) < high


# --- the plan ---


def test_the_plan_goes_along_the_rail_and_turns_the_arm_about_all_axes(mounting) -> None:
    targets = plan_robot_stations(mounting)
    rails_m = np.array([target.rail_m for target in targets])
    assert len(rails_m) >= 10
    assert (np.diff(rails_m) > 0).all()
    low_m, high_m = mounting.rail_range_m
    assert low_m <= rails_m[0] < rails_m[-1] <= high_m
    assert np.ptp(rails_m) > 0.9 * (high_m - low_m)
    turns = Rotation.concatenate([target.base_from_flange.rotation for target in targets])
    vectors = (turns * turns[0].inv()).as_rotvec(degrees=True)
    assert np.linalg.norm(vectors, axis=1).max() < 30.0
    assert (np.abs(vectors).max(axis=0) > 10.0).all()
