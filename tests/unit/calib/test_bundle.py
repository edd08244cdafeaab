from collections.abc import Callable, Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform
from scipy.stats import chi2

from tronlab.calib.camera.board import BoardView
from tronlab.calib.camera.bow import N_BOW, bowed
from tronlab.calib.camera.projection import N_INTRINSICS, free_intrinsics, intrinsics_of
from tronlab.calib.camera.state import CameraKind
from tronlab.calib.elimination import N_OWN, Rows, eliminate, minimise
from tronlab.calib.hand_eye.bundle import (
    BundleProblem,
    BundleSolution,
    BundleState,
    Station,
    distances_without_own,
    evaluate,
    make_problem,
    solve_bundle,
)
from tronlab.errors import CalibrationError
from tronlab.geometry.poses import FloatArray
from tronlab.geometry.uncertainty import perturb, pose_difference

SIGMA_PX = 0.05
BOW_M = np.array([1.2e-3, -0.8e-3, 0.5e-3])


@pytest.fixture(scope="module")
def lay_out(bench: SimpleNamespace) -> Callable[..., tuple[BundleProblem, BundleState]]:
    """Give the problem of a scene, and the true state."""

    def of(
        truth: SimpleNamespace,
        *,
        bow_m: FloatArray | None = None,
        free_views: Sequence[tuple[RigidTransform, BoardView]] = (),
        model: str | None = "brown",
    ) -> tuple[BundleProblem, BundleState]:
        free = CameraKind(model or "pinhole", is_bow_free=bow_m is not None).free
        stations = dict(enumerate(truth.stations))
        if bow_m is not None:
            stations = {
                i: Station(station.reading, bend(station.view, pose, bow_m))
                for (i, station), pose in zip(stations.items(), truth.cam_from_board, strict=True)
            }
        problem = make_problem(
            stations,
            [view for _, view in free_views],
            bench.board.pattern,
            free=free if model else free[free >= N_INTRINSICS],
            sigma_px=SIGMA_PX,
        )
        poses = [*truth.cam_from_board, *(pose for pose, _ in free_views)]
        state = BundleState(
            camera=bench.camera,
            bow_m=np.zeros(3) if bow_m is None else bow_m,
            tmac_from_cam=truth.tmac_from_cam,
            trk_from_board=truth.trk_from_board,
            cam_from_board=RigidTransform.concatenate(poses),
        )
        return problem, state

    def bend(view: BoardView, pose: RigidTransform, bow_m: FloatArray) -> BoardView:
        flat = bench.camera.project(pose.apply(view.p_board_m))
        bent = pose.apply(bowed(view.p_board_m, bench.board.pattern, bow_m))
        return replace(view, uv_px=view.uv_px + bench.camera.project(bent) - flat)

    return of


def moved_away(problem: BundleProblem, state: BundleState, seed: int) -> BundleState:
    """Give a rough start."""
    rng = np.random.default_rng(seed)
    common = 0.01 * rng.normal(size=problem.n_common)
    sizes = np.array([300.0] * 4 + [0.5] * (N_INTRINSICS - 4) + [0.1] * N_BOW)
    common[: len(problem.free)] *= sizes[problem.free]
    own = 0.005 * rng.normal(size=(len(problem.pixel_weights), 6))
    return problem.moved(state, own, common)


def test_derivatives_are_those_of_finite_differences(scene: Callable, lay_out: Callable) -> None:
    problem, state = lay_out(scene(1, n=3), bow_m=BOW_M)
    state = moved_away(problem, state, seed=1)
    rows = problem.rows(state)
    for column in range(6 + problem.n_common):
        step = np.zeros((2, 6 + problem.n_common))
        step[:, column] = 1e-6, -1e-6
        ahead, behind = (
            problem.rows(problem.moved(state, np.tile(one[:6], (3, 1)), one[6:])) for one in step
        )
        for of in ("blocks", "shared"):
            slope = (getattr(ahead, of)[..., -1] - getattr(behind, of)[..., -1]) / 2e-6
            found = getattr(rows, of)[..., column if of == "blocks" else column - 6]
            if of == "blocks" or column >= 6:
                np.testing.assert_allclose(found, slope, atol=1e-6 * np.abs(slope).max() + 1e-6)


