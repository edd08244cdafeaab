"""What stands in headers: read exactly, or refused with one kind of error."""

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plain_cores import CAMERA
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.geometry.camera import CameraModel
from tronlab.nav.core import NavigationResult, PosePrior
from tronlab.nav.foreign.messages import Message, MessageError
from tronlab.nav.foreign.wording import (
    camera_to_json,
    pose_from_json,
    pose_to_json,
    prior_from_json,
    prior_to_json,
    result_from_message,
)

GOOD: dict[str, Any] = {
    "type": "result",
    "number": 3,
    "status": "ok",
    "pose": {
        "parent": "trs",
        "child": "cam",
        "position_m": [1, 2.5, 3],
        "quaternion_xyzw": [0.6, 0.0, 0.0, 0.8],
    },
    "covariance": np.eye(6).ravel().tolist(),
    "bound": None,
    "reason": None,
    "database": None,
    "n_features": 5,
    "n_matches": None,
    "n_inliers": 0,
    "time_detect_s": 0.5,
    "time_match_s": None,
    "time_pose_s": 0,
    "parts": [{"name": "uv_inliers", "dtype": "f8", "shape": [1, 2], "offset": 0}],
}
ODD = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=4)
    | st.just(10**400) | st.sampled_from(["trs", "cam", "ok", "f8", "uv_inliers", "payload"]),
    lambda inner: st.lists(inner, max_size=4)
    | st.dictionaries(st.sampled_from([*GOOD["pose"], *GOOD["parts"][0]]), inner, max_size=4),
    max_leaves=6,
)  # fmt: skip


def read(header: dict[str, Any]) -> NavigationResult:
    return result_from_message(Message(header, np.array([1.5, 2.5]).tobytes()), waited_s=9.0)


def test_a_result_is_read_with_what_it_leaves_out() -> None:
    result = read(json.loads(json.dumps(GOOD)))
    assert result.trs_from_cam is not None
    np.testing.assert_array_equal(result.trs_from_cam.translation, [1.0, 2.5, 3.0])
    np.testing.assert_allclose(result.trs_from_cam.rotation.as_quat(), [0.6, 0, 0, 0.8], atol=1e-15)
    assert (result.n_features, result.n_matches, result.time_detect_s) == (5, 0, 0.5)
    assert (result.time_pose_s, result.reason, result.uv_inliers.tolist()) == (
        0.0,
        "",
        [[1.5, 2.5]],
    )
    silent = {key: None for key in GOOD if key.startswith(("n_", "time_"))}
    assert read({**GOOD, **silent, "time_match_s": 0}).time_pose_s == 9.0
    no_pose = read({"type": "result", "status": "no_pose", "reason": "dark", "pose": "none"})
    assert (no_pose.status, no_pose.trs_from_cam, no_pose.reason) == ("no_pose", None, "dark")


@settings(max_examples=40, deadline=None)
@given(st.data())
def test_whatever_a_result_says_is_a_result_or_a_short_complaint(data: st.DataObject) -> None:
    header = json.loads(json.dumps(GOOD))
    for _ in range(data.draw(st.integers(1, 2))):
        where = data.draw(st.sampled_from([header, header["pose"], header["parts"][0]]))
        where[data.draw(st.sampled_from(sorted(where)))] = data.draw(ODD)
        if not isinstance(header["pose"], dict) or not isinstance(header["parts"], list):
            break
        if not header["parts"] or not isinstance(header["parts"][0], dict):
            break
    try:
        result = read(header)
    except (ValueError, TypeError, MessageError) as error:
        assert len(str(error)) < 1000  # noqa: PT017  # either outcome is right
    else:
        assert isinstance(result, NavigationResult)


@settings(max_examples=15, deadline=None)
@given(
    st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=3),
    st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1),
)
def test_a_pose_passes_through_json_unchanged(xyz: list[float], quaternion: list[float]) -> None:
    pose = RigidTransform.from_components(xyz, Rotation.from_quat(quaternion))
    back = pose_from_json(json.loads(json.dumps(pose_to_json(pose))))
    np.testing.assert_array_equal(back.translation, pose.translation)
    assert (back.rotation.inv() * pose.rotation).magnitude() < 1e-15


def test_a_prior_passes_through_json_unchanged(rng: np.random.Generator) -> None:
    factor = rng.normal(size=(6, 6))
    prior = PosePrior(RigidTransform.from_translation([1.0, 2.0, 3.0]), factor @ factor.T)
    back = prior_from_json(json.loads(json.dumps(prior_to_json(prior))))
    assert back is not None
    np.testing.assert_array_equal(back.covariance, prior.covariance)
    assert prior_from_json(prior_to_json(None)) is None
    with pytest.raises(ValueError, match="prior has no covariance"):
        prior_from_json({"pose": GOOD["pose"]})


def test_a_camera_shows_rational_terms_only_where_it_has_them() -> None:
    assert camera_to_json(CAMERA)["distortion"] == [-0.1, 0.02, 1e-4, -2e-4, 0.01]
    rational = CameraModel(9, 9, 1.0, 1.0, 4.0, 4.0, (0.1, 0, 0, 0, 0, 0.2))
    told = json.loads(json.dumps(camera_to_json(rational)))
    assert told["distortion"] == [0.1, 0, 0, 0, 0, 0.2, 0, 0]
    assert CameraModel.from_dict(told) == rational
