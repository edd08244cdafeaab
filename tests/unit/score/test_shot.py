"""One shot and cores that misbehave: each becomes a result with its reason, and nothing is lost."""

import time
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from tronlab.dataset.reader import Dataset
from tronlab.nav.core import NavigationResult
from tronlab.score.shot import locate, score_shot

IMAGE = np.zeros((4, 6), np.uint8)
MASK = np.ones((4, 6), bool)


class Answering:
    """A core that always gives the same answer."""

    name = "answering"

    def __init__(self, **changes: object) -> None:
        self._changes = changes

    def locate(self, image: np.ndarray, mask: np.ndarray) -> NavigationResult:
        return NavigationResult(
            **{"status": "ok", "trs_from_cam": RigidTransform.identity(), **self._changes}
        )


class Hanging:
    name = "hanging"

    def locate(self, image: np.ndarray, mask: np.ndarray) -> NavigationResult:
        while True:
            with suppress(Exception):  # a core that swallows what it can
                time.sleep(0.01)


def test_a_good_answer_is_passed_on() -> None:
    assert locate(Answering(), IMAGE, MASK).status == "ok"


def test_a_core_that_hangs_is_a_timeout_and_the_next_shot_has_its_full_time() -> None:
    result = locate(Hanging(), IMAGE, MASK, limit_s=0.05)
    assert (result.status, result.reason) == ("timeout", "no answer within 0.05 s")
    time.sleep(0.1)  # an alarm left behind would ring now


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"n_features": float("nan")}, "n_features is nan, must be a whole number from 0"),
        ({"n_inliers": -1}, "n_inliers is -1"),
        ({"n_matches": None}, "n_matches is None"),
        ({"time_pose_s": float("inf")}, "time_pose_s is inf, must be finite"),
        ({"covariance": np.eye(3)}, r"the covariance is not finite or not of shape"),
        ({"covariance": np.full((6, 6), np.nan)}, r"the covariance is not finite"),
        ({"uv_inliers": np.zeros((3, 3))}, "uv_inliers have shape"),
        ({"status": "fine"}, "unknown status 'fine'"),
    ],
)
def test_an_answer_that_makes_no_sense_is_an_error_with_its_reason(changes, reason) -> None:
    result = locate(Answering(**changes), IMAGE, MASK)
    assert result.status == "error"
    assert reason in result.reason


def test_a_damaged_image_costs_one_shot_only(small_dataset: Path) -> None:
    with h5py.File(small_dataset, "r+") as file:
        file["entry/data/image"][2, 0, 0] ^= 1
    with Dataset(small_dataset) as dataset:
        statuses = [
            score_shot(dataset, i, cores={"answering": Answering()})[0].result.status
            for i in range(dataset.n_shots)
        ]
    assert statuses == ["ok", "ok", "error", "ok", "ok"]
