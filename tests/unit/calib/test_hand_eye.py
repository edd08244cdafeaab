import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2

from tronlab.calib.camera.board import BoardView
from tronlab.calib.camera.intrinsics import IntrinsicsSolution, solve_intrinsics
from tronlab.calib.camera.known_camera import known_camera
from tronlab.calib.camera.view_checks import start_poses
from tronlab.calib.hand_eye.bundle import Station
from tronlab.calib.hand_eye.least_determined import name_least_determined
from tronlab.calib.hand_eye.solution import HandEyeSolution, solve_hand_eye
from tronlab.errors import CalibrationError, DegenerateGeometryError
from tronlab.geometry.uncertainty import perturb, pose_difference

pytestmark = pytest.mark.opencv

SIGMA_PX = 0.05


@pytest.fixture(scope="module")
def solve(bench: SimpleNamespace) -> Callable[..., HandEyeSolution]:
    """Solve with the poses that each image alone gives."""

    def of(
        stations: Sequence[Station],
        *,
        free_views: Sequence[BoardView] = (),
        **intrinsics: Any,
    ) -> HandEyeSolution:
        views = [*(station.view for station in stations), *free_views]
        found = seen_by(views, bench)
        return solve_hand_eye(
            stations,
            replace(found, **intrinsics),
            bench.board.pattern,
            free_views=free_views,
        )

    return of


def seen_by(views: Sequence[BoardView], bench: SimpleNamespace) -> IntrinsicsSolution:
    """Give the intrinsics without solving for them: the true camera, a little off."""
    camera = replace(bench.camera, fx_px=bench.camera.fx_px + 0.3, cx_px=bench.camera.cx_px - 0.3)
    return IntrinsicsSolution(
        camera=camera,
        covariance=np.eye(12),
        model="brown",
        bow_m=np.zeros(3),
        bow_covariance_m2=np.zeros((3, 3)),
        is_bow_free=False,
        cam_from_board=tuple(start_poses(views, camera)),
        view_rms_px=np.full(len(views), SIGMA_PX),
        sigma_px=SIGMA_PX,
        outlier_views=(),
        outlier_corners=(),
        statistics={},
    )


def spoiled(
    stations: Sequence[Station], i: int, *, turn_deg: Any = (0, 0, 0), shift_m: Any = (0, 0, 0)
) -> list[Station]:
    """Give the stations, one of them with a wrong reading."""
    error = np.concatenate([np.radians(turn_deg), shift_m])
    reading = stations[i].reading
    wrong = replace(reading, trk_from_tmac=perturb(reading.trk_from_tmac, error))
    return [*stations[:i], Station(wrong, stations[i].view), *stations[i + 1 :]]


def with_readings(
    stations: Sequence[Station], change: Callable[[RigidTransform], RigidTransform]
) -> list[Station]:
    return [
        replace(
            station,
            reading=replace(station.reading, trk_from_tmac=change(station.reading.trk_from_tmac)),
        )
        for station in stations
    ]


def test_errors_and_held_out_stations_agree_with_what_is_predicted(
    scene: Callable, solve: Callable
) -> None:
    squares, n_rejected, position, angle = [], 0, [], []
    for seed in range(300, 325):
        truth = scene(seed, n=8, every=2)
        solution = solve(truth.stations)
        hand_eye, held_out = solution.hand_eye, solution.hand_eye.statistics["held_out"]
        error = pose_difference(hand_eye.tmac_from_cam, truth.tmac_from_cam)
        squares.append(error @ np.linalg.solve(hand_eye.covariance, error))
        n_rejected += len(hand_eye.statistics["outlier_stations"])
        position.append(held_out["position_rms_m"] / held_out["expected_position_rms_m"])
        angle.append(held_out["angle_rms_rad"] / held_out["expected_angle_rms_rad"])
    low, high = chi2.ppf([0.005, 0.995], 6 * len(squares))
    assert low < sum(squares) < high
    assert n_rejected <= 2  # one in a thousand is expected
    # The errors of one scene depend on each other, so that there are no exact bounds.
    assert np.mean(np.square(position)) == pytest.approx(1.0, abs=0.2)
    assert np.mean(np.square(angle)) == pytest.approx(1.0, abs=0.2)


