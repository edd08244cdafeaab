"""Searches against brute force and against what theory says of hashing."""

import cv2
import numpy as np
import pytest
from dict_store import DictStore

from tronlab.errors import ScoreError
from tronlab.nav.database import Database, find_landmarks
from tronlab.nav.features import Features, detect_features, make_detector
from tronlab.nav.matching import Matches, hashing, open_matcher
from tronlab.nav.matching.bits import choose_bits
from tronlab.nav.matching.words import words_of
from tronlab.nav.settings import DetectorSettings, MatchingSettings
from tronlab.nav.stages import NOTHING_KEPT

METHODS = ("flann", "exact", "hashing")
N_BYTES = 61


def match(method: str, database: Database, features: Features) -> Matches:
    settings = MatchingSettings.model_validate({"method": method})
    return open_matcher(settings, database, NOTHING_KEPT).match(features)


def random_bits(rng: np.random.Generator, n: int, n_bytes: int = N_BYTES) -> np.ndarray:
    return rng.integers(0, 256, (n, n_bytes), dtype=np.uint8)


def flipped(rng: np.random.Generator, bits: np.ndarray, share: float) -> np.ndarray:
    flips = rng.random((len(bits), 8 * bits.shape[1])) < share
    return bits ^ np.packbits(flips, axis=1)


def database_of(descriptors: np.ndarray, *, n_copies: int = 1, seed: int = 0) -> Database:
    """Give landmarks 5 mm large on a square metre, each point seen from ``n_copies`` views."""
    rng = np.random.default_rng(seed)
    n_points = len(descriptors) // n_copies
    points = np.tile(rng.random((n_points, 3)), (n_copies, 1))
    view = np.repeat(np.arange(n_copies), n_points)
    return Database(points, np.full(len(points), 0.005), descriptors, view)


def features_of(descriptors: np.ndarray) -> Features:
    n = len(descriptors)
    return Features(np.zeros((n, 2)), np.full(n, 6.0), descriptors)


@pytest.mark.parametrize("n_bytes", [61, 64, 32, 5])
def test_exact_search_finds_what_opencv_and_the_definition_of_a_rival_say(n_bytes: int) -> None:
    rng = np.random.default_rng(1)
    points = random_bits(rng, 200, n_bytes)
    database = database_of(np.concatenate([points, flipped(rng, points, 0.1)]), n_copies=2)
    features = features_of(flipped(rng, points[:40], 0.15))
    matches = match("exact", database, features)
    expected = cv2.BFMatcher(cv2.NORM_HAMMING).match(features.descriptors, database.descriptors)
    distance = {m.queryIdx: m.distance for m in expected}
    assert [distance[j] for j in matches.feature] == matches.distance.tolist()
    for j, landmark, d, ratio in zip(
        matches.feature, matches.landmark, matches.distance, matches.ratio, strict=True
    ):
        apart = np.linalg.norm(database.p_trs_m - database.p_trs_m[landmark], axis=1) > 0.005
        differing = np.bitwise_count(database.descriptors ^ features.descriptors[j]).sum(axis=1)
        assert ratio == pytest.approx(d / max(differing[apart].min(), 1))


def test_hashing_finds_as_many_as_its_keys_collide() -> None:
    """Bits that flip independently: a table's keys agree but for one bit with a known chance."""
    share, n, n_bits, n_tables = 0.3, 4096, 12, hashing.N_TABLES
    rng = np.random.default_rng(2)
    descriptors = random_bits(rng, n)
    queries = flipped(rng, descriptors[:1500], share)
    matches = match("hashing", database_of(descriptors), features_of(queries))
    kept = 1 - share
    in_table = kept**n_bits + n_bits * share * kept ** (n_bits - 1)
    expected = 1 - (1 - in_table) ** n_tables
    found = np.mean(np.isin(np.arange(1500), matches.feature[matches.feature == matches.landmark]))
    assert found == pytest.approx(expected, abs=4 * np.sqrt(expected * (1 - expected) / 1500))


