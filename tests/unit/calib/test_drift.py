from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2

from tronlab.calib.inputs import FrameInput, points_of
from tronlab.calib.reflectors.drift import compare_reflectors
from tronlab.calib.reflectors.frame import nominal_centres, solve_frame
from tronlab.calib.results import FrameResult
from tronlab.devices.laboratory import ReflectorsSpec
from tronlab.devices.readings import PointReading
from tronlab.errors import CalibrationError
from tronlab.geometry.uncertainty import pose_difference

THREE = ReflectorsSpec(bottom_left_m=(2.1, 0.0, 0.0), top_right_m=(0.1, 4.1, 0.0))
SIX = THREE.model_copy(
    update={"more_m": {"far": (2.0, 3.9, 0.3), "mid": (1.1, 1.7, 0.2), "low": (2.1, 1.3, -0.1)}}
)
SIGMA_M = 40e-6
LIMIT_M = 3e-4
STILL = RigidTransform.identity()
EXACT = 1e-3
"""Of the noise."""


def measure(
    trs_from_trk: RigidTransform,
    p_trs_m: Mapping[str, np.ndarray],
    rng: np.random.Generator,
    noise: float,
    *,
    time_s: float,
) -> dict[str, PointReading]:
    covariance = SIGMA_M**2 * np.diag([1.0, 4.0, 0.25])
    root = noise * np.sqrt(covariance)
    trk_from_trs = trs_from_trk.inv()
    return {
        name: PointReading(
            name, trk_from_trs.apply(p) + root @ rng.normal(size=3), covariance, time_s + i
        )
        for i, (name, p) in enumerate(p_trs_m.items())
    }


def calibrated(
    spec: ReflectorsSpec, rng: np.random.Generator, noise: float
) -> tuple[RigidTransform, FrameInput, FrameResult]:
    place = np.array([1.0, 2.0, 5.0]) + rng.uniform(-1.0, 1.0, 3)
    trs_from_trk = RigidTransform.from_components(place, Rotation.random(rng=rng))
    readings = measure(trs_from_trk, nominal_centres(spec), rng, noise, time_s=100.0)
    frame_input = FrameInput(
        measured_utc="2026-01-02T03:04:05Z", reflectors=spec, points=points_of(readings)
    )
    return trs_from_trk, frame_input, solve_frame(readings, spec)


def check_after(
    spec: ReflectorsSpec,
    *,
    moved: RigidTransform = STILL,
    off: Mapping[str, list[float]] | None = None,
    noise: float = EXACT,
    seed: int = 1,
):
    """Check after the tracker was moved (in trs), and reflectors were (in trs)."""
    rng = np.random.default_rng(seed)
    trs_from_trk, frame_input, frame = calibrated(spec, rng, noise)
    places = {name: p + (off or {}).get(name, 0.0) for name, p in nominal_centres(spec).items()}
    readings = measure(moved * trs_from_trk, places, rng, noise, time_s=200.0)
    return compare_reflectors(readings, frame_input, frame, limit_m=LIMIT_M)


@pytest.mark.parametrize("spec", [THREE, SIX], ids=["three", "six"])
def test_nothing_moved(spec) -> None:
    check = check_after(spec, noise=1.0)
    assert check.is_within
    assert check.max_shift_m < 2e-4
    assert check.loose == ()
    assert check.time_s == 200.0 + len(spec.points_m) - 1
    assert check.text.startswith("nothing moved: by up to 0.")


@pytest.mark.parametrize("spec", [THREE, SIX], ids=["three", "six"])
def test_a_moved_tracker_shifts_the_model_the_other_way(spec) -> None:
    turn = Rotation.from_rotvec([1e-4, -2e-4, 3e-4])
    moved = RigidTransform.from_components([1e-3, 0.0, -5e-4], turn)
    check = check_after(spec, moved=moved)
    np.testing.assert_allclose(check.shift, pose_difference(STILL, moved.inv()), atol=1e-6)
    corners = np.array([[x, y, z] for x in (0, 2.1) for y in (0, 4.1) for z in (-0.1, 0, 0.3)])
    if spec is THREE:
        corners = corners[corners[:, 2] == 0.0]
    largest_m = np.linalg.norm(moved.inv().apply(corners) - corners, axis=1).max()
    assert check.max_shift_m == pytest.approx(largest_m, abs=2e-6)
    assert not check.is_within
    assert check.text.startswith("the tracker moved against the model: by up to 1.")
    assert "turned by 0.0214 deg" in check.text


