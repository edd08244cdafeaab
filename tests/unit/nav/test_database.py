"""Landmarks lie on the terrain, and a database has one digest however it is made."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tronlab.errors import ScoreError
from tronlab.nav.core import CoreContext
from tronlab.nav.database import (
    Database,
    DatabaseDigest,
    build_database,
    find_landmarks,
    interpolate_depth,
)
from tronlab.nav.settings import DetectorSettings

AKAZE = DetectorSettings(n_max=300)
BRISK = DetectorSettings(features="brisk", n_max=300)


class DictStore:
    """Keeps everything, and counts what was asked for in vain."""

    def __init__(self) -> None:
        self.kept: dict[tuple[str, str], dict[str, NDArray[Any]]] = {}
        self.n_missed = 0

    def load(self, stage: str, key: str) -> dict[str, NDArray[Any]] | None:
        self.n_missed += (stage, key) not in self.kept
        return self.kept.get((stage, key))

    def save(self, stage: str, key: str, arrays: Mapping[str, NDArray[Any]]) -> None:
        self.kept[stage, key] = {name: array.copy() for name, array in arrays.items()}


@pytest.mark.opencv
@pytest.mark.parametrize("settings", [AKAZE, BRISK], ids=lambda s: s.features)
def test_landmarks_lie_on_the_surface(settings, references, camera, scene) -> None:
    database = find_landmarks(references, camera, settings)
    assert set(database.view) == {0, 1, 2}
    assert (np.bincount(database.view) <= 300).all()
    x, y, z = database.p_trs_m.T
    np.testing.assert_allclose(z, scene.height_m(x, y), atol=2e-4)
    assert (database.size_m > 0).all()
    np.testing.assert_array_equal(database.p_views_trs_m[:, 2], [2.4, 2.0, 1.7])


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


@pytest.mark.opencv
def test_no_landmark_comes_from_where_depth_is_missing(references, camera) -> None:
    hole = references[1].depth_m.copy()
    hole[100:180, 120:200] = np.nan
    database = find_landmarks([replace(references[1], depth_m=hole)], camera, AKAZE)
    p_cam = references[1].trs_from_cam.inv().apply(database.p_trs_m)
    u, v = camera.project(p_cam).T
    assert not ((u > 118) & (u < 202) & (v > 98) & (v < 182)).any()


@pytest.mark.opencv
def test_views_without_landmarks_are_an_error(references, camera) -> None:
    black = replace(references[0], image=np.zeros_like(references[0].image))
    with pytest.raises(ScoreError, match="akaze: 1 reference views give 0 landmarks, at least 50"):
        find_landmarks([black], camera, AKAZE)
    with pytest.raises(ScoreError, match="0 reference views"):
        find_landmarks([], camera, AKAZE)


@pytest.mark.opencv
def test_kept_landmarks_are_those_found_and_belong_to_views_and_settings(
    references, camera
) -> None:
    store = DictStore()
    context = CoreContext(camera, references[:2], stages=store, references_key="two views")
    found, kept = (build_database(context, AKAZE) for _ in range(2))
    assert store.n_missed == 1
    assert kept.digest == found.digest == find_landmarks(references[:2], camera, AKAZE).digest
    others = [build_database(replace(context, references_key="others"), AKAZE)]
    others.append(build_database(context, AKAZE.model_copy(update={"n_max": 200})))
    assert store.n_missed == 3
    assert others[0].digest == found.digest
    assert others[1].digest != found.digest
    build_database(replace(context, references_key=""), AKAZE)
    assert store.n_missed == 3, "what has no name is not kept"


def test_a_digest_does_not_depend_on_pieces_but_on_every_value() -> None:
    rng = np.random.default_rng(2)
    rows = (
        rng.normal(size=(70, 3)),
        rng.random(70),
        rng.integers(0, 256, (70, 61), np.uint8),
        np.arange(70) // 7,
    )
    views = rng.normal(size=(10, 3))
    whole = Database(*rows, views, AKAZE)
    digest = DatabaseDigest(AKAZE)
    for piece in np.array_split(np.arange(70), 4):
        digest.add(*(array[piece] for array in rows))
    assert digest.of(views) == whole.digest
    for changed in range(4):
        other = [array.copy() for array in rows]
        other[changed].flat[-1] += 1
        assert Database(*other, views, AKAZE).digest != whole.digest
    assert Database(*rows, views, BRISK).digest != whole.digest
    assert Database(*rows, views + 1e-9, AKAZE).digest != whole.digest
