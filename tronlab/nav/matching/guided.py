"""Guided matching: where the pose is roughly known, a landmark can only be in one place."""

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray
from tronlab.nav.database import Database
from tronlab.nav.features import Features
from tronlab.nav.matching.matches import Matches, Nearest
from tronlab.nav.matching.words import check_fit, places_of, words_of

if TYPE_CHECKING:
    from tronlab.nav.matching.guided_kernel import FeatureGrid

INSIDE_PROBABILITY = 0.997
"""A landmark is looked for within the ellipse where it is with this probability."""
RADIUS_PX = 6.0
"""Radius of that ellipse, were the pose known exactly: what a first pose and a detector are off."""
SIZE_FACTOR = 1.4
"""A feature may be so many times larger or smaller than its landmark should look."""
MAX_LANDMARKS = 120_000
"""Of a larger database, only views taken nearest to the camera count. With 600 views that takes a
fourth of the time and costs one to two per cent of the right matches of AKAZE, six of BRISK, but no
accuracy of the pose."""
CHANCE = 0.01
"""Landmarks so different from a feature that as many unrelated ones are more like it are none."""

_CELL_PX = 16.0
_N_PAIRS = 2000
_MARGIN = 0.1
"""How far rays beyond the image still count, as a part of its width: uncertain landmarks."""


def guided_matches(
    database: Database,
    features: Features,
    camera: CameraModel,
    trs_from_cam: RigidTransform,
    covariance: FloatArray | None = None,
    *,
    radius_px: float = RADIUS_PX,
) -> Matches:
    """Match features to the landmarks that should be seen near them.

    Args:
        database: The landmarks.
        features: Of the image.
        camera: Intrinsics.
        trs_from_cam: Where the camera is thought to be.
        covariance: Of (rotation vector, translation) in trs, shape (6, 6), rad and m; the search
            ellipse of each landmark follows from it. None: the pose is good to ``radius_px``.
        radius_px: How far from its place a landmark is looked for, were the pose known exactly.

    Returns:
        Matches; the rival of each is the nearest other landmark that should be seen there, or where
        there is none, an unrelated one.

    Raises:
        ScoreError: Features and landmarks have descriptors of different lengths.
    """
    check_fit(database, features)
    # The kernels' compiler takes half a second to import: not for whoever names this.
    from tronlab.nav.matching.guided_kernel import Prediction, search_near

    nearest = Nearest.nothing(len(features))
    if not len(features) or not len(database):
        return nearest.matches()
    # Quantile of the chi-square distribution of two degrees of freedom.
    gate = float(np.sqrt(-2.0 * np.log1p(-INSIDE_PROBABILITY)))
    low, high = _ray_limits(camera)
    prediction = Prediction(
        cam_from_trs=np.ascontiguousarray(trs_from_cam.rotation.as_matrix().T),
        eye_trs_m=np.ascontiguousarray(trs_from_cam.translation),
        covariance=np.array(np.zeros((6, 6)) if covariance is None else covariance, order="C"),
        is_uncertain=covariance is not None,
        focal_px=np.array([camera.fx_px, camera.fy_px], np.float64),
        centre_px=np.array([camera.cx_px, camera.cy_px], np.float64),
        distortion=np.array(camera.distortion, np.float64),
        nearest_ray=low,
        farthest_ray=high,
        noise_px=radius_px / gate,
        gate=gate,
        size_factor=SIZE_FACTOR,
    )
    search_near(
        prediction,
        words_of(database.descriptors),
        places_of(database),
        _views_near(database, trs_from_cam.translation),
        words_of(features.descriptors),
        _grid(features, camera),
        nearest,
    )
    unrelated = _distances_by_chance(database)
    nearest.landmark[nearest.distance > np.quantile(unrelated, CHANCE)] = -1
    return nearest.matches(stand_in=float(np.median(unrelated)))


@lru_cache(maxsize=8)
def _ray_limits(camera: CameraModel) -> tuple[FloatArray, FloatArray]:
    """Give the least and the largest (x, y) of the rays through the image, with a margin."""
    along_u = np.linspace(-0.5, camera.width_px - 0.5, 33)
    along_v = np.linspace(-0.5, camera.height_px - 0.5, 33)
    sides = [
        *(np.column_stack([along_u, np.full(33, v)]) for v in along_v[[0, -1]]),
        *(np.column_stack([np.full(33, u), along_v]) for u in along_u[[0, -1]]),
    ]
    rays = camera.rays(np.concatenate(sides))
    low, high = rays.min(axis=0), rays.max(axis=0)
    return low - _MARGIN * (high - low), high + _MARGIN * (high - low)


def _views_near(database: Database, eye_trs_m: FloatArray) -> NDArray[np.bool_]:
    """Mark the views taken nearest to a place, with ``MAX_LANDMARKS`` or a few more."""
    n_of_view = np.bincount(database.view)
    is_used = np.ones(len(n_of_view), np.bool_)
    if len(database) > MAX_LANDMARKS and len(database.p_views_trs_m) >= len(n_of_view):
        eyes = database.p_views_trs_m[: len(n_of_view)]
        nearest_first = np.argsort(np.linalg.norm(eyes - eye_trs_m, axis=1), kind="stable")
        n_nearer = np.cumsum(n_of_view[nearest_first]) - n_of_view[nearest_first]
        is_used[nearest_first[n_nearer >= MAX_LANDMARKS]] = False
    return is_used


def _grid(features: Features, camera: CameraModel) -> "FeatureGrid":
    """Sort features into cells of the image; those outside count to the nearest cell."""
    from tronlab.nav.matching.guided_kernel import FeatureGrid

    rows, columns = (int(np.ceil(side / _CELL_PX)) for side in camera.shape)
    column, row = np.floor(features.uv / _CELL_PX).astype(np.intp).T
    cell = row.clip(0, rows - 1) * columns + column.clip(0, columns - 1)
    order = np.argsort(cell, kind="stable").astype(np.int32)
    begins = np.arange(rows)[:, None] * columns + np.arange(columns + 1)
    size_px = features.size_px[order]
    return FeatureGrid(
        uv=features.uv[order],
        size_px=size_px,
        size_range_px=np.array([size_px.min(), size_px.max()]),
        feature=order,
        cell_px=_CELL_PX,
        starts=np.searchsorted(cell[order], begins).astype(np.int32),
    )


def _distances_by_chance(database: Database) -> FloatArray:
    """Give the distances between landmarks that were paired by chance."""
    rng = np.random.default_rng(_N_PAIRS)
    one, other = rng.integers(0, len(database), (2, _N_PAIRS))
    differing = np.bitwise_count(database.descriptors[one] ^ database.descriptors[other])
    return differing.sum(axis=1, dtype=np.float64)