def test_bits_are_even_and_independent() -> None:
    rng = np.random.default_rng(3)
    bits = rng.random((3000, 256)) < np.where(np.arange(256) < 64, 0.98, 0.5)
    bits[:, 128:192] = bits[:, 64:128] ^ (rng.random((3000, 64)) < 0.05)
    descriptors = np.packbits(bits, axis=1, bitorder="little")
    chosen = choose_bits(descriptors, n_tables=8, n_bits=12, seed=0)
    assert chosen.min() >= 64
    assert len(np.unique(chosen)) >= chosen.size - 8
    for table in chosen:
        copied = table[(table >= 128) & (table < 192)] - 64
        assert not np.isin(copied, table).any()


@pytest.mark.parametrize("method", METHODS)
def test_no_features_a_wrong_kind_and_identical_landmarks(method: str) -> None:
    database = database_of(np.zeros((3000, N_BYTES), np.uint8))
    assert len(match(method, database, features_of(np.empty((0, N_BYTES), np.uint8)))) == 0
    with pytest.raises(ScoreError, match="descriptors of 64 bytes, those of the database have 61"):
        match(method, database, features_of(np.zeros((2, 64), np.uint8)))
    matches = match(method, database, features_of(np.zeros((2, N_BYTES), np.uint8)))
    assert len(matches) <= 1
    assert (matches.ratio == 0).all()


def test_descriptors_of_a_mapped_file_are_not_copied(tmp_path) -> None:
    descriptors = random_bits(np.random.default_rng(4), 1000)
    descriptors.tofile(tmp_path / "bits")
    mapped = np.memmap(tmp_path / "bits", np.uint8, "r", shape=descriptors.shape)
    assert words_of(mapped).address == mapped.ctypes.data
    features = features_of(descriptors[::7])
    for method in ("exact", "hashing"):
        matches = match(method, database_of(mapped), features)
        np.testing.assert_array_equal(matches.landmark, 7 * matches.feature)
        assert len(matches) == len(features)


def test_tables_of_a_large_database_are_kept(monkeypatch) -> None:
    monkeypatch.setattr(hashing, "MIN_KEPT", 1000)
    store, settings = DictStore(), MatchingSettings(method="hashing")
    databases = [database_of(random_bits(np.random.default_rng(s), 1000)) for s in (6, 6, 7)]
    features = features_of(databases[0].descriptors[:50])
    first, again, other = (open_matcher(settings, d, store).match(features) for d in databases)
    assert len(store.kept) == 2
    np.testing.assert_array_equal(first.landmark, again.landmark)
    assert not np.array_equal(first.landmark, other.landmark)


@pytest.mark.opencv
@pytest.mark.parametrize("detector", ["akaze", "brisk"])
def test_matches_of_a_scene_are_right_and_repeat(detector, references, camera, scene, pose) -> None:
    settings = DetectorSettings.model_validate({"features": detector})
    database = find_landmarks(references, camera, settings)
    truth = pose(1.85, x_m=0.05, tilt=(0.02, -0.03, 0.4))
    grey, depth = scene.see(truth)
    image, mask = np.rint(grey).astype(np.uint8), np.isfinite(depth)
    features = detect_features(image, mask, make_detector(settings))
    uv = camera.project(truth.inv().apply(database.p_trs_m))
    right: dict[str, set[int]] = {}
    for method in METHODS:
        first, second = (match(method, database, features) for _ in range(2))
        np.testing.assert_array_equal(first.landmark, second.landmark)
        np.testing.assert_array_equal(first.ratio, second.ratio)
        assert (np.diff(first.ratio) >= 0).all()
        assert len(np.unique(first.landmark)) == len(first) == len(np.unique(first.feature))
        error_px = np.linalg.norm(features.uv[first.feature] - uv[first.landmark], axis=1)
        good = first.ratio < 0.5
        assert good.sum() > 50
        assert np.mean(error_px[good] < 3) > 0.98
        right[method] = set(first.feature[error_px < 3].tolist())
    assert len(right["hashing"] & right["exact"]) > 0.95 * len(right["exact"])


@pytest.mark.opencv
@pytest.mark.parametrize("method", METHODS)
def test_one_point_in_several_views_is_no_rival_of_itself(method, references, camera) -> None:
    view = references[0]
    settings = DetectorSettings()
    features = detect_features(view.image, view.mask, make_detector(settings))
    thrice = find_landmarks([view] * 3, camera, settings)
    assert np.median(match(method, thrice, features).ratio) < 0.1
