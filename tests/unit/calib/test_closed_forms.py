"""Closed hand-eye forms: exact on exact poses, and OpenCV's own on noisy ones."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.calib.hand_eye.closed_forms import (
    CLOSED_FORMS,
    HandEyeStart,
    check_motions,
    disagreements,
    solve_closed_forms,
)
from tronlab.errors import DegenerateGeometryError
from tronlab.geometry.uncertainty import perturb, pose_difference

METHODS = ("park", "tsai", "horaud", "daniilidis", "andreff")


def stations(
    seed: int, n: int = 8, sigma: float = 0.0, turn_rad: float = 0.6
) -> tuple[HandEyeStart, list[RigidTransform], list[RigidTransform]]:
    rng = np.random.default_rng(seed)
    truth = HandEyeStart(
        RigidTransform.from_components(rng.uniform(-0.2, 0.2, 3), Rotation.random(rng=rng)),
        RigidTransform.from_components(rng.uniform(-3.0, 3.0, 3), Rotation.random(rng=rng)),
    )
    tmac, cam = [], []
    for _ in range(n):
        turn = Rotation.from_euler("xyz", rng.uniform(-turn_rad, turn_rad, 3))
        board = RigidTransform.from_components([*rng.uniform(-0.2, 0.2, 2), 0.7], turn)
        reading = truth.trk_from_board * board.inv() * truth.tmac_from_cam.inv()
        tmac.append(perturb(reading, sigma * rng.normal(size=6)))
        cam.append(perturb(board, sigma * rng.normal(size=6)))
    return truth, tmac, cam


@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(4, 10))
def test_exact_poses_give_the_exact_answer_by_every_method(seed: int, n: int) -> None:
    truth, tmac, cam = stations(seed, n)
    starts = solve_closed_forms(tmac, cam)
    assert tuple(starts) == METHODS
    for start in starts.values():
        for found, true in (
            (start.tmac_from_cam, truth.tmac_from_cam),
            (start.trk_from_board, truth.trk_from_board),
        ):
            np.testing.assert_allclose(pose_difference(found, true), 0.0, atol=1e-8)
    assert disagreements(starts) == ()


@pytest.mark.opencv
@pytest.mark.skipif(not hasattr(cv2, "calibrateHandEye"), reason="this OpenCV has no hand-eye")
@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("seed", range(3))
def test_noisy_poses_give_opencvs_answer(name: str, seed: int) -> None:
    _, tmac, cam = stations(seed, n=5, sigma=2e-3, turn_rad=1.0)
    if name == "tsai":  # OpenCV leaves out small turns for this method alone
        turns = [(a.inv() * b).rotation.magnitude() for a in tmac for b in tmac if a is not b]
        if min(turns) < np.radians(30):
            pytest.skip("a turn too small for OpenCV's Tsai")
    rotation, translation = cv2.calibrateHandEye(
        [pose.rotation.as_matrix() for pose in tmac],
        [pose.translation for pose in tmac],
        [pose.rotation.as_matrix() for pose in cam],
        [pose.translation for pose in cam],
        method=getattr(cv2, f"CALIB_HAND_EYE_{name.upper()}"),
    )
    theirs = RigidTransform.from_components(translation.ravel(), Rotation.from_matrix(rotation))
    ours = CLOSED_FORMS[name](tmac, cam).tmac_from_cam
    np.testing.assert_allclose(pose_difference(ours, theirs), 0.0, atol=1e-6)


def test_a_method_that_lies_away_is_named() -> None:
    truth, tmac, cam = stations(3, sigma=1e-5)
    starts = solve_closed_forms(tmac, cam)
    moved = perturb(truth.tmac_from_cam, np.array([0, 0, 0, 0, 9e-3, 0]))
    lines = disagreements({**starts, "andreff": HandEyeStart(moved, truth.trk_from_board)})
    assert len(lines) == 1
    assert lines[0].startswith("closed form andreff lies 9.0 mm and 0.00 deg from the median")


def test_two_stations_are_refused() -> None:
    _, tmac, cam = stations(0, n=2)
    with pytest.raises(DegenerateGeometryError, match="2 stations, at least 3"):
        solve_closed_forms(tmac, cam)


def test_turns_about_one_axis_are_refused_by_its_name() -> None:
    tmac = [RigidTransform.from_rotation(Rotation.from_rotvec([0, a, 0])) for a in (0, 0.4, 1.0)]
    with pytest.raises(DegenerateGeometryError, match=r"same axis \(-?0.00, -?1.00, -?0.00\)"):
        check_motions(tmac)


def test_translation_only_is_refused() -> None:
    tmac = [RigidTransform.from_translation([x, 0, x * x]) for x in (0.0, 0.5, 1.0, 2.0)]
    with pytest.raises(DegenerateGeometryError, match=r"turned by 0\.00 deg"):
        check_motions(tmac)


def test_half_turns_alone_are_refused() -> None:
    poses = [RigidTransform.from_rotation(Rotation.from_rotvec(np.pi * axis)) for axis in np.eye(3)]
    with pytest.raises(DegenerateGeometryError, match="half a turn"):
        check_motions(poses)


def test_a_scene_of_the_bundle_agrees(scene: Callable) -> None:
    truth = scene(5, n=10)
    starts = solve_closed_forms(truth.readings, truth.cam_from_board)
    for start in starts.values():
        assert np.abs(pose_difference(start.tmac_from_cam, truth.tmac_from_cam)[3:]).max() < 2e-3
