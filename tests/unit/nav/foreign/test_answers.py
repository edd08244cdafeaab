"""What passes for an answer, and what does not."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from tronlab.nav.answers import checked
from tronlab.nav.core import NavigationResult

GOOD = NavigationResult(
    "ok",
    RigidTransform.from_translation([1.0, 2.0, 3.0]),
    covariance=np.diag([1e-12, 1e-9, 1e-9, 1e-6, 0.0, 1.0]),
    n_features=np.int64(5),  # type: ignore[arg-type]
    uv_inliers=np.ones((2, 2)),
    landmark_inliers=np.array([3, 4]),
)


def matrix(change: tuple[int, int], value: float) -> np.ndarray:
    covariance = np.diag([1e-8, 1e-8, 1e-8, 1.0, 1.0, 1.0])
    covariance[change] = value
    return covariance


def test_good_answers_come_back_as_they_are() -> None:
    for result in (GOOD, NavigationResult("no_pose", reason="dark"), NavigationResult("timeout")):
        assert checked(result) is result


def test_covariances_of_real_least_squares_pass(rng: np.random.Generator) -> None:
    """Inverted normal matrices, conditioned as badly as a flat distant scene makes them."""
    for condition in (1e2, 1e6, 1e10):
        scale = np.geomspace(1.0, np.sqrt(condition), 6)
        jacobian = rng.normal(size=(60, 6)) * scale
        covariance = np.linalg.inv(jacobian.T @ jacobian)
        assert checked(replace(GOOD, covariance=covariance)).covariance is covariance


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"status": "fine"}, "unknown status 'fine'"),
        ({"trs_from_cam": None}, "'ok' without a pose"),
        ({"trs_from_cam": np.eye(4)}, "'ok' without a pose"),
        ({"trs_from_cam": RigidTransform.from_translation([np.nan, 0, 0])}, "not finite"),
        ({"trs_from_cam": RigidTransform.from_translation(np.zeros((2, 3)))}, "or several"),
        ({"n_matches": -1}, "n_matches is -1, must be from 0"),
        ({"n_inliers": 1.0}, "n_inliers is 1.0, must be a whole number"),
        ({"n_features": True}, "n_features is True"),
        ({"n_features": 1 << 70}, "n_features is 1180591620717411303424"),
        ({"time_pose_s": np.nan}, "time_pose_s is nan"),
        ({"time_match_s": -1.0}, "time_match_s is -1.0"),
        ({"time_detect_s": None}, "time_detect_s is None"),
        ({"time_detect_s": 10**400}, "time_detect_s is 10"),
        ({"covariance": np.eye(3)}, r"covariance is not finite or not of shape \(6, 6\)"),
        ({"bound": matrix((0, 0), np.inf)}, "bound is not finite"),
        ({"covariance": matrix((0, 1), 1e-9)}, "covariance is not symmetric"),
        ({"covariance": matrix((0, 0), -1e-8)}, "a variance below 0"),
        ({"covariance": matrix((0, 1), 1e308)}, "covariance is not symmetric"),
        ({"covariance": np.full((6, 6), 1e308) - np.diag([1e308] * 6)}, "a variance below 0"),
        ({"uv_inliers": np.ones((2, 3))}, r"uv_inliers have shape \(2, 3\)"),
        ({"uv_inliers": np.full((2, 2), np.nan)}, "all finite"),
        ({"landmark_inliers": np.arange(3)}, r"landmark_inliers have shape \(3,\)"),
    ],
)  # fmt: skip
def test_what_cannot_be_an_answer_is_named(change: dict[str, Any], what: str) -> None:
    with pytest.raises(ValueError, match=what):
        checked(replace(GOOD, **change))


def test_something_else_is_no_answer() -> None:
    with pytest.raises(TypeError, match="answered a dict, not a NavigationResult"):
        checked({"status": "ok"})
