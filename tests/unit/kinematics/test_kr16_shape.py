"""The links of the arm follow its axes, and stay within the levers a check of motions relies on."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tronlab.kinematics.kr16 import KR16_LIMITS_RAD, flange_place_m, forward
from tronlab.kinematics.kr16_shape import (
    FOREARM,
    HAND,
    LINK_NAMES,
    LINK_RADII_M,
    UPPER_ARM,
    WRIST,
    arm_shape,
    levers_m,
)

seeds = st.integers(0, 10_000)


def random_axes(rng: np.random.Generator, n: int) -> np.ndarray:
    return rng.uniform(KR16_LIMITS_RAD[:, 0], KR16_LIMITS_RAD[:, 1], (n, 6))


def test_flange_is_where_the_kinematics_have_it():
    axes_rad = random_axes(np.random.default_rng(0), 25)
    shape = arm_shape(axes_rad)
    for i, axes in enumerate(axes_rad):
        base_from_flange = forward(axes)
        np.testing.assert_array_equal(flange_place_m(axes), base_from_flange.translation)
        np.testing.assert_allclose(
            shape.p_flange_base_m[i], base_from_flange.translation, atol=1e-12
        )
        np.testing.assert_allclose(
            shape.flange_rotation[i], base_from_flange.rotation.as_matrix(), atol=1e-12
        )


def test_stretched_forward_the_links_lie_as_in_the_drawing():
    ends_m = arm_shape(np.zeros((1, 6))).ends_base_m[0]
    # Upper arm from A2 (0.26 out) to A3 (0.94), beside the middle; all at the shoulder's height.
    np.testing.assert_allclose(ends_m[UPPER_ARM, :, 0], [0.26, 0.924], atol=1e-9)
    np.testing.assert_allclose(ends_m[UPPER_ARM, :, 2], 0.675, atol=1e-9)
    assert np.all(ends_m[UPPER_ARM, :, 1] < -0.1)
    # Forearm reaches behind the elbow, with its motors; the wrist centre is 1.61 m out.
    assert ends_m[FOREARM, 0, 0] < 0.94 < ends_m[FOREARM, 1, 0]
    np.testing.assert_allclose(ends_m[HAND, 0], [1.61, 0.0, 0.64], atol=1e-9)


@pytest.mark.parametrize(
    ("link", "point_m"),
    [
        # Extents of the public collision meshes, in the frames of their links at zero, from the
        # base: nothing of a link may stick out of its capsule.
        (UPPER_ARM, [0.26 - 0.091, -0.177, 0.675]),
        (UPPER_ARM, [0.26 + 0.773, -0.177, 0.675]),
        (UPPER_ARM, [0.26 + 0.34, -0.277, 0.675]),
        (FOREARM, [0.94 - 0.356, 0.05, 0.675]),
        (FOREARM, [0.94 + 0.0, 0.213, 0.675]),
        (WRIST, [1.61 - 0.268, 0.0, 0.640]),
        (HAND, [1.768, 0.0, 0.640]),
    ],
)
def test_capsules_reach_as_far_as_the_meshes(link: int, point_m: list[float]):
    p0, p1 = arm_shape(np.zeros((1, 6))).ends_base_m[0, link]
    along = np.clip((point_m - p0) @ (p1 - p0) / ((p1 - p0) @ (p1 - p0)), 0.0, 1.0)
    assert np.linalg.norm(point_m - p0 - along * (p1 - p0)) < LINK_RADII_M[link]


@settings(max_examples=40, deadline=None)
@given(seeds)
def test_no_body_moves_farther_than_turns_times_levers(seed: int):
    rng = np.random.default_rng(seed)
    before, after = random_axes(rng, 1), random_axes(rng, 1)
    payload_flange_m = rng.uniform(-0.3, 0.3, 3)
    payload_m = float(np.linalg.norm(payload_flange_m + np.array([0.0, 0.0, 0.158])))
    bound_m = levers_m(payload_m) @ np.abs(after - before)[0]
    ends = [arm_shape(axes).ends_base_m[0] for axes in (before, after)]
    moved_m = np.linalg.norm(ends[1] - ends[0], axis=-1).max(axis=-1)
    tips = [forward(axes[0]).apply(payload_flange_m) for axes in (before, after)]
    assert np.all(moved_m <= bound_m[: len(LINK_NAMES)] + 1e-12)
    assert np.linalg.norm(tips[1] - tips[0]) <= bound_m[-1] + 1e-12
