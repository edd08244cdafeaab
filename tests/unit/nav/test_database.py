"""Landmarks lie on the terrain, and matches find them."""

from dataclasses import replace

import numpy as np
import pytest

from tronlab.errors import ScoreError
from tronlab.nav.database import build_database, interpolate_depth
from tronlab.nav.features import AKAZE, BRISK, Detector, detect_features
from tronlab.nav.matching import LandmarkIndex

pytestmark = pytest.mark.opencv
DETECTORS = pytest.mark.parametrize("detector", [AKAZE, BRISK], ids=lambda d: d.name)


@DETECTORS
def test_landmarks_lie_on_the_surface(detector: Detector, references, camera, scene) -> None:
    database = build_database(references, camera, detector)
    assert set(database.view) == {0, 1, 2}
    x, y, z = database.p_trs_m.T
    np.testing.assert_allclose(z, scene.height_m(x, y), atol=2e-4)
    assert (database.size_m > 0).all()


def test_depth_is_interpolated_at_the_position() -> None:
    rows, columns = np.mgrid[0:6, 0:8]
    depth = (2.0 + 0.01 * columns + 0.02 * rows).astype(np.float32)
    uv = np.array([[2.25, 3.5], [0.0, 0.0], [6.9, 4.9]])
    np.testing.assert_allclose(
        interpolate_depth(depth, uv, step=0.1), 2 + 0.01 * uv[:, 0] + 0.02 * uv[:, 1], atol=1e-6
    )


def test_depth_is_not_interpolated_over_holes_edges_and_borders() -> None:
    depth = np.full((6, 8), 2.0, np.float32)
    depth[2, 3] = np.nan
    depth[:, 6:] = 2.5
    uv = np.array([[2.5, 1.5], [5.5, 1.5], [-0.1, 1.0], [7.2, 1.0], [3.0, 5.5], [1.5, 3.5]])
    found = interpolate_depth(depth, uv, step=0.01)
    np.testing.assert_array_equal(np.isfinite(found), [False, False, False, False, False, True])


def test_no_landmark_comes_from_where_depth_is_missing(references, camera) -> None:
    hole = references[1].depth_m.copy()
    hole[100:180, 120:200] = np.nan
    database = build_database([replace(references[1], depth_m=hole)], camera, AKAZE)
    p_cam = references[1].trs_from_cam.inv().apply(database.p_trs_m)
    u, v = camera.project(p_cam).T
    assert not ((u > 118) & (u < 202) & (v > 98) & (v < 182)).any()


def test_views_without_landmarks_are_an_error(references, camera) -> None:
    black = replace(references[0], image=np.zeros_like(references[0].image))
    with pytest.raises(ScoreError, match="akaze: 1 reference views give 0 landmarks, at least 50"):
        build_database([black], camera, AKAZE)
    with pytest.raises(ScoreError, match="0 reference views"):
        build_database([], camera, AKAZE)


@DETECTORS
def test_matches_are_right_and_repeat(detector: Detector, references, camera, scene, pose) -> None:
    database = build_database(references, camera, detector)
    truth = pose(1.85, x_m=0.05, tilt=(0.02, -0.03, 0.4))
    grey, depth = scene.see(truth)
    features = detect_features(np.rint(grey).astype(np.uint8), np.isfinite(depth), detector)
    first, second = (LandmarkIndex(database).match(features) for _ in range(2))
    np.testing.assert_array_equal(first.landmark, second.landmark)
    np.testing.assert_array_equal(first.ratio, second.ratio)
    assert (np.diff(first.ratio) >= 0).all()
    assert len(np.unique(first.landmark)) == len(first)
    assert len(np.unique(first.feature)) == len(first)
    expected = camera.project(truth.inv().apply(database.p_trs_m[first.landmark]))
    error_px = np.linalg.norm(features.uv[first.feature] - expected, axis=1)
    good = first.ratio < 0.5
    assert good.sum() > 50
    assert np.mean(error_px[good] < 3) > 0.98


def test_one_point_in_several_views_is_no_rival_of_itself(references, camera) -> None:
    """Every view three times: the nearest rival must still be another point."""
    once = build_database(references[:1], camera, AKAZE)
    thrice = build_database(references[:1] * 3, camera, AKAZE)
    view = references[0]
    features = detect_features(view.image, view.mask, AKAZE)
    assert len(thrice) == 3 * len(once)
    matches = LandmarkIndex(thrice).match(features)
    assert np.median(matches.ratio) < 0.1


def test_no_features_no_matches(references, camera) -> None:
    index = LandmarkIndex(build_database(references, camera, AKAZE))
    black = np.zeros(camera.shape, np.uint8)
    assert len(index.match(detect_features(black, black == 0, AKAZE))) == 0
