"""The error budget: parts that add up to the whole, and a whole that experiments confirm."""

from dataclasses import replace

import numpy as np
import pytest
from measured_record import (
    HAND_EYE_SIGMAS,
    LAMP_SIGMA_M,
    TURN_SIGMA_RAD,
    measured_record,
    tracker_sigma_m,
)
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.calib.budget import CONTRIBUTIONS, RELIEF_M, Budget, error_budget, sweep
from tronlab.calib.budget_table import budget_table, dominant
from tronlab.calib.camera.projection import intrinsics_of, with_intrinsics
from tronlab.calib.differences import image_shift_px
from tronlab.calib.record import CalibrationRecord
from tronlab.devices.readings import PoseReading
from tronlab.errors import CalibrationError
from tronlab.geometry.poses import pose_along_boresight
from tronlab.geometry.uncertainty import perturb

OBLIQUE = pose_along_boresight([0.4, 1.2, 2.0], boresight=[0.3, 0.2, -1.0], right=[0.1, 1.0, 0.0])


@pytest.fixture(scope="module")
def record() -> CalibrationRecord:
    return measured_record(seed=1)


@pytest.fixture(scope="module")
def budget(record: CalibrationRecord) -> Budget:
    return error_budget(record, [OBLIQUE])


@pytest.fixture(scope="module")
def swept(record: CalibrationRecord) -> Budget:
    return error_budget(record, sweep(record))


def reading_at(record: CalibrationRecord, trs_from_cam: RigidTransform) -> PoseReading:
    trk_from_tmac = record.trs_from_trk.inv() * trs_from_cam * record.tmac_from_cam.inv()
    sigma_m = tracker_sigma_m(float(np.linalg.norm(trk_from_tmac.translation)))
    covariance = np.diag([TURN_SIGMA_RAD**2] * 3 + [sigma_m**2] * 3)
    return PoseReading(trk_from_tmac, covariance, time_s=0.0)


def test_the_tracker_is_as_good_as_its_readings_say(budget: Budget) -> None:
    tracker = budget.tracker
    np.testing.assert_allclose([tracker.sigma_m, tracker.sigma_m_per_m], [15e-6, 6e-6], rtol=1e-4)
    assert tracker.sigma_rad == pytest.approx(TURN_SIGMA_RAD)
    assert "15.0 um + 6.0 um/m a coordinate, 5.77 mdeg an axis (by 12 readings" in str(tracker)


def test_parts_add_up_to_the_covariance_of_a_shot(
    record: CalibrationRecord, budget: Budget
) -> None:
    trs_from_cam, covariance = record.trs_from_cam(reading_at(record, OBLIQUE))
    np.testing.assert_allclose(trs_from_cam.as_matrix(), OBLIQUE.as_matrix(), atol=1e-12)
    assert budget.total_position_m[0] ** 2 == pytest.approx(np.trace(covariance[3:, 3:]))
    assert budget.total_rotation_rad[0] ** 2 == pytest.approx(np.trace(covariance[:3, :3]))


def test_a_turn_of_the_tmac_moves_the_camera_by_its_lever(budget: Budget) -> None:
    by_turn_m = budget.position_m[0, CONTRIBUTIONS.index("tracker rotation")]
    assert by_turn_m == pytest.approx(np.sqrt(2) * TURN_SIGMA_RAD * budget.lever_m)
    assert budget.rotation_rad[0, 0] == 0.0
    assert budget.rotation_rad[0, 3] == pytest.approx(np.sqrt(3) * HAND_EYE_SIGMAS[0])


def test_the_range_is_along_the_boresight(budget: Budget) -> None:
    boresight = OBLIQUE.rotation.apply([0.0, 0.0, 1.0])
    met = OBLIQUE.translation + budget.range_los_m[0] * boresight
    assert met[2] == pytest.approx(0.0, abs=1e-12)


def test_landmarks_move_as_much_as_in_an_experiment(
    record: CalibrationRecord, budget: Budget
) -> None:
    rng = np.random.default_rng(0)
    _, covariance = record.trs_from_cam(reading_at(record, OBLIQUE))
    rays = record.camera.rays(rng.uniform(0, 1023, (100, 2)))
    directions = OBLIQUE.rotation.apply(np.column_stack([rays, np.ones(100)]))
    points = OBLIQUE.translation - OBLIQUE.translation[2] / directions[:, 2:] * directions
    is_on_model = ((points >= [0, 0, -1e-9]) & (points <= [2.16, 4.16, 1e-9])).all(axis=1)
    points = points[is_on_model & (directions[:, 2] < 0)]
    seen = record.camera.project(OBLIQUE.inv().apply(points))
    squares = []
    for error in rng.multivariate_normal(np.zeros(6), covariance, 1000):
        moved = record.camera.project(perturb(OBLIQUE, error).inv().apply(points)) - seen
        squares.append((moved**2).sum(axis=1).mean())
    assert budget.total_image_px[0] == pytest.approx(np.sqrt(np.mean(squares)), rel=0.05)


