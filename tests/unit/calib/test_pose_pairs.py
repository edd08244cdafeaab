"""Hand-eye from pairs of poses: covariance against theory, outliers, and what must be refused."""

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2

from tronlab.calib.hand_eye.pose_pairs import solve_pose_pairs
from tronlab.calib.inputs import PosePairInput, PosePairsInput, numbers_of
from tronlab.calib.results import HandEyeResult
from tronlab.errors import CalibrationError, DegenerateGeometryError
from tronlab.geometry.uncertainty import perturb, pose_difference

SIGMA = {"tmac_rotation_rad": 4e-4, "board_rotation_rad": 1e-3, "translation_m": 5e-4}
Poses = list[RigidTransform]


def measured(tmac: Sequence[RigidTransform], cam: Sequence[RigidTransform]) -> PosePairsInput:
    return PosePairsInput(
        measured_utc="2026-01-02T03:04:05Z",
        pairs=tuple(
            PosePairInput.model_validate(
                {"trk_from_tmac": numbers_of(a), "cam_from_board": numbers_of(b)}
            )
            for a, b in zip(tmac, cam, strict=True)
        ),
    )


def draw(
    seed: int, *, n: int = 25, noise: float = 1.0, hold: int = 1
) -> tuple[RigidTransform, Poses, Poses]:
    """Give truth, T-MAC and board poses; each error is held for ``hold`` pairs."""
    rng = np.random.default_rng(seed)
    truth = RigidTransform.from_components(rng.uniform(-0.2, 0.2, 3), Rotation.random(rng=rng))
    trk_from_board = RigidTransform.from_components(
        rng.uniform(-3.0, 3.0, 3), Rotation.random(rng=rng)
    )
    sigmas = list(SIGMA.values())
    tmac, cam = [], []
    for i in range(n):
        if i % hold == 0:
            turn, board_turn, shift = noise * rng.normal(size=(3, 3)) * np.array(sigmas)[:, None]
        board = RigidTransform.from_components(
            [*rng.uniform(-0.2, 0.2, 2), rng.uniform(0.5, 0.9)],
            Rotation.from_euler("xyz", rng.uniform(-0.6, 0.6, 3)),
        )
        reading = trk_from_board * board.inv() * truth.inv()
        tmac.append(perturb(reading, np.array([*turn, 0, 0, 0])))
        cam.append(perturb(board, np.array([*board_turn, *shift])))
    return truth, tmac, cam


def nees(result: HandEyeResult, truth: RigidTransform) -> float:
    difference = pose_difference(result.tmac_from_cam, truth)
    return float(difference @ np.linalg.solve(result.covariance, difference))


def test_exact_pairs_give_the_exact_answer() -> None:
    truth, tmac, cam = draw(0, n=6, noise=0.0)
    result = solve_pose_pairs(measured(tmac, cam))
    np.testing.assert_allclose(pose_difference(result.tmac_from_cam, truth), 0.0, atol=1e-8)
    assert result.statistics["outlier_pairs"] == []


def test_errors_agree_with_the_predicted_covariance_and_the_noise_is_found() -> None:
    seeds = range(12)
    squares, variances, held_out = [], [], []
    for seed in seeds:
        truth, tmac, cam = draw(seed, n=40)
        result = solve_pose_pairs(measured(tmac, cam))
        squares.append(nees(result, truth))
        variances.append(np.square(list(result.statistics["noise"].values())))
        held_out.append(result.statistics["held_out"]["rotation_rms_rad"])
    low, high = chi2.ppf([0.005, 0.995], 6 * len(squares))
    assert low < sum(squares) < high
    np.testing.assert_allclose(np.sqrt(np.mean(variances, axis=0)), list(SIGMA.values()), rtol=0.2)
    # Three rotations of T-MAC and board each, and a little for the transforms found without them.
    expected = np.sqrt(3 * (4e-4**2 + 1e-3**2) * (1 + 6 / (0.8 * 40 * 3)))
    assert np.mean(held_out) == pytest.approx(expected, rel=0.08)


