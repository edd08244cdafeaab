"""The built-in cores on a synthetic scene, and how cores are found by name."""

from dataclasses import replace
from importlib.metadata import EntryPoint, version

import numpy as np
import pytest
from dict_store import DictStore

from tronlab.errors import ConfigError, ScoreError, TronlabError
from tronlab.geometry.uncertainty import pose_difference
from tronlab.nav import installed, localisation, sightings
from tronlab.nav.core import CoreContext, Frame, NavigationCore, PosePrior
from tronlab.nav.cores import BUILT_IN_CORES, built_in_identity, is_built_in, make_core
from tronlab.nav.installed import known_cores
from tronlab.nav.matching.guided_kernel import search_near
from tronlab.nav.matching.hashing_kernel import look_up
from tronlab.nav.specs import CoreSpec, parse_core

pytestmark = pytest.mark.opencv


@pytest.fixture(scope="module")
def context(camera, references) -> CoreContext:
    return CoreContext(camera, references)


def shot(scene, truth, rng: np.random.Generator) -> Frame:
    grey, depth = scene.see(truth)
    noisy = np.clip(grey + rng.normal(0, 2, grey.shape), 0, 255)
    return Frame(np.rint(noisy).astype(np.uint8), np.isfinite(depth))


def built_in(name: str, context: CoreContext, **settings: object) -> NavigationCore:
    return make_core(CoreSpec(name, "installed", name, settings), context)


@pytest.mark.parametrize("name", BUILT_IN_CORES)
def test_core_finds_the_pose(name: str, context, scene, pose, rng) -> None:
    core: NavigationCore = built_in(name, context)
    assert core.name == name
    limit_m, limit_rad = (0.004, 0.003) if name.endswith("refined") else (0.05, 0.03)
    for z_m, tilt in ((2.2, (0.02, 0.0, 0.1)), (1.8, (-0.03, 0.05, -0.5))):
        truth = pose(z_m, x_m=0.06, y_m=-0.05, tilt=tilt)
        result = core.locate(shot(scene, truth, rng))
        assert result.status == "ok", result.reason
        assert result.trs_from_cam is not None
        difference = pose_difference(result.trs_from_cam, truth)
        assert np.linalg.norm(difference[3:]) < limit_m
        assert np.linalg.norm(difference[:3]) < limit_rad
        assert len(result.uv_inliers) == result.n_inliers <= result.n_matches <= result.n_features
        assert min(result.time_detect_s, result.time_match_s, result.time_pose_s) > 0
        assert len(result.landmark_inliers) == result.n_inliers
        assert (result.covariance is not None) == name.endswith("refined")
        assert result.bound is not None


def test_12_bit_image_gives_the_pose_of_the_8_bit_one(context, scene, pose) -> None:
    truth = pose(2.0, x_m=0.03)
    core = built_in("akaze-refined", context)
    frame = shot(scene, truth, np.random.default_rng(1))
    a = core.locate(frame)
    b = core.locate(replace(frame, image=frame.image.astype(np.uint16) * 16))
    assert a.trs_from_cam is not None
    assert b.trs_from_cam is not None
    assert np.abs(pose_difference(a.trs_from_cam, b.trs_from_cam)).max() < 1e-3


def test_image_of_nothing_is_no_pose_with_a_reason(context, camera) -> None:
    black = np.zeros(camera.shape, np.uint8)
    for name in BUILT_IN_CORES:
        for mask in (np.ones(camera.shape, np.bool_), np.zeros(camera.shape, np.bool_)):
            result = built_in(name, context).locate(Frame(black, mask))
            assert result.status == "no_pose"
            assert result.trs_from_cam is None
            assert "0 matches, at least 6 needed" in result.reason


def test_another_terrain_is_no_pose_of_the_refined_cores(context, scene, pose, rng) -> None:
    other = type(scene)(seed=99)
    frame = shot(other, pose(2.0), rng)
    for name in ("akaze-refined", "brisk-refined"):
        assert built_in(name, context).locate(frame).status == "no_pose"


def test_cores_of_one_detector_share_its_work(camera, references, scene, pose, rng, monkeypatch):
    seen: list[int] = []
    detect = sightings.detect_features
    monkeypatch.setattr(sightings, "detect_features", lambda *a: seen.append(1) or detect(*a))
    context = CoreContext(camera, references)
    plain, refined = built_in("akaze", context), built_in("akaze-refined", context)
    frame = shot(scene, pose(2.1), rng)
    first, second = plain.locate(frame), refined.locate(frame)
    assert len(seen) == 1
    assert first.time_detect_s == second.time_detect_s
    frame.image[:] = 0
    assert plain.locate(frame).status == "no_pose"
    assert len(seen) == 2