def test_the_lens_moves_landmarks_as_much_as_in_an_experiment(record: CalibrationRecord) -> None:
    """As close as this, the model fills the image."""
    close = pose_along_boresight([1.08, 2.08, 0.5], boresight=[0, 0, -1], right=[0, 1, 0])
    camera = record.results.camera
    drawn = np.random.default_rng(0).multivariate_normal(
        intrinsics_of(camera.camera), camera.covariance, 150
    )
    shifts = [image_shift_px(camera.camera, with_intrinsics(camera.camera, x)) for x in drawn]
    expected = np.sqrt(np.mean(np.square(shifts)))
    assert error_budget(record, [close]).intrinsics_px[0] == pytest.approx(expected, rel=0.15)


def test_a_shadow_moves_as_much_as_in_an_experiment(record: CalibrationRecord) -> None:
    """The lamp is placed worst along a slanted line, so that signs count."""
    lamp = record.results.lamp
    covariance = LAMP_SIGMA_M**2 * np.array([[4.0, 3.0, 3.5], [3.0, 3.0, 2.5], [3.5, 2.5, 4.0]])
    slanted = replace(lamp, covariance_m2=covariance)
    slanted = replace(record, results=replace(record.results, lamp=slanted))
    budget = error_budget(slanted, [OBLIQUE])
    lamps = np.random.default_rng(0).multivariate_normal(lamp.p_trs_m, covariance, 20000)
    top = np.array([1.08, 2.08, RELIEF_M])
    tips = top + (top - lamps) * (RELIEF_M / (lamps[:, 2:] - RELIEF_M))
    scatter_m = np.sqrt(tips.var(axis=0).sum())
    assert budget.shadow_m == pytest.approx(scatter_m, rel=0.03)
    assert 0 < budget.shadow_px[0] < budget.shadow_m * 800 / 1.0


def test_the_sweep_is_straight_before_the_model(swept: Budget) -> None:
    np.testing.assert_allclose(swept.range_los_m, np.arange(5, 51) / 10)
    columns = swept.columns()
    assert all(column.shape == (46,) and np.isfinite(column).all() for column in columns.values())
    by_range = columns["total_mm"] / columns["range_los_m"] / 10
    np.testing.assert_allclose(columns["total_pct_los"], by_range)


def test_the_table_says_what_dominates_and_what_to_do(swept: Budget) -> None:
    text = budget_table(swept)
    assert "camera rotation: tracker rotation dominates, 95% of the variance" in text
    assert "camera centre: frame dominates" in text
    assert text.count("      5.00 ") == 3
    parts = np.array([[1.0, 2.0, 1.0, 0.0], [1.0, 2.0, 0.0, 0.0]])
    assert dominant(parts) == ("tracker rotation", pytest.approx(8 / 11))


def test_one_pose_is_enough_and_a_lamp_is_not_needed(record: CalibrationRecord) -> None:
    without = replace(record, results=replace(record.results, lamp=None))
    budget = error_budget(without, [OBLIQUE])
    assert np.isnan(budget.shadow_px).all()
    assert "shadows" not in budget_table(budget)


def test_missing_parts_are_named(record: CalibrationRecord) -> None:
    without = replace(record, results=replace(record.results, hand_eye=None, camera=None))
    with pytest.raises(CalibrationError, match="needs intrinsics, hand-eye, which it lacks"):
        error_budget(without, [OBLIQUE])
    unread = replace(record, inputs=record.inputs.with_parts(hand_eye=None))
    with pytest.raises(CalibrationError, match="no reading of the T-MAC"):
        sweep(unread)


@pytest.mark.parametrize(
    "pose",
    [
        OBLIQUE * RigidTransform.from_rotation(Rotation.from_euler("x", 180, degrees=True)),
        pose_along_boresight([1.0, 40.0, 2.0], boresight=[0, 0, -1], right=[0, 1, 0]),
        pose_along_boresight([1.0, 2.0, 2.0], boresight=[1, 0, 0], right=[0, 1, 0]),
    ],
    ids=["backwards", "aside", "parallel"],
)
def test_a_pose_that_looks_past_the_model_is_named(
    record: CalibrationRecord, pose: RigidTransform
) -> None:
    with pytest.raises(CalibrationError, match=r"pose 2 at .* looks past the model"):
        error_budget(record, [OBLIQUE, pose])


def test_a_lamp_behind_the_model_is_refused(record: CalibrationRecord) -> None:
    behind = replace(record.results.lamp, p_trs_m=np.array([0.0, 0.0, -1.0]))
    wrong = replace(record, results=replace(record.results, lamp=behind))
    with pytest.raises(CalibrationError, match="must be in front of the model"):
        error_budget(wrong, [OBLIQUE])
