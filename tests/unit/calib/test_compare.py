"""Two records held against each other: no false alarm, and what moved is named."""

from dataclasses import replace

import numpy as np
import pytest
from measured_record import measured_record
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2

from tronlab.calib.compare import Comparison, PartComparison, compare_records
from tronlab.calib.record import CalibrationRecord
from tronlab.calib.results import LampResult
from tronlab.devices.readings import DeviceIdentity
from tronlab.geometry.uncertainty import perturb


def part(comparison: Comparison, name: str) -> PartComparison:
    (found,) = [part for part in comparison.parts if part.name == name]
    return found


def with_parts(record: CalibrationRecord, **parts: object) -> CalibrationRecord:
    return replace(record, results=replace(record.results, **parts))


def moved_frame(record: CalibrationRecord, difference: np.ndarray) -> CalibrationRecord:
    frame = record.results.frame
    moved = replace(frame, trs_from_trk=perturb(frame.trs_from_trk, difference))
    return with_parts(record, frame=moved)


def test_what_did_not_move_agrees_as_often_as_chi_square_says() -> None:
    comparisons = [
        compare_records(
            measured_record(seed=2 * i, n_stations=1), measured_record(seed=2 * i + 1, n_stations=1)
        )
        for i in range(60)
    ]
    for name, dof in {"frame": 6, "camera": 9, "hand-eye": 6, "lamp": 3, "robot": 15}.items():
        parts = [part(comparison, name) for comparison in comparisons]
        assert {it.dof for it in parts} == {dof}
        total = sum(it.chi_square for it in parts)
        low, high = chi2.ppf([0.005, 0.995], dof * len(parts))
        assert low < total < high, name
        assert sum(it.is_changed for it in parts) <= 2


def test_a_tracker_that_moved_changes_the_frame_and_nothing_else() -> None:
    before = measured_record(seed=1)
    moved = RigidTransform.from_components([0.3, -1.2, 0.4], Rotation.from_euler("x", 20, True))
    after = measured_record(seed=2)
    frame = after.results.frame
    after = with_parts(after, frame=replace(frame, trs_from_trk=frame.trs_from_trk * moved))
    comparison = compare_records(before, after)
    assert [it.name for it in comparison.parts if it.is_changed] == ["frame"]
    assert comparison.verdict.splitlines() == [  # less the frames' own errors of 0.6 mdeg
        "frame changed: the tracker stands elsewhere, or the model: 1.300 m and 19.999 deg",
        "nothing else moved: camera, hand-eye, lamp and robot agree within the uncertainty",
    ]


def test_a_lamp_that_moved_less_than_its_light_is_known_is_found_out() -> None:
    """The light keeps its place in the housing; only how the reflector was measured counts."""

    def lamp_at(x_m: float) -> CalibrationRecord:
        reflector, light_sigma_m = np.array([x_m, -2.0, 3.0]), 0.006
        covariance = (5e-5**2 + light_sigma_m**2) * np.eye(3)
        statistics = {"p_reflector_trs_m": reflector.tolist(), "light_sigma_m": light_sigma_m}
        lamp = LampResult(reflector + 0.05, covariance, statistics)
        return with_parts(measured_record(seed=1, n_stations=1), lamp=lamp)

    lamp = part(compare_records(lamp_at(-3.0), lamp_at(-2.999)), "lamp")
    assert lamp.quantities[0].n_sigmas == pytest.approx(1e-3 / (5e-5 * np.sqrt(2)), rel=1e-3)
    surveyed = lamp_at(-3.0)
    assert surveyed.results.lamp is not None
    moved = replace(surveyed.results.lamp, p_trs_m=surveyed.results.lamp.p_trs_m + 1e-3)
    lamp = part(compare_records(surveyed, with_parts(surveyed, lamp=moved)), "lamp")
    assert lamp.quantities[0].sigma == pytest.approx(8.5, abs=0.1)  # mm


def test_a_small_move_is_found_in_units_and_in_sigmas() -> None:
    before = measured_record(seed=3)
    shift_m = 10 * 4e-5 * np.sqrt(2)
    after = moved_frame(before, np.array([0, 0, 0, 0, shift_m, 0]))
    after = replace(after, inputs=measured_record(seed=4).inputs)
    frame = part(compare_records(before, after), "frame")
    by_name = {quantity.name: quantity for quantity in frame.quantities}
    along_y = by_name["shift along y"]
    assert (along_y.unit, along_y.difference) == ("mm", pytest.approx(1e3 * shift_m))
    assert along_y.n_sigmas == pytest.approx(10.0)
    assert by_name["shift along x"].n_sigmas == pytest.approx(0.0)
    assert frame.chi_square == pytest.approx(100.0)
    assert frame.p_value == pytest.approx(chi2.sf(100.0, 6))


