"""Answers as bytes: every bit comes back, and nothing that was not packed."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.nav.core import NavigationResult
from tronlab.score.rescoring.packing import PackingError, pack, pack_result, unpack, unpack_result


def some_result(seed: int, n: int = 40) -> NavigationResult:
    rng = np.random.default_rng(seed)
    return NavigationResult(
        "ok",
        RigidTransform.from_components(rng.normal(size=3), Rotation.random(rng=rng)),
        rng.normal(size=(6, 6)),
        rng.normal(size=(6, 6)).T,  # not contiguous
        n_features=int(rng.integers(3000)),
        n_matches=n,
        n_inliers=n,
        uv_inliers=rng.normal(size=(n, 2)),
        landmark_inliers=rng.integers(1 << 40, size=n),
        database="Größe",
        time_detect_s=rng.random(),
        time_match_s=rng.random(),
        time_pose_s=rng.random(),
    )


def check_same(a: NavigationResult, b: NavigationResult) -> None:
    for name in NavigationResult.__dataclass_fields__:
        mine, other = getattr(a, name), getattr(b, name)
        if name == "trs_from_cam" and mine is not None:
            mine, other = mine.as_matrix(), other.as_matrix()
        if isinstance(mine, np.ndarray):
            assert mine.dtype == other.dtype, name
            assert mine.tobytes() == other.tobytes(), name
            assert mine.shape == other.shape, name
        else:
            assert mine == other, name


def test_every_bit_of_an_answer_comes_back() -> None:
    # Pickle fails this: it normalises the rotation again, which changes every second pose.
    for seed in range(50):
        result = some_result(seed, n=seed)
        check_same(result, unpack_result(pack_result(result)))
    refusal = NavigationResult("no_pose", reason="too dark", n_features=3)
    check_same(refusal, unpack_result(pack_result(refusal)))
    nothing = NavigationResult("ok", n_matches=np.int64(3))  # pyright: ignore[reportArgumentType]
    assert unpack_result(pack_result(nothing)).n_matches == 3


def test_arrays_of_every_kind_come_back_and_may_be_written_to() -> None:
    arrays = {
        "a": np.arange(6, dtype=">i2").reshape(2, 3),
        "b": np.array(1.5),
        "c": np.empty((0, 61), np.uint8),
        "d": np.array([True, False]),
    }
    values, back = unpack(pack({"x": [1, "ä"]}, arrays))
    assert values == {"x": [1, "ä"]}
    for name, array in arrays.items():
        np.testing.assert_array_equal(back[name], array)
        assert (back[name].shape, back[name].dtype) == (array.shape, array.dtype)
    back["d"][0] = False


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_what_was_changed_or_cut_short_is_refused(data: st.DataObject) -> None:
    packed = bytearray(pack_result(some_result(1, n=3)))
    where = data.draw(st.integers(0, len(packed) - 1))
    if data.draw(st.booleans()):
        del packed[where:]
    else:
        packed[where] ^= data.draw(st.integers(1, 255))
    with pytest.raises(PackingError):
        unpack_result(bytes(packed))


def test_other_things_than_answers_are_refused() -> None:
    with pytest.raises(PackingError, match="not the answer of a core"):
        unpack_result(pack({"status": "ok"}, {}))
