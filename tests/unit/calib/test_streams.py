"""Streams with their own clocks: the offset against its sigma, bad stamps, no common motion."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.calib.hand_eye.streams import PoseStream, pair_streams
from tronlab.errors import CalibrationError
from tronlab.geometry.uncertainty import perturb

TRUE = RigidTransform.from_components([0.1, -0.05, 0.03], Rotation.from_euler("xyz", [1, -0.4, 2]))
OFFSET_S = -0.0173


def camera_at(times: np.ndarray, seed: int = 0) -> RigidTransform:
    """Give cam_from_board of a camera moved by hand."""
    rng = np.random.default_rng(seed)
    knots = np.arange(-2.0, 15.0, 0.5)
    turn, shift = (CubicSpline(knots, rng.normal(0, s, (len(knots), 3))) for s in (0.3, 0.1))
    return RigidTransform.from_components(
        shift(times) + np.array([0, 0, 0.8]), Rotation.from_rotvec(turn(times))
    )


def streams(seed: int, *, sigma: float = 1e-3) -> tuple[PoseStream, PoseStream]:
    rng = np.random.default_rng(seed)
    board = RigidTransform.from_components([2.0, 1.0, 0.5], Rotation.random(rng=rng))
    t_tmac, t_cam = np.arange(0.0, 9.0, 0.01), np.arange(1.0, 11.0, 0.04)
    tmac = board * camera_at(t_tmac).inv() * TRUE.inv()
    seen = camera_at(t_cam)
    noisy = [perturb(pose, sigma * rng.normal(size=6)) for pose in seen]
    return (
        PoseStream("tmac.csv", t_tmac, tmac),
        PoseStream("cam.csv", t_cam + OFFSET_S, RigidTransform.concatenate(noisy)),
    )


def test_the_offset_is_found_to_its_sigma_whichever_stream_is_faster() -> None:
    for seed in range(2):
        tmac, cam = streams(seed)
        paired = pair_streams(tmac, cam)
        assert paired.offset_sigma_s < 1e-3
        assert abs(paired.offset_s - OFFSET_S) < 3.5 * paired.offset_sigma_s
        assert "tmac.csv starts 1.0" in " ".join(paired.notes)
    slow = tmac[np.arange(len(tmac)) % 8 == 0]
    swapped = pair_streams(slow, cam)
    assert any("at the times of tmac.csv" in note for note in swapped.notes)
    assert swapped.offset_s == pytest.approx(OFFSET_S, abs=2e-3)


def test_clocks_of_other_epochs_are_no_obstacle_and_a_camera_in_the_board_is_inverted() -> None:
    tmac, cam = streams(1)
    late = PoseStream(cam.name, cam.time_s + 1.7e9, cam.poses.inv())
    paired = pair_streams(tmac, late)
    assert paired.offset_s - 1.7e9 == pytest.approx(OFFSET_S, abs=2e-3)
    assert any("inverted" in note for note in paired.notes)


def test_repeated_and_backward_stamps_are_counted_and_left_out() -> None:
    tmac, cam = streams(2)
    times = tmac.time_s.copy()
    times[100], times[200], times[201] = times[99], times[190], times[191]
    paired = pair_streams(PoseStream(tmac.name, times, tmac.poses), cam)
    assert "tmac.csv: 1 repeated time stamps left out (poses 101)" in paired.notes
    assert "tmac.csv: 2 backward time stamps left out (poses 201, 202)" in paired.notes
    assert paired.offset_s == pytest.approx(OFFSET_S, abs=1e-3)


def test_a_gap_is_reported_and_not_interpolated_over() -> None:
    tmac, cam = streams(3)
    whole = pair_streams(tmac, cam)
    holed = pair_streams(tmac[(tmac.time_s < 4.0) | (tmac.time_s > 5.0)], cam)
    assert "tmac.csv: 1 gaps of 1.02 to 1.02 s, not interpolated over" in holed.notes
    assert 24 <= len(whole.pairs) - len(holed.pairs) <= 26


def test_streams_without_common_motion_are_refused() -> None:
    tmac, cam = streams(0)
    other = PoseStream(cam.name, cam.time_s, camera_at(cam.time_s, seed=9))
    with pytest.raises(CalibrationError, match=r"resemble each other|differ by"):
        pair_streams(tmac, other)


def test_a_stream_too_short_is_refused() -> None:
    tmac, cam = streams(0)
    with pytest.raises(CalibrationError, match=r"cam.csv: 5 poses in order of time"):
        pair_streams(tmac, cam[np.arange(len(cam)) < 5])


def test_time_stamps_in_nanoseconds_are_refused() -> None:
    tmac, cam = streams(3)
    with pytest.raises(CalibrationError, match=r"tmac\.csv: lasts 8.99e\+09 s.* in seconds"):
        pair_streams(replace(tmac, time_s=1e9 * tmac.time_s), cam)


def test_a_quaternion_in_another_order_is_refused() -> None:
    """Between two turns a cyclic shift is an inversion, as of a camera in the board."""
    tmac, cam = streams(3)
    shifted = Rotation.from_quat(np.roll(tmac.poses.rotation.as_quat(), 1, axis=1))
    poses = RigidTransform.from_components(tmac.poses.translation, shifted)
    with pytest.raises(CalibrationError, match=r"the translations do not; .* scalar last"):
        pair_streams(replace(tmac, poses=poses), cam)
