"""The database: landmarks found in the reference views, each with its place on the terrain."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tronlab.dataset.records import ReferenceView
from tronlab.errors import ScoreError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray
from tronlab.nav.features import Detector, Features, Mask, detect_features

MIN_LANDMARKS = 50
"""A database smaller than this cannot serve any shot."""
MAX_DEPTH_STEP_PX = 6.0
"""Largest difference of depth between neighbouring pixels, in sizes of a pixel on the terrain, over
which depth is interpolated; a larger one is an edge, and the landmark is left out."""


@dataclass(frozen=True, slots=True)
class Database:
    """Landmarks of all reference views; one physical point may appear once per view."""

    p_trs_m: FloatArray
    """Shape (n, 3)."""
    size_m: FloatArray
    """Diameter of the neighbourhood on the terrain, shape (n,)."""
    descriptors: NDArray[np.uint8]
    """Shape (n, b)."""
    view: NDArray[np.int64]
    """Index of the reference view each came from, shape (n,)."""

    def __len__(self) -> int:
        return len(self.p_trs_m)


def build_database(
    references: Sequence[ReferenceView], camera: CameraModel, detector: Detector
) -> Database:
    """Find the landmarks of every reference view.

    Raises:
        ScoreError: There are no reference views, or too few landmarks on them.
    """
    parts = [_landmarks(view, i, camera, detector) for i, view in enumerate(references)]
    n_landmarks = sum(len(part) for part in parts)
    if n_landmarks < MIN_LANDMARKS:
        raise ScoreError(
            f"{detector.name}: {len(references)} reference views give {n_landmarks} landmarks,"
            f" at least {MIN_LANDMARKS} needed; check that the campaign names database poses and"
            " that the reference images show lit terrain"
        )
    parts = [part for part in parts if len(part)]
    return Database(
        np.concatenate([part.p_trs_m for part in parts]),
        np.concatenate([part.size_m for part in parts]),
        np.concatenate([part.descriptors for part in parts]),
        np.concatenate([part.view for part in parts]),
    )


def interpolate_depth(depth_m: NDArray[np.float32], uv: FloatArray, *, step: float) -> FloatArray:
    """Interpolate depth between the four pixels around each position.

    Args:
        depth_m: Depth at the pixel centres, NaN where there is none.
        uv: Image positions, shape (n, 2), pixels.
        step: Largest difference between the four, as a fraction of the depth.

    Returns:
        Depth, shape (n,), metres; NaN where one of the four is missing or they differ by more.
    """
    rows, columns = depth_m.shape
    corner = np.floor(uv).astype(np.intp)
    is_inside = np.all((corner >= 0) & (corner < [columns - 1, rows - 1]), axis=1)
    u, v = (np.where(is_inside, corner[:, axis], 0) for axis in (0, 1))
    below, right = v + 1, u + 1
    fu, fv = (uv - corner).T
    four = np.stack([depth_m[v, u], depth_m[v, right], depth_m[below, u], depth_m[below, right]])
    four = four.astype(np.float64)
    weights = np.stack([(1 - fu) * (1 - fv), fu * (1 - fv), (1 - fu) * fv, fu * fv])
    depth = (weights * four).sum(axis=0)
    is_smooth = four.max(axis=0) - four.min(axis=0) <= step * depth
    return np.where(is_inside & is_smooth, depth, np.nan)


def _landmarks(
    view: ReferenceView, index: int, camera: CameraModel, detector: Detector
) -> Database:
    is_usable: Mask = view.mask & np.isfinite(view.depth_m)
    features = detect_features(view.image, is_usable, detector)
    depth_m = interpolate_depth(
        view.depth_m, features.uv, step=MAX_DEPTH_STEP_PX / max(camera.fx_px, camera.fy_px)
    )
    good = np.flatnonzero(np.isfinite(depth_m))
    return _place(features, good, depth_m[good], view=view, index=index, camera=camera)


def _place(
    features: Features,
    good: NDArray[np.intp],
    depth_m: FloatArray,
    *,
    view: ReferenceView,
    index: int,
    camera: CameraModel,
) -> Database:
    rays = camera.rays(features.uv[good])
    p_cam = np.column_stack([rays, np.ones(len(rays))]) * depth_m[:, None]
    return Database(
        view.trs_from_cam.apply(p_cam) if len(good) else np.empty((0, 3)),
        features.size_px[good] * depth_m / camera.fx_px,
        features.descriptors[good],
        np.full(len(good), index),
    )