def test_elimination_gives_step_and_covariance_of_the_dense_problem(
    scene: Callable, lay_out: Callable
) -> None:
    problem, state = lay_out(scene(2, n=4), bow_m=BOW_M)
    rows = problem.rows(moved_away(problem, state, seed=2))
    n, m, width = rows.blocks.shape
    dense = np.zeros((n * m + len(rows.shared), 6 * n + width - 6))
    for i, block in enumerate(rows.blocks):
        dense[i * m : (i + 1) * m, 6 * i : 6 * i + 6] = block[:, :6]
        dense[i * m : (i + 1) * m, 6 * n :] = block[:, 6:]
    dense[n * m :, 6 * n :] = rows.shared
    step, *_ = np.linalg.lstsq(dense[:, :-1], -dense[:, -1])
    covariance = np.linalg.pinv(dense[:, :-1].T @ dense[:, :-1], rcond=1e-18)

    eliminated = eliminate(rows)
    common = eliminated.common()
    np.testing.assert_allclose(common.step, step[6 * n :], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(
        eliminated.own_steps(common.step).ravel(), step[: 6 * n], rtol=1e-6, atol=1e-9
    )
    sigma = np.sqrt(np.diag(covariance))
    of_second = np.r_[6:12, 6 * n : len(covariance)]
    np.testing.assert_allclose(
        eliminated.covariance(common.covariance)[1]
        / np.outer(sigma, sigma)[of_second][:, of_second],
        (covariance / np.outer(sigma, sigma))[of_second][:, of_second],
        atol=1e-6,
    )


def test_exact_data_give_the_exact_answer_from_a_rough_start(
    scene: Callable, lay_out: Callable
) -> None:
    problem, state = lay_out(scene(2, n=8, noise=0.0), bow_m=BOW_M)
    solution = solve_bundle(problem, moved_away(problem, state, seed=3))
    found = solution.state
    # The weak prior of the bow pulls by some micrometres, and all else follows.
    np.testing.assert_allclose(found.bow_m, BOW_M, atol=1e-6)
    for name in ("tmac_from_cam", "trk_from_board"):
        difference = pose_difference(getattr(found, name), getattr(state, name))
        np.testing.assert_allclose(difference, 0.0, atol=1e-6)
    sigmas = np.sqrt(np.diag(solution.camera_covariance))
    error = intrinsics_of(found.camera) - intrinsics_of(state.camera)
    assert (np.abs(error) <= 0.02 * sigmas).all()
    assert solution.chi_square_pixels + solution.chi_square_poses < 1e-3


@pytest.mark.parametrize("bow_m", [None, BOW_M], ids=["flat", "bowed"])
def test_errors_and_residuals_agree_with_what_is_predicted(
    scene: Callable, lay_out: Callable, bow_m: FloatArray | None
) -> None:
    squares: dict[str, list[float]] = {}
    dof = {"pixels": 0.0, "poses": 0.0}

    def add(name: str, error: FloatArray, covariance: FloatArray) -> None:
        squares.setdefault(name, []).append(float(error @ np.linalg.solve(covariance, error)))
        dof[name] = dof.get(name, 0.0) + len(error)

    corrections: list[FloatArray] = []
    distances: list[FloatArray] = []
    for seed in range(100, 130):
        problem, true = lay_out(scene(seed, n=6, every=2), bow_m=bow_m)
        solution = solve_bundle(problem, true)
        found, free = solution.state, free_intrinsics("brown")
        error = pose_difference(found.tmac_from_cam, true.tmac_from_cam)
        add("hand_eye", error, solution.tmac_from_cam_covariance)
        error = intrinsics_of(found.camera) - intrinsics_of(true.camera)
        add("intrinsics", error[free], solution.camera_covariance[np.ix_(free, free)])
        if bow_m is not None:
            add("bow", found.bow_m - true.bow_m, solution.bow_covariance_m2)
        for name in ("pixels", "poses"):
            squares.setdefault(name, []).append(getattr(solution, f"chi_square_{name}"))
            dof[name] += getattr(solution, f"dof_{name}")
        sigmas = np.sqrt(np.einsum("nii->ni", solution.pose_correction_covariances))
        corrections.append(solution.pose_corrections / sigmas)
        distances.append(solution.distances)
    for name, values in squares.items():
        low, high = chi2.ppf([0.005, 0.995], dof[name])
        assert low < sum(values) < high, name
    # Corrections of one scene depend on each other: no exact bounds.
    assert np.mean(np.square(corrections)) == pytest.approx(1.0, abs=0.15)
    assert np.mean(distances) == pytest.approx(6.0, abs=0.9)


def test_the_distance_of_a_reading_is_that_from_a_solution_without_it(
    scene: Callable, lay_out: Callable
) -> None:
    problem, true = lay_out(scene(5, n=7))
    trusted = solve_bundle(problem, true).distances
    for i in range(7):
        without = problem.trusting(np.where(np.arange(7) == i, 0.0, 1.0))
        assert solve_bundle(without, true).distances[i] == pytest.approx(trusted[i], rel=1e-3)


def test_a_reading_that_nothing_checks_has_no_distance() -> None:
    distances = distances_without_own(np.ones((1, 6)), np.eye(6)[None], np.ones(1))
    assert distances.tolist() == [0.0]


def test_a_station_without_trust_is_a_free_view(scene: Callable, lay_out: Callable) -> None:
    truth = scene(6, n=8)
    problem, state = lay_out(truth)
    untrusting = problem.trusting(np.array([1.0] * 5 + [0.0] * 3))
    free = [(truth.cam_from_board[i], truth.stations[i].view) for i in (5, 6, 7)]
    fewer = replace(truth, stations=truth.stations[:5], cam_from_board=truth.cam_from_board[:5])
    one = solve_bundle(untrusting, state)
    other = solve_bundle(*lay_out(fewer, free_views=free))
    np.testing.assert_allclose(
        pose_difference(one.state.tmac_from_cam, other.state.tmac_from_cam), 0.0, atol=1e-9
    )
    np.testing.assert_allclose(one.camera_covariance, other.camera_covariance, rtol=1e-6)
    assert one.chi_square_poses == pytest.approx(other.chi_square_poses, rel=1e-6)
    assert one.dof_poses == pytest.approx(other.dof_poses, rel=1e-6)
    assert len(other.residuals_px) == 8
    assert len(other.pose_corrections) == 5


def test_free_views_make_the_camera_more_certain(
    scene: Callable, lay_out: Callable, bench: SimpleNamespace
) -> None:
    rng = np.random.default_rng(8)
    poses = [bench.look_at_board(rng) for _ in range(6)]
    free = [(pose, bench.observe(pose, rng, SIGMA_PX)) for pose in poses]
    truth = scene(7, n=8)
    alone, helped = (solve_bundle(*lay_out(truth, free_views=views)) for views in ((), free))

    def sigma(solution: BundleSolution) -> FloatArray:
        return np.sqrt(np.diag(solution.camera_covariance)[:4])

    assert (sigma(helped) < sigma(alone)).all()


def test_a_fixed_camera_stays_and_has_no_covariance(scene: Callable, lay_out: Callable) -> None:
    problem, state = lay_out(scene(8, n=6), model=None)
    solution = solve_bundle(problem, state)
    assert solution.state.camera == state.camera
    assert not solution.camera_covariance.any()
    error = pose_difference(solution.state.tmac_from_cam, state.tmac_from_cam)
    assert error @ np.linalg.solve(solution.tmac_from_cam_covariance, error) < chi2.isf(0.01, 6)


def test_a_displaced_reading_is_far_from_what_the_others_say(
    scene: Callable, lay_out: Callable
) -> None:
    truth = scene(3, n=12)
    stations = list(truth.stations)
    moved = perturb(stations[4].reading.trk_from_tmac, np.array([0, 0, 0, 0.002, 0, 0]))
    stations[4] = Station(replace(stations[4].reading, trk_from_tmac=moved), stations[4].view)
    solution = solve_bundle(*lay_out(replace(truth, stations=tuple(stations))))
    assert solution.chi_square_poses > chi2.isf(0.001, solution.dof_poses)
    assert np.argmax(solution.distances) == 4


def test_a_reading_without_covariance_is_refused(scene: Callable, lay_out: Callable) -> None:
    truth = scene(3, n=4)
    stations = list(truth.stations)
    stations[2] = replace(
        stations[2], reading=replace(stations[2].reading, covariance=np.zeros((6, 6)))
    )
    with pytest.raises(CalibrationError, match="station 2 is not positive definite"):
        lay_out(replace(truth, stations=tuple(stations)))


class Valley:
    """Determined well across a bent valley, weakly along it: full steps leave it."""

    def __init__(self, *, along: float) -> None:
        self.along, self.n_evaluations = along, 0

    def rows(self, state: FloatArray) -> Rows:
        self.n_evaluations += 1
        x, y = state
        blocks = np.zeros((1, N_OWN, N_OWN + 3))
        blocks[0, :, :N_OWN] = np.eye(N_OWN)
        across = 10.0 * np.array([-6.0 * x, 1.0, y - 3.0 * x**2])
        return Rows(blocks, np.stack([across, self.along * np.array([1.0, 0.0, x - 1.0])]))

    def moved(self, state: FloatArray, own: FloatArray, common: FloatArray) -> FloatArray:
        return state + common


def test_the_way_along_a_bent_valley_is_found() -> None:
    found = minimise(Valley(along=1.0), np.array([-1.2, 1.0]))
    np.testing.assert_allclose(found, [1.0, 3.0], atol=1e-9)


def test_a_bend_that_says_nothing_does_not_hold_up_the_solution() -> None:
    """Full steps along the valley raise the sum of squares, but promise to lower it by nothing."""
    valley = Valley(along=0.01)
    found = minimise(valley, np.array([-1.2, 1.0]))
    assert valley.n_evaluations < 20
    assert abs(found[0] - 1.0) < 0.04 / valley.along
    assert valley.rows(found).cost < 1e-3


def test_undetermined_unknowns_are_refused(scene: Callable, lay_out: Callable) -> None:
    truth = scene(3, n=1)
    with pytest.raises(CalibrationError, match="do not determine"):
        minimise(*lay_out(truth))


def test_evaluation_at_the_solution_changes_nothing(scene: Callable, lay_out: Callable) -> None:
    problem, state = lay_out(scene(9, n=6))
    solution = solve_bundle(problem, state)
    again = evaluate(problem, minimise(problem, solution.state))
    difference = pose_difference(again.state.tmac_from_cam, solution.state.tmac_from_cam)
    np.testing.assert_allclose(difference, 0.0, atol=1e-10)
