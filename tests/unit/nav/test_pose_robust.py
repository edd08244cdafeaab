"""Robust pose estimation: every method, with many wrong matches, with few matches, by seed."""

import numpy as np
import pytest
from pose_views import CAMERA, TRUTH, make_matches
from pydantic import ValidationError

from tronlab.geometry.uncertainty import pose_difference
from tronlab.nav import settings
from tronlab.nav.pose import Correspondences, NoPoseError, find_agreeing, solve_sqpnp
from tronlab.nav.settings import PoseSettings

pytestmark = pytest.mark.opencv

ROBUST = ("ransac", "usac", "poselib")
MODERN = ("usac", "poselib")


def error_m(pose) -> float:
    return float(np.linalg.norm(pose_difference(pose, TRUTH)[3:]))


@pytest.mark.parametrize("method", ROBUST)
def test_half_of_the_matches_may_be_wrong(method: str, rng: np.random.Generator) -> None:
    matches = make_matches(rng, 200, sigma_px=0.5, n_wrong=100)
    for seed in range(3):
        pose, agrees = find_agreeing(matches, CAMERA, PoseSettings(robust=method), seed=seed)
        assert error_m(pose) < 0.005
        assert agrees[100:].mean() > 0.97
        assert agrees[:100].mean() < 0.03
        again, agrees_again = find_agreeing(matches, CAMERA, PoseSettings(robust=method), seed=seed)
        assert (again.as_matrix() == pose.as_matrix()).all()
        assert (agrees_again == agrees).all()


@pytest.mark.parametrize("method", MODERN)
def test_modern_methods_need_neither_many_nor_mostly_right_matches(method: str) -> None:
    for n, n_wrong in ((20, 10), (20, 12), (100, 85)):
        for seed in range(10):
            rng = np.random.default_rng([n_wrong, seed])
            matches = make_matches(rng, n, sigma_px=0.5, n_wrong=n_wrong)
            pose, _ = find_agreeing(matches, CAMERA, PoseSettings(robust=method), seed=seed)
            assert error_m(pose) < 0.1


@pytest.mark.parametrize("method", ROBUST)
@pytest.mark.parametrize(("sigma_px", "tolerance_px"), [(0.05, 0.4), (5.0, 40.0)])
def test_tolerance_goes_with_the_noise(
    method: str, sigma_px: float, tolerance_px: float, rng: np.random.Generator
) -> None:
    matches = make_matches(rng, 100, sigma_px=sigma_px, n_wrong=30)
    chosen = PoseSettings(robust=method, tolerance_px=tolerance_px)
    pose, agrees = find_agreeing(matches, CAMERA, chosen)
    assert error_m(pose) < 0.02 * sigma_px
    assert agrees[30:].mean() > 0.95


@pytest.mark.parametrize("method", MODERN)
def test_the_origin_may_be_far_away(method: str, rng: np.random.Generator) -> None:
    matches = make_matches(rng, 100, sigma_px=0.5, n_wrong=30)
    shift = np.array([2e5, -4e5, 1e5])
    far = Correspondences(matches.uv, matches.rays, matches.p_trs_m + shift, matches.scale)
    pose, agrees = find_agreeing(far, CAMERA, PoseSettings(robust=method))
    assert np.linalg.norm(pose.translation - shift - TRUTH.translation) < 0.01
    assert agrees[30:].mean() > 0.95


def test_seed_changes_what_ransac_draws(rng: np.random.Generator) -> None:
    matches = make_matches(rng, 60, sigma_px=2.0, n_wrong=25)
    few = PoseSettings(robust="ransac", tolerance_px=2.0)
    poses = [find_agreeing(matches, CAMERA, few, seed=seed)[0] for seed in range(4)]
    assert len({error_m(pose) for pose in poses}) > 1
    assert max(error_m(pose) for pose in poses) < 0.1


@pytest.mark.parametrize("method", ROBUST)
def test_only_the_best_matches_are_looked_at(method: str, rng: np.random.Generator) -> None:
    matches = make_matches(rng, 120, sigma_px=0.3)
    _, agrees = find_agreeing(matches, CAMERA, PoseSettings(robust=method, n_best=50))
    assert agrees.shape == (120,)
    assert agrees[:50].all()
    assert not agrees[50:].any()


def test_without_a_robust_method_all_are_trusted(rng: np.random.Generator) -> None:
    matches = make_matches(rng, 50, sigma_px=0.3, n_wrong=2)
    pose, agrees = find_agreeing(matches, CAMERA, PoseSettings(robust="none", n_best=5))
    assert agrees.all()
    assert (pose.as_matrix() == solve_sqpnp(matches).as_matrix()).all()


@pytest.mark.parametrize("method", ROBUST)
def test_matches_without_a_pose_are_no_pose(method: str, rng: np.random.Generator) -> None:
    chosen = PoseSettings(robust=method)
    with pytest.raises(NoPoseError, match="5 matches, at least 6 needed"):
        find_agreeing(make_matches(rng, 5), CAMERA, chosen)
    with pytest.raises(NoPoseError, match=r"at least 6 needed|no pose that 6 of 40"):
        find_agreeing(make_matches(rng, 40, n_wrong=40), CAMERA, chosen)
    everywhere = make_matches(rng, 40)
    one = everywhere.take(np.zeros(40, np.intp))
    same_point = Correspondences(everywhere.uv, everywhere.rays, one.p_trs_m, one.scale)
    with pytest.raises(NoPoseError):
        find_agreeing(same_point, CAMERA, chosen)


def test_poselib_that_is_not_installed_says_how_to_get_it(monkeypatch) -> None:
    monkeypatch.setattr(settings, "find_spec", lambda _name: None)
    assert PoseSettings(robust="usac").robust == "usac"
    with pytest.raises(ValidationError, match=r"pip install 'tronlab\[poselib\]', or choose usac"):
        PoseSettings(robust="poselib")