def test_from_images_to_the_hand_eye_transform(scene: Callable, bench: SimpleNamespace) -> None:
    for seed in range(2):
        truth = scene(seed, n=20)
        intrinsics = solve_intrinsics(truth.views, bench.nominal, bench.board.pattern)
        solution = solve_hand_eye(truth.stations, intrinsics, bench.board.pattern)
        error = pose_difference(solution.hand_eye.tmac_from_cam, truth.tmac_from_cam)
        sigma = np.sqrt(np.diag(solution.hand_eye.covariance))
        assert (np.abs(error) < 4 * sigma).all()
        assert np.linalg.norm(error[3:]) < 0.4e-3
        assert solution.camera.model == intrinsics.model
        assert solution.camera.covariance.shape == (12, 12)
        assert "bow_sigma_m" in solution.camera.statistics


GROSS_ERRORS = {
    "reading": {"turn_deg": (0.6, -0.6, 0.53), "shift_m": (3e-3, -3e-3, 2.6e-3)},
    "position": {"shift_m": (-3e-3, 0.0, 4e-3)},
    "rotation": {"turn_deg": (0.0, 1.0, 0.0)},
}


@pytest.mark.parametrize("error", GROSS_ERRORS.values(), ids=GROSS_ERRORS)
def test_one_gross_outlier_in_ten_changes_less_than_one_sigma(
    scene: Callable, solve: Callable, error: dict[str, Any]
) -> None:
    shifts = []
    for seed in range(4):
        truth = scene(seed, n=10, every=2)
        clean, found = solve(truth.stations), solve(spoiled(truth.stations, 3, **error))
        assert found.hand_eye.statistics["outlier_stations"] == [3]
        assert any("station 3 is left out" in w for w in found.hand_eye.statistics["warnings"])
        shift = pose_difference(found.hand_eye.tmac_from_cam, clean.hand_eye.tmac_from_cam)
        shifts.append(shift / np.sqrt(np.diag(clean.hand_eye.covariance)))
    # One coordinate of six in four scenes may lie beyond: that is the good station's own weight.
    assert np.sqrt(np.mean(np.square(shifts))) < 0.6
    assert (np.abs(shifts) < 1.0).mean() > 0.95


def test_swapped_images_are_left_out(scene: Callable, solve: Callable) -> None:
    stations = list(scene(4, n=10).stations)
    stations[2], stations[7] = (
        replace(stations[2], view=stations[7].view),
        replace(stations[7], view=stations[2].view),
    )
    solution = solve(stations)
    assert solution.hand_eye.statistics["outlier_stations"] == [2, 7]
    assert solution.hand_eye.statistics["n_stations"] == 8


def test_three_wrong_readings_in_ten_are_left_out(scene: Callable, solve: Callable) -> None:
    truth = scene(5, n=10)
    stations = list(truth.stations)
    for i in (0, 4, 9):
        stations = spoiled(stations, i, turn_deg=(10 + i, 0, -20), shift_m=(0.1, 0.02 * i, 0))
    solution = solve(stations)
    assert solution.hand_eye.statistics["outlier_stations"] == [0, 4, 9]
    error = pose_difference(solution.hand_eye.tmac_from_cam, truth.tmac_from_cam)
    assert error @ np.linalg.solve(solution.hand_eye.covariance, error) < chi2.isf(0.001, 6)


def test_views_and_corners_that_the_intrinsics_left_out_do_not_count(
    scene: Callable, solve: Callable
) -> None:
    truth = scene(6, n=10)
    number = int(truth.stations[1].view.ids[0])
    free_views = [truth.stations[9].view, truth.stations[3].view]
    solution = solve(
        truth.stations[:9],
        free_views=free_views,
        outlier_views=(4, 10),
        outlier_corners=((1, number),),
    )
    statistics = solution.hand_eye.statistics
    assert statistics["outlier_stations"] == [4]
    assert statistics["n_free_views"] == 1
    assert solution.stations == (0, 1, 2, 3, 5, 6, 7, 8)
    assert len(solution.residuals_px[1]) == len(truth.stations[1].view) - 1
    assert "station 4 is left out: its image does not fit the others" in statistics["warnings"]


