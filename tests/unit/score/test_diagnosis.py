"""A core that means another convention is told which; one that is just wrong is not."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.dataset.records import Truth
from tronlab.nav.core import NavigationResult
from tronlab.score.diagnosis import convention_hint

NAMES = ("cam_from_trs", "OpenGL", "quaternions in the order w, x, y, z", "millimetres")
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


def truths_of(seed, n=6):
    rng = np.random.default_rng(seed)
    return [
        Truth(
            RigidTransform.from_components(
                rng.uniform([-1, -1, 2], [1, 1, 4]), Rotation.random(random_state=rng)
            ),
            np.eye(6) * 1e-8,
            range_los_m=3.0,
            usable_fraction=1.0,
        )
        for _ in range(n)
    ]


def misread(pose, *, inverse, opengl, wxyz, mm):
    """What we read when a core answers in its own convention."""
    matrix = pose.as_matrix() @ (FLIP if opengl else np.eye(4))
    if inverse:
        matrix = np.linalg.inv(matrix)
    x, y, z, w = Rotation.from_matrix(matrix[:3, :3]).as_quat()
    quaternion = [w, x, y, z] if wxyz else [x, y, z, w]
    return RigidTransform.from_components(
        matrix[:3, 3] * (1000.0 if mm else 1.0), Rotation.from_quat(quaternion)
    )


def answers(poses):
    return [NavigationResult("ok", pose) for pose in poses]


@settings(max_examples=25, deadline=None)
@given(st.sampled_from(list(product([False, True], repeat=4))), st.integers(0, 1000))
def test_every_mixture_of_conventions_is_named(flags, seed):
    names = ("inverse", "opengl", "wxyz", "mm")
    truths = truths_of(seed)
    rng = np.random.default_rng(seed)
    noise = [RigidTransform.from_translation(rng.normal(0, 0.005, 3)) for _ in truths]
    poses = [
        misread(shift * truth.trs_from_cam, **dict(zip(names, flags, strict=True)))
        for shift, truth in zip(noise, truths, strict=True)
    ]
    hint = convention_hint(truths, answers(poses))
    assert [name in hint for name in NAMES] == list(flags)
    assert bool(hint) == any(flags)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 1000))
def test_answers_that_are_just_wrong_have_no_hint(seed):
    truths, others = truths_of(seed), truths_of(seed + 5000)
    assert not convention_hint(truths, answers(other.trs_from_cam for other in others))


def test_a_few_gross_errors_neither_make_nor_hide_a_hint():
    truths = truths_of(1, 9)
    good = [truth.trs_from_cam for truth in truths]
    wrong = [misread(pose, inverse=True, opengl=False, wxyz=False, mm=False) for pose in good]
    assert not convention_hint(truths, answers([*wrong[:3], *good[3:]]))
    assert "cam_from_trs" in convention_hint(truths, answers([*good[:3], *wrong[3:]]))


@pytest.mark.parametrize("n", [0, 2])
def test_few_answers_have_no_hint(n):
    truths = truths_of(1)
    wrong = [misread(t.trs_from_cam, inverse=0, opengl=0, wxyz=0, mm=1) for t in truths]
    results = [*answers(wrong[:n]), *[NavigationResult("no_pose")] * (len(truths) - n)]
    assert not convention_hint(truths, results)