def test_all_truth_is_off_by_the_shift() -> None:
    """The shift leads from where a camera is to where the calibrated frame says it is."""
    moved = RigidTransform.from_components([2e-3, 0, 0], Rotation.from_rotvec([0, 5e-4, 0]))
    trs_from_trk, _, frame = calibrated(SIX, np.random.default_rng(1), EXACT)
    check = check_after(SIX, moved=moved)
    p_cam = np.array([1.0, 2.0, 3.0])
    seen = frame.trs_from_trk.apply((moved * trs_from_trk).inv().apply(p_cam))
    shift = RigidTransform.from_components(check.shift[3:], Rotation.from_rotvec(check.shift[:3]))
    np.testing.assert_allclose(shift.apply(p_cam), seen, atol=2e-6)


@pytest.mark.parametrize("spec", [THREE, SIX], ids=["three", "six"])
def test_shifts_agree_with_their_covariance(spec) -> None:
    moved = RigidTransform.from_components([1e-3, 2e-3, 0], Rotation.from_rotvec([0, 0, 1e-3]))
    nees = []
    for seed in range(40):
        check = check_after(spec, moved=moved, noise=1.0, seed=seed)
        error = pose_difference(moved.inv(), STILL) + check.shift
        nees.append(error @ np.linalg.solve(check.covariance, error))
    low, high = chi2.ppf([0.005, 0.995], 6 * len(nees))
    assert low < sum(nees) < high


def test_one_of_six_reflectors_moved_and_the_frame_still_holds() -> None:
    check = check_after(SIX, off={"far": [0.0, 0.002, 0.001]}, noise=1.0)
    assert check.loose == ("far",)
    assert check.moved_m["far"] == pytest.approx(np.hypot(0.002, 0.001), abs=2e-4)
    assert check.is_within
    assert check.max_shift_m < 2e-4
    assert "reflectors moved against the others: far by 2." in check.text


def test_one_of_six_reflectors_moved_and_the_tracker_too() -> None:
    moved = RigidTransform.from_translation([0.0, 1e-3, 0.0])
    check = check_after(SIX, moved=moved, off={"mid": [0.01, 0.0, 0.0]})
    assert check.loose == ("mid",)
    assert not check.is_within
    np.testing.assert_allclose(check.shift, [0, 0, 0, 0, -1e-3, 0], atol=1e-6)


def test_one_of_three_reflectors_moved_and_nothing_is_sure() -> None:
    check = check_after(THREE, off={"top_right": [0.002, 0.002, 0.0]}, noise=1.0)
    assert check.loose == ("top_right",)
    assert not check.is_within
    assert "too few are left to tell whether the tracker moved" in check.text


def test_a_check_by_some_of_the_reflectors() -> None:
    rng = np.random.default_rng(1)
    trs_from_trk, frame_input, frame = calibrated(SIX, rng, EXACT)
    readings = measure(trs_from_trk, nominal_centres(SIX), rng, EXACT, time_s=0.0)
    some = {name: readings[name] for name in ("far", "low", "top_left")}
    assert compare_reflectors(some, frame_input, frame, limit_m=LIMIT_M).is_within
    del some["far"]
    with pytest.raises(CalibrationError, match=r"2 reflectors measured \(low, top_left\), at leas"):
        compare_reflectors(some, frame_input, frame, limit_m=LIMIT_M)


def test_what_makes_no_sense_is_refused() -> None:
    rng = np.random.default_rng(1)
    trs_from_trk, frame_input, frame = calibrated(THREE, rng, EXACT)
    readings = measure(trs_from_trk, nominal_centres(THREE), rng, EXACT, time_s=0.0)
    with pytest.raises(CalibrationError, match=r"the limit is 0\.0 m, it must be more than 0"):
        compare_reflectors(readings, frame_input, frame, limit_m=0.0)
    other = {**readings, "far": readings["top_left"]}
    with pytest.raises(CalibrationError, match="far has no part in the calibration; it has: top_l"):
        compare_reflectors(other, frame_input, frame, limit_m=LIMIT_M)
    nowhere = replace(readings["top_left"], p_trk_m=np.full(3, np.nan))
    with pytest.raises(CalibrationError, match=r"drift check: reflector top_left: .* not finite"):
        compare_reflectors({**readings, "top_left": nowhere}, frame_input, frame, limit_m=LIMIT_M)