def test_the_mahalanobis_distance_knows_correlations() -> None:
    """Two numbers that can only move together are far apart if they move against each other."""
    record = measured_record(seed=5)
    root = np.diag([1e-5] * 3 + [1e-4] * 3)
    correlation = np.eye(6)
    correlation[3, 4] = correlation[4, 3] = 0.99
    covariance = root @ correlation @ root
    first = with_parts(record, frame=replace(record.results.frame, covariance=covariance))
    together, against = (
        part(
            compare_records(first, moved_frame(first, np.array([0, 0, 0, 1e-4, sign * 1e-4, 0]))),
            "frame",
        ).chi_square
        for sign in (1, -1)
    )
    assert together == pytest.approx(1 / 1.99)
    assert against == pytest.approx(1 / 0.01)


def test_the_same_readings_are_not_measured_again() -> None:
    before = measured_record(seed=6)
    after = replace(
        moved_frame(before, np.array([0, 0, 0, 1e-3, 0, 0])),
        inputs=before.inputs.with_parts(frame=measured_record(seed=7).inputs.frame),
    )
    comparison = compare_records(before, after)
    readings = {it.name: it.readings for it in comparison.parts}
    assert readings == {
        "frame": "others",
        "camera": "same",
        "hand-eye": "same",
        "lamp": "unknown",
        "robot": "unknown",
    }
    assert part(comparison, "camera").judgement == "same readings, same result"
    assert comparison.verdict.splitlines()[-1] == "not measured again: camera and hand-eye"


def test_another_result_from_the_same_readings_is_no_move() -> None:
    before = measured_record(seed=8)
    hand_eye = before.results.hand_eye
    shift = np.array([0, 0, 0, 1e-3, 0, 0])
    moved = replace(hand_eye, tmac_from_cam=perturb(hand_eye.tmac_from_cam, shift))
    after = replace(with_parts(before, hand_eye=moved), software={"tronlab": "newer"})
    comparison = compare_records(before, after)
    assert not part(comparison, "hand-eye").is_changed
    assert (
        "hand-eye: solved differently from the same readings, by 1.000 mm and 0.00 mdeg"
        in comparison.verdict
    )
    assert "software: tronlab test -> newer" in comparison.table()


def test_stations_in_common_are_said() -> None:
    before, other = measured_record(seed=9), measured_record(seed=10)
    stations = before.inputs.hand_eye.stations[:6] + other.inputs.hand_eye.stations[6:]
    mixed = before.inputs.hand_eye.model_copy(update={"stations": stations})
    after = replace(other, inputs=other.inputs.with_parts(hand_eye=mixed))
    assert part(compare_records(before, after), "hand-eye").readings == "partly the same"


def test_another_lens_is_measured_in_pixels_without_what_a_turn_explains() -> None:
    before, after = measured_record(seed=11), measured_record(seed=11)
    camera = after.results.camera
    shifted = replace(camera.camera, cx_px=camera.camera.cx_px + 3.0)
    after = with_parts(after, camera=replace(camera, camera=shifted))
    shift = part(compare_records(before, after), "camera")
    assert float(shift.size.split()[0]) < 1.5
    stretched = replace(camera.camera, fx_px=camera.camera.fx_px * 1.02)
    after = with_parts(after, camera=replace(camera, camera=stretched))
    stretch = part(compare_records(before, after), "camera")
    assert float(stretch.size.split()[0]) > 2.0
    names = {quantity.name: quantity for quantity in stretch.quantities}
    assert (names["fx"].unit, names["k1"].unit) == ("px", "1")


def test_a_number_without_variance_that_differs_is_a_change() -> None:
    before = measured_record(seed=12)
    camera = before.results.camera
    coefficients = (*camera.camera.distortion[:5], 0.1, 0.0, 0.0)
    rational = replace(camera, camera=replace(camera.camera, distortion=coefficients))
    after = replace(with_parts(before, camera=rational), inputs=measured_record(seed=13).inputs)
    changed = part(compare_records(before, after), "camera")
    assert changed.is_changed
    assert changed.quantities[9].n_sigmas == np.inf


def test_parts_devices_rig_and_camera_that_differ_are_listed() -> None:
    one, two = (
        {"tracker": DeviceIdentity("Leica", "AT901-MR", serial, "1")} for serial in ("1", "2")
    )
    before = measured_record(seed=14, devices=one)
    after = measured_record(seed=15, devices=two, rig_name="other")
    camera = replace(after.results.camera, model="rational")
    after = with_parts(after, robot=None, camera=camera)
    comparison = compare_records(before, with_parts(after, lamp=None))
    assert comparison.only_in_first == ("lamp", "robot")
    text = comparison.table()
    assert "rig: 'twin' -> 'other'" in text
    assert "tracker exchanged: 'Leica AT901-MR 1 1' -> 'Leica AT901-MR 2 1'" in text
    assert "distortion model: brown -> rational" in text
    assert "only in the first: lamp and robot" in text


def test_nothing_in_common_is_said() -> None:
    before, after = measured_record(seed=16), measured_record(seed=17)
    only_lamp = with_parts(before, frame=None, camera=None, hand_eye=None, robot=None)
    comparison = compare_records(only_lamp, with_parts(after, lamp=None))
    assert comparison.verdict == "the two records have no part in common"
    assert comparison.table()