def test_held_out_errors_are_those_of_solutions_without_the_stations(
    scene: Callable, solve: Callable
) -> None:
    truth = scene(7, n=10)
    held_out = solve(truth.stations).hand_eye.statistics["held_out"]
    squares = []
    for fold in range(5):
        held = [fold, fold + 5]
        others = [truth.stations[i] for i in range(10) if i not in held]
        solution = solve(others)
        state = solution.bundle.state
        for i in held:
            reading, view = truth.stations[i].reading, truth.stations[i].view
            cam_from_board = (
                state.tmac_from_cam.inv() * reading.trk_from_tmac.inv() * state.trk_from_board
            )
            uv = state.camera.project(cam_from_board.apply(view.p_board_m))
            squares.extend(((uv - view.uv_px) ** 2).sum(axis=1))
    assert held_out["n_stations"] == 10
    assert held_out["rms_px"] == pytest.approx(np.sqrt(np.mean(squares)), rel=0.02)


def test_few_stations_leave_nothing_to_hold_out(scene: Callable, solve: Callable) -> None:
    truth = scene(8, n=9)
    free_views = [station.view for station in truth.stations[4:]]
    statistics = solve(truth.stations[:4], free_views=free_views).hand_eye.statistics
    assert statistics["held_out"] is None
    assert statistics["n_stations"] == 4


def test_exact_data_give_the_exact_answer(scene: Callable, bench: SimpleNamespace) -> None:
    truth = scene(1, n=12, noise=0.0)
    intrinsics = solve_intrinsics(truth.views, bench.nominal, bench.board.pattern, model="brown")
    solution = solve_hand_eye(truth.stations, intrinsics, bench.board.pattern)
    difference = pose_difference(solution.hand_eye.tmac_from_cam, truth.tmac_from_cam)
    np.testing.assert_allclose(difference, 0.0, atol=1e-8)
    assert solution.hand_eye.statistics["outlier_stations"] == []


def test_statistics_are_plain_values(scene: Callable, solve: Callable) -> None:
    statistics = solve(scene(9, n=8).stations).hand_eye.statistics
    assert json.loads(json.dumps(statistics)) == statistics
    assert set(statistics["closed_forms"]) <= {"park", "tsai", "horaud", "daniilidis", "andreff"}
    assert statistics["p_value_poses"] > 1e-3
    assert statistics["warnings"] == []


def test_millimetres_are_named(scene: Callable, solve: Callable) -> None:
    stations = scene(10, n=8).stations
    in_mm = with_readings(
        stations, lambda pose: RigidTransform.from_components(1e3 * pose.translation, pose.rotation)
    )
    with pytest.raises(CalibrationError, match="of the T-MAC seem to be in millimetres"):
        solve(in_mm)


def test_a_left_handed_tracker_is_named(scene: Callable, solve: Callable) -> None:
    mirror = np.diag([1.0, 1.0, -1.0])

    def mirrored(pose: RigidTransform) -> RigidTransform:
        turn = Rotation.from_matrix(mirror @ pose.rotation.as_matrix() @ mirror)
        return RigidTransform.from_components(mirror @ pose.translation, turn)

    with pytest.raises(DegenerateGeometryError, match="left-handed"):
        solve(with_readings(scene(11, n=8).stations, mirrored))


def shifted_quaternion(pose: RigidTransform) -> RigidTransform:
    turn = Rotation.from_quat(np.roll(pose.rotation.as_quat(), 1))
    return RigidTransform.from_components(pose.translation, turn)


def longer(pose: RigidTransform) -> RigidTransform:
    return RigidTransform.from_components(1.05 * pose.translation, pose.rotation)


@pytest.mark.parametrize(
    ("change", "hint"),
    [
        (RigidTransform.inv, "only if one of the two is inverted"),
        (shifted_quaternion, "quaternion's scalar last"),
        (longer, r"moved 1\.05\d\d times as far as the camera saw: is the board's square_m right"),
    ],
    ids=["inverted", "quaternion", "square"],
)
def test_a_contradiction_is_explained(
    scene: Callable, solve: Callable, change: Callable, hint: str
) -> None:
    with pytest.raises(CalibrationError, match=hint):
        solve(with_readings(scene(12, n=10).stations, change))


