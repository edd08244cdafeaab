import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2

from tronlab.calib.three_point import NAMES, point_in_trs, solve_frame
from tronlab.devices.laboratory import ReflectorsSpec
from tronlab.devices.readings import PointReading
from tronlab.errors import CalibrationError, DegenerateGeometryError
from tronlab.geometry.uncertainty import pose_difference

REFLECTORS = ReflectorsSpec(
    bottom_left_m=(2.1, 0.0, 0.0), top_right_m=(0.1, 4.1, 0.0), length_tolerance_m=0.003
)
NOMINAL = {name: np.array(p) for name, p in REFLECTORS.points_m.items()}


def place_tracker(rng: np.random.Generator) -> RigidTransform:
    position = np.array([1.0, 2.0, 4.0]) + rng.normal(size=3)
    return RigidTransform.from_components(position, Rotation.random(rng=rng))


def measure(
    trs_from_trk: RigidTransform,
    points_trs: dict[str, np.ndarray],
    rng: np.random.Generator,
    sigma_m: float = 0.0,
) -> dict[str, PointReading]:
    root = np.diag([1.0, 2.0, 0.5]) * sigma_m
    return {
        name: PointReading(
            name, trs_from_trk.inv().apply(p) + root @ rng.normal(size=3), root @ root.T, 0.0
        )
        for name, p in points_trs.items()
    }


def test_exact_points_give_the_exact_frame() -> None:
    rng = np.random.default_rng(1)
    truth = place_tracker(rng)
    solution = solve_frame(measure(truth, NOMINAL, rng, 1e-9), REFLECTORS)
    np.testing.assert_allclose(pose_difference(solution.trs_from_trk, truth), 0.0, atol=1e-8)
    assert max(map(abs, solution.length_errors_m.values())) < 1e-8


def test_errors_agree_with_the_predicted_covariance() -> None:
    rng = np.random.default_rng(2)
    nees, nees_lamp = [], []
    p_lamp = np.array([-2.5, -1.5, 2.5])
    for _ in range(300):
        truth = place_tracker(rng)
        readings = measure(truth, {**NOMINAL, "lamp": p_lamp}, rng, 40e-6)
        solution = solve_frame(readings, REFLECTORS)
        error = pose_difference(solution.trs_from_trk, truth)
        nees.append(error @ np.linalg.solve(solution.covariance, error))
        p, covariance = point_in_trs(readings["lamp"], solution)
        nees_lamp.append((p - p_lamp) @ np.linalg.solve(covariance, p - p_lamp))
    for values, dof in ((nees, 6), (nees_lamp, 3)):
        low, high = chi2.ppf([0.005, 0.995], dof * len(values))
        assert low < sum(values) < high


def test_swapped_labels_are_named() -> None:
    rng = np.random.default_rng(3)
    readings = measure(place_tracker(rng), NOMINAL, rng)
    swapped = {**readings, "top_left": readings["top_right"], "top_right": readings["top_left"]}
    with pytest.raises(CalibrationError, match="top_left, top_right are swapped"):
        solve_frame(swapped, REFLECTORS)


@pytest.mark.parametrize("name", NAMES)
def test_a_reflector_out_of_place_is_named(name: str) -> None:
    rng = np.random.default_rng(4)
    moved = {**NOMINAL, name: NOMINAL[name] * 1.0 + [0.02, 0.02, 0.0]}
    with pytest.raises(CalibrationError, match=f"reflector {name} is out of place"):
        solve_frame(measure(place_tracker(rng), moved, rng), REFLECTORS)


def test_one_wrong_length_leaves_two_in_doubt() -> None:
    rng = np.random.default_rng(5)
    moved = {**NOMINAL, "bottom_left": NOMINAL["bottom_left"] * (2.105 / 2.1)}
    with pytest.raises(CalibrationError, match="top_left or bottom_left is out of place"):
        solve_frame(measure(place_tracker(rng), moved, rng), REFLECTORS)


def test_a_wrong_unit_is_recognised() -> None:
    rng = np.random.default_rng(6)
    scaled = {name: 1000.0 * p for name, p in NOMINAL.items()}
    with pytest.raises(CalibrationError, match="all lengths are 1000 times the nominal ones"):
        solve_frame(measure(place_tracker(rng), scaled, rng), REFLECTORS)


def test_nothing_fits_at_all() -> None:
    rng = np.random.default_rng(6)
    points = {name: rng.normal(size=3) for name in NAMES}
    with pytest.raises(CalibrationError, match="no length between reflectors fits"):
        solve_frame(measure(place_tracker(rng), points, rng), REFLECTORS)


def test_a_missing_reflector_is_named() -> None:
    rng = np.random.default_rng(7)
    readings = measure(place_tracker(rng), NOMINAL, rng)
    del readings["bottom_left"]
    with pytest.raises(CalibrationError, match="bottom_left was not measured"):
        solve_frame(readings, REFLECTORS)


def test_collinear_reflectors_are_refused() -> None:
    rng = np.random.default_rng(8)
    line = ReflectorsSpec(bottom_left_m=(2.0, 0.0, 0.0), top_right_m=(4.0, 0.01, 0.0))
    points = {name: np.array(p) for name, p in line.points_m.items()}
    with pytest.raises(DegenerateGeometryError, match="collinear"):
        solve_frame(measure(place_tracker(rng), points, rng), line)


def test_equal_arms_swapped_would_put_the_tracker_behind_the_model() -> None:
    rng = np.random.default_rng(9)
    equal = ReflectorsSpec(bottom_left_m=(2.0, 0.0, 0.0), top_right_m=(0.0, 2.0, 0.0))
    points = {name: np.array(p) for name, p in equal.points_m.items()}
    readings = measure(place_tracker(rng), points, rng)
    solve_frame(readings, equal)
    swapped = {
        **readings,
        "bottom_left": readings["top_right"],
        "top_right": readings["bottom_left"],
    }
    with pytest.raises(CalibrationError, match=r"behind the model.*swapped"):
        solve_frame(swapped, equal)