def test_a_prior_leads_to_the_same_pose_and_a_wrong_one_does_no_harm(
    context, scene, pose, rng
) -> None:
    truth = pose(2.1, x_m=0.05)
    frame = shot(scene, truth, rng)
    covariance = np.diag([1e-3] * 3 + [0.02] * 3) ** 2
    core = built_in("akaze-refined", context)
    for prior in (pose(2.11, x_m=0.06), pose(2.6, x_m=-0.3)):
        result = core.locate(replace(frame, prior=PosePrior(prior, covariance)))
        assert result.status == "ok", result.reason
        assert np.linalg.norm(pose_difference(result.trs_from_cam, truth)[3:]) < 0.004


@pytest.mark.parametrize(
    ("robust", "solver"), [("ransac", "epnp"), ("usac", "sqpnp"), ("poselib", "sqpnp")]
)
def test_every_estimator_serves_a_core(robust: str, solver: str, context, scene, pose, rng) -> None:
    truth = pose(2.1, x_m=0.05)
    core = built_in("akaze-refined", context, pose={"robust": robust, "solver": solver})
    result = core.locate(shot(scene, truth, rng))
    assert result.status == "ok", result.reason
    assert np.linalg.norm(pose_difference(result.trs_from_cam, truth)[3:]) < 0.004


@pytest.mark.parametrize(("n_first", "n_searches"), [(60, 1), (5, 2)])
def test_all_features_are_sought_anywhere_only_if_the_first_give_no_pose(
    n_first: int, n_searches: int, camera, references, scene, pose, rng, monkeypatch
) -> None:
    truth = pose(2.1, x_m=0.05)
    frame, store = shot(scene, truth, rng), DictStore()
    monkeypatch.setattr(localisation, "FIRST_FEATURES", n_first)
    core = built_in("akaze-refined", CoreContext(camera, references, stages=store))
    result = core.locate(frame)
    assert result.status == "ok", result.reason
    assert np.linalg.norm(pose_difference(result.trs_from_cam, truth)[3:]) < 0.004
    searches = [arrays for (stage, _), arrays in store.kept.items() if stage == "matches"]
    assert len(searches) == n_searches
    assert searches[0]["feature"].max() < n_first
    # All features take part in the pose, whatever the first ones were enough for.
    assert n_first < result.n_inliers <= result.n_matches


def test_a_pose_as_good_as_a_wrong_one_is_refused(context, scene, pose, rng, monkeypatch) -> None:
    """Turned by nothing, the wrong pose is the right one."""
    monkeypatch.setattr(localisation, "CONTROL_PX", 0.0)
    for n_counted in (10, 10_000):
        monkeypatch.setattr(localisation, "CONTROL_MATCHES", n_counted)
        result = built_in("akaze-refined", context).locate(shot(scene, pose(2.1), rng))
        assert result.status == "no_pose"
        assert "agree with the pose" in result.reason


def test_kernels_are_there_before_the_first_image(context, scene, pose, rng) -> None:
    core = built_in("akaze-refined", context)
    compiled = [len(kernel.signatures) for kernel in (look_up, search_near)]
    frame = shot(scene, pose(2.1), rng)
    prior = PosePrior(pose(2.1), np.asfortranarray(np.diag([1e-3] * 3 + [0.02] * 3) ** 2))
    assert core.locate(frame).status == core.locate(replace(frame, prior=prior)).status == "ok"
    assert compiled == [len(kernel.signatures) for kernel in (look_up, search_near)] == [1, 1]


def test_a_wrong_setting_says_what_is_known(context) -> None:
    with pytest.raises(ConfigError, match=r"akaze-refined\.pose\.gate: .*did you mean gate_px"):
        built_in("akaze-refined", context, pose={"gate": 3.0})


def test_identity_follows_settings_that_name_a_file_and_the_code() -> None:
    spec = parse_core("akaze-refined")
    assert built_in_identity(spec) == built_in_identity(replace(spec, name="other"))
    poselib = replace(spec, settings={"pose": {"robust": "poselib"}})
    assert f"poselib {version('poselib')}" in built_in_identity(poselib)
    assert "poselib" not in built_in_identity(spec)
    missing = replace(spec, settings={"database": "missing.h5"})
    with pytest.raises(TronlabError, match=r"missing\.h5"):
        built_in_identity(missing)


def test_unknown_core_lists_the_known_ones(context) -> None:
    with pytest.raises(ScoreError, match=r"no navigation core 'sift'; known cores:.*akaze.*brisk"):
        built_in("sift", context)
    with pytest.raises(ScoreError, match="did you mean akaze-refined"):
        built_in("akaze-refned", context)


def test_built_in_cores_are_entry_points() -> None:
    assert set(BUILT_IN_CORES) <= set(known_cores())


def test_a_plug_in_is_found_and_is_not_ours(context, monkeypatch) -> None:
    point = EntryPoint("mine", "tronlab.nav.cores:akaze", installed.ENTRY_POINT_GROUP)
    monkeypatch.setattr(installed, "entry_points", lambda group: (point,))
    assert built_in("mine", context).name == "akaze"
    assert not is_built_in(parse_core("mine"))