def test_readings_far_worse_than_stated_are_refused(scene: Callable, solve: Callable) -> None:
    stations = [
        replace(
            station,
            reading=replace(station.reading, covariance=station.reading.covariance / 100),
        )
        for station in scene(13, n=10).stations
    ]
    with pytest.raises(CalibrationError, match="contradict each other") as caught:
        solve(stations)
    assert "times their stated accuracy" in str(caught.value)


def test_random_readings_are_refused(scene: Callable, solve: Callable) -> None:
    rng = np.random.default_rng(1)
    stations = with_readings(
        scene(14, n=10).stations, lambda pose: perturb(pose, 0.5 * rng.normal(size=6))
    )
    with pytest.raises(CalibrationError, match="hand-eye"):
        solve(stations)


def test_two_stations_are_refused(scene: Callable, solve: Callable) -> None:
    with pytest.raises(DegenerateGeometryError, match="2 stations, at least 3"):
        solve(scene(1, n=2).stations)


def test_turns_about_one_axis_are_refused(scene: Callable, solve: Callable) -> None:
    turns = [Rotation.from_euler("z", angle) for angle in np.linspace(-1, 1, 8)]
    with pytest.raises(DegenerateGeometryError, match="same axis"):
        solve(scene(2, n=8, turns=turns).stations)


def test_the_least_determined_direction_has_a_name() -> None:
    tmac_from_cam = RigidTransform.from_rotation(Rotation.from_euler("y", 90, degrees=True))
    sigmas = np.array([1e-6, 1e-6, 1e-6, 3.1e-5, 1e-5, 1e-5])  # x of tmac is the optical axis
    name = name_least_determined(tmac_from_cam, np.diag(sigmas**2), distance_m=1.0)
    assert name == "translation along the optical axis: 0.031 mm"
    sigmas = np.array([1e-6, 1e-3, 1e-6, 3.1e-5, 1e-5, 1e-5])
    name = name_least_determined(tmac_from_cam, np.diag(sigmas**2), distance_m=1.0)
    assert name == "rotation about the image's y-axis: 0.0573 deg"
    oblique = np.zeros((6, 6))
    oblique[3:, 3:] = np.array([[1, 1, 0], [1, 1, 0], [0, 0, 0.1]]) * 1e-10
    name = name_least_determined(RigidTransform.identity(), oblique, distance_m=1.0)
    assert name == "translation along (0.71, 0.71, 0.00) of cam: 0.014 mm"


def test_a_known_camera_stays_and_makes_the_hand_eye_transform_more_certain(
    scene: Callable, solve: Callable, bench: SimpleNamespace
) -> None:
    squares = []
    for seed in range(20, 30):
        truth = scene(seed, n=8, every=2)
        known = known_camera(truth.views, bench.camera, bench.board.pattern)
        solution = solve_hand_eye(truth.stations, known, bench.board.pattern, is_camera_free=False)
        assert solution.camera.camera == bench.camera
        assert not solution.camera.covariance.any()
        error = pose_difference(solution.hand_eye.tmac_from_cam, truth.tmac_from_cam)
        squares.append(error @ np.linalg.solve(solution.hand_eye.covariance, error))
    low, high = chi2.ppf([0.005, 0.995], 6 * len(squares))
    assert low < sum(squares) < high
    free = solve(truth.stations).hand_eye.covariance
    assert (np.diag(solution.hand_eye.covariance) < np.diag(free)).all()


def test_a_known_camera_needs_enough_corners(scene: Callable, bench: SimpleNamespace) -> None:
    view = scene(1, n=4).views[0]
    few = BoardView(view.ids[[0, 5, 7]], view.p_board_m[[0, 5, 7]], view.uv_px[[0, 5, 7]])
    with pytest.raises(CalibrationError, match="view 0 has 3 corners, at least 12"):
        known_camera([few], bench.camera, bench.board.pattern)