def test_gross_outliers_are_listed_and_change_less_than_a_sigma() -> None:
    truth, tmac, cam = draw(2, n=20)
    clean = solve_pose_pairs(measured(tmac, cam))
    for i in (3, 11):
        tmac[i] = perturb(tmac[i], np.array([0.017, 0, 0, 5e-3, 0, 0]))
    spoiled = solve_pose_pairs(measured(tmac, cam))
    assert spoiled.statistics["outlier_pairs"] == [3, 11]
    assert any("2 of 20 pairs are left out" in line for line in spoiled.statistics["warnings"])
    moved = pose_difference(spoiled.tmac_from_cam, clean.tmac_from_cam)
    assert moved @ np.linalg.solve(clean.covariance, moved) < 1.0
    assert nees(spoiled, truth) < chi2.isf(1e-3, 6)


def test_errors_that_last_are_not_counted_as_independent() -> None:
    truth, tmac, cam = draw(4, n=240, hold=8)
    result = solve_pose_pairs(measured(tmac, cam))
    # Runs of 8 equal errors correlate by a triangle, whose sum is the length of a run.
    assert result.statistics["correlated_pairs"] == pytest.approx(8.0, rel=0.35)
    assert nees(result, truth) < chi2.isf(1e-3, 6)


def test_a_board_printed_too_large_is_warned_of() -> None:
    _, tmac, cam = draw(5)
    larger = [RigidTransform.from_components(1.03 * c.translation, c.rotation) for c in cam]
    warnings = solve_pose_pairs(measured(tmac, larger)).statistics["warnings"]
    assert any("multiplied by 0.969" in line and "squares" in line for line in warnings), warnings
    right = solve_pose_pairs(measured(tmac, cam)).statistics["warnings"]
    assert not any("squares" in line for line in right)


def scaled(poses: Poses, factor: float) -> Poses:
    return [RigidTransform.from_components(factor * p.translation, p.rotation) for p in poses]


def mirrored(poses: Poses) -> Poses:
    flip = np.diag([1.0, 1.0, -1.0])
    return [
        RigidTransform.from_components(
            flip @ p.translation, Rotation.from_matrix(flip @ p.rotation.as_matrix() @ flip)
        )
        for p in poses
    ]


@pytest.mark.parametrize(
    ("tmac_of", "cam_of", "message"),
    [
        (lambda a: scaled(a, 1e3), lambda c: c, r"T-MAC seem to be in millimetres, those of the"),
        (lambda a: a, lambda c: scaled(c, 1e3), r"board seem to be in millimetres, those of the"),
        (lambda a: scaled(a, 1e3), lambda c: scaled(c, 1e3), r"the board is \d{3} m from"),
        (lambda a: a, lambda c: scaled(c, 0.0), r"the board is 0 m from"),
        (mirrored, lambda c: c, "mirrored only"),
        (lambda a: a, mirrored, "mirrored only"),
        (lambda a: a, lambda c: [p.inv() for p in c], "one of the two is inverted"),
    ],
)
def test_poses_that_cannot_be_are_refused_with_the_reason(tmac_of, cam_of, message: str) -> None:
    _, tmac, cam = draw(6)
    with pytest.raises(CalibrationError, match=message):
        solve_pose_pairs(measured(tmac_of(tmac), cam_of(cam)))


def test_pairs_that_contradict_each_other_are_refused() -> None:
    _, tmac, cam = draw(7)
    with pytest.raises(CalibrationError, match=r"differ by \d+%.* same order"):
        solve_pose_pairs(measured(tmac, cam[5:] + cam[:5]))


@pytest.mark.parametrize("n", [5, 14])
def test_pairs_of_mixed_units_are_refused(n: int) -> None:
    """No one factor mends them, and their turns fit."""
    _, tmac, cam = draw(10, n=n)
    tmac[::2] = scaled(tmac[::2], 1e3)
    with pytest.raises(CalibrationError, match=r"scatters by .* are all of them in metres"):
        solve_pose_pairs(measured(tmac, cam))


def test_no_pairs_and_two_pairs_are_refused() -> None:
    _, tmac, cam = draw(8, n=2)
    with pytest.raises(DegenerateGeometryError, match="2 stations"):
        solve_pose_pairs(measured(tmac, cam))
    with pytest.raises(CalibrationError, match="no pairs"):
        solve_pose_pairs(measured([], []))


def test_a_pose_that_is_none_is_named() -> None:
    _, tmac, cam = draw(9, n=5)
    good = measured(tmac, cam)
    bad = good.pairs[3].model_copy(update={"cam_from_board": (0.0,) * 7})
    with pytest.raises(CalibrationError, match=r"pair 3: .*norm is 0"):
        solve_pose_pairs(good.model_copy(update={"pairs": (*good.pairs[:3], bad)}))
