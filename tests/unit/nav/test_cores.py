"""The built-in cores on a synthetic scene, and how cores are found by name."""

from importlib.metadata import EntryPoint

import numpy as np
import pytest

from tronlab.errors import ScoreError
from tronlab.geometry.uncertainty import pose_difference
from tronlab.nav import cores
from tronlab.nav.core import CoreContext, NavigationCore
from tronlab.nav.cores import BUILT_IN_CORES, known_cores, make_core

pytestmark = pytest.mark.opencv


@pytest.fixture(scope="module")
def context(camera, references) -> CoreContext:
    return CoreContext(camera, references)


def shot(scene, truth, rng: np.random.Generator, *, dtype=np.uint8, gain: float = 1.0):
    grey, depth = scene.see(truth)
    noisy = np.clip(grey + rng.normal(0, 2, grey.shape), 0, 255) * gain
    return np.rint(noisy).astype(dtype), np.isfinite(depth)


@pytest.mark.parametrize("name", BUILT_IN_CORES)
def test_core_finds_the_pose(name: str, context, scene, pose, rng) -> None:
    core: NavigationCore = make_core(name, context)
    assert core.name == name
    limit_m, limit_rad = (0.004, 0.003) if name.endswith("refined") else (0.05, 0.03)
    for z_m, tilt in ((2.2, (0.02, 0.0, 0.1)), (1.8, (-0.03, 0.05, -0.5))):
        truth = pose(z_m, x_m=0.06, y_m=-0.05, tilt=tilt)
        result = core.locate(*shot(scene, truth, rng))
        assert result.status == "ok", result.reason
        assert result.trs_from_cam is not None
        difference = pose_difference(result.trs_from_cam, truth)
        assert np.linalg.norm(difference[3:]) < limit_m
        assert np.linalg.norm(difference[:3]) < limit_rad
        assert len(result.uv_inliers) == result.n_inliers <= result.n_matches <= result.n_features
        assert min(result.time_detect_s, result.time_match_s, result.time_pose_s) > 0
        assert (result.covariance is not None) == name.endswith("refined")


def test_12_bit_image_gives_the_pose_of_the_8_bit_one(context, scene, pose) -> None:
    truth = pose(2.0, x_m=0.03)
    core = make_core("akaze-refined", context)
    image, mask = shot(scene, truth, np.random.default_rng(1))
    a = core.locate(image, mask)
    b = core.locate(image.astype(np.uint16) * 16, mask)
    assert a.trs_from_cam is not None
    assert b.trs_from_cam is not None
    assert np.abs(pose_difference(a.trs_from_cam, b.trs_from_cam)).max() < 1e-3


def test_image_of_nothing_is_no_pose_with_a_reason(context, camera) -> None:
    black = np.zeros(camera.shape, np.uint8)
    for name in BUILT_IN_CORES:
        for mask in (np.ones(camera.shape, np.bool_), np.zeros(camera.shape, np.bool_)):
            result = make_core(name, context).locate(black, mask)
            assert result.status == "no_pose"
            assert result.trs_from_cam is None
            assert "0 matches, at least 6 needed" in result.reason


def test_another_terrain_is_no_pose_of_the_refined_cores(context, scene, pose, rng) -> None:
    other = type(scene)(seed=99)
    image, mask = shot(other, pose(2.0), rng)
    for name in ("akaze-refined", "brisk-refined"):
        assert make_core(name, context).locate(image, mask).status == "no_pose"


def test_cores_of_one_detector_share_its_work(camera, references, scene, pose, rng, monkeypatch):
    seen: list[int] = []
    detect = cores.detect_features
    monkeypatch.setattr(cores, "detect_features", lambda *a: seen.append(1) or detect(*a))
    context = CoreContext(camera, references)
    plain, refined = make_core("akaze", context), make_core("akaze-refined", context)
    image, mask = shot(scene, pose(2.1), rng)
    first, second = plain.locate(image, mask), refined.locate(image, mask)
    assert len(seen) == 1
    assert first.time_detect_s == second.time_detect_s
    image[:] = 0
    assert plain.locate(image, mask).status == "no_pose"
    assert len(seen) == 2


def test_unknown_core_lists_the_known_ones(context) -> None:
    with pytest.raises(ScoreError, match=r"no navigation core 'sift'; known cores:.*akaze.*brisk"):
        make_core("sift", context)


def test_built_in_cores_are_entry_points() -> None:
    assert set(BUILT_IN_CORES) <= set(known_cores())


def test_a_plug_in_is_found(context, monkeypatch) -> None:
    point = EntryPoint("mine", "tronlab.nav.cores:akaze", cores.ENTRY_POINT_GROUP)
    monkeypatch.setattr(cores, "entry_points", lambda group: (point,))
    assert make_core("mine", context).name == "akaze"
