"""The database: landmarks found in the reference views, each with its place on the terrain."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tronlab.dataset.records import ReferenceView
from tronlab.errors import ScoreError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray
from tronlab.nav.core import CoreContext, Mask
from tronlab.nav.features import Detector, detect_features, make_detector
from tronlab.nav.settings import DetectorSettings
from tronlab.nav.sources import digest_of_stage
from tronlab.nav.stages import stage_key

MIN_LANDMARKS = 50
"""A database smaller than this cannot serve any shot."""
MAX_DEPTH_STEP_PX = 6.0
"""Largest difference of depth between neighbouring pixels, in sizes of a pixel on the terrain, over
which depth is interpolated; a larger one is an edge, and the landmark is left out."""

LANDMARK_ARRAYS = {"p_trs_m": "<f8", "size_m": "<f8", "descriptors": "u1", "view": "<i8"}
"""Names and types of the arrays with one row a landmark."""


@dataclass(frozen=True, slots=True)
class Landmarks:
    """Landmarks of one reference view."""

    p_trs_m: FloatArray
    """Shape (n, 3)."""
    size_m: FloatArray
    """Shape (n,)."""
    descriptors: NDArray[np.uint8]
    """Shape (n, b)."""

    def __len__(self) -> int:
        return len(self.p_trs_m)


@dataclass(frozen=True)
class Database:
    """Landmarks of all reference views; one physical point may appear once per view.

    The arrays may be mapped from a file and must not be written to.
    """

    p_trs_m: FloatArray
    """Shape (n, 3)."""
    size_m: FloatArray
    """Diameter of the neighbourhood on the terrain, shape (n,)."""
    descriptors: NDArray[np.uint8]
    """Shape (n, b)."""
    view: NDArray[np.int64]
    """Index of the reference view each came from, shape (n,)."""
    p_views_trs_m: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    """Where the camera of each reference view was, shape (views, 3); empty if nobody knows."""
    detector: DetectorSettings = field(default_factory=DetectorSettings)
    """How the landmarks were found."""
    pruned_by: tuple[str, ...] = ()
    """Datasets whose scores decided which landmarks stayed, by uuid: a score on one of them says
    little about other images."""
    known_digest: str = field(default="", repr=False, compare=False)
    """What ``digest`` shall give, if it is known: that of a file."""

    def __len__(self) -> int:
        return len(self.p_trs_m)

    @cached_property
    def digest(self) -> str:
        """Get what tells this database from others: it follows from its contents alone."""
        if self.known_digest:
            return self.known_digest
        digest = DatabaseDigest(self.detector)
        digest.add(self.p_trs_m, self.size_m, self.descriptors, self.view)
        return digest.of(self.p_views_trs_m)


class DatabaseDigest:
    """Digest of a database that comes in pieces, the same however it is cut."""

    def __init__(self, detector: DetectorSettings) -> None:
        self._detector = detector
        self._arrays = {name: hashlib.blake2b(digest_size=20) for name in LANDMARK_ARRAYS}

    def add(self, *arrays: NDArray[Any]) -> None:
        """Take in some landmarks: their rows of ``LANDMARK_ARRAYS``, in that order."""
        for (name, dtype), array in zip(LANDMARK_ARRAYS.items(), arrays, strict=True):
            self._arrays[name].update(np.ascontiguousarray(array, dtype).data)

    def of(self, p_views_trs_m: FloatArray) -> str:
        """Give the digest of all taken in, seen from these places, shape (views, 3)."""
        views = hashlib.blake2b(np.ascontiguousarray(p_views_trs_m, "<f8").data, digest_size=20)
        parts = {
            "detector": self._detector.model_dump(mode="json"),
            "views": views.hexdigest(),
            **{name: digest.hexdigest() for name, digest in self._arrays.items()},
        }
        text = json.dumps(parts, sort_keys=True)
        return hashlib.blake2b(text.encode(), digest_size=20).hexdigest()


def build_database(context: CoreContext, settings: DetectorSettings) -> Database:
    """Find the landmarks of a context's reference views, or give those its stage store has kept.

    Raises:
        ScoreError: There are no reference views, or too few landmarks on them.
    """
    if not context.references_key:
        return find_landmarks(context.references, context.camera, settings)
    key = stage_key(
        references=context.references_key,
        detector=settings.model_dump(mode="json"),
        opencv=cv2.__version__,
        sources=digest_of_stage("database"),
    )
    kept = context.stages.load("database", key)
    if kept is not None:
        views = np.array([view.trs_from_cam.translation for view in context.references])
        rows = kept["p_trs_m"], kept["size_m"], kept["descriptors"], kept["view"]
        return Database(*rows, views, settings)
    database = find_landmarks(context.references, context.camera, settings)
    found = {name: getattr(database, name) for name in LANDMARK_ARRAYS}
    context.stages.save("database", key, found)
    return database


def find_landmarks(
    references: Sequence[ReferenceView], camera: CameraModel, settings: DetectorSettings
) -> Database:
    """Find the landmarks of every reference view.

    Raises:
        ScoreError: There are no reference views, or too few landmarks on them.
    """
    detector = make_detector(settings)
    parts = [landmarks_of_view(view, camera, detector) for view in references]
    check_enough(settings, n_views=len(parts), n_landmarks=sum(map(len, parts)))
    return Database(
        np.concatenate([part.p_trs_m for part in parts]),
        np.concatenate([part.size_m for part in parts]),
        np.concatenate([part.descriptors for part in parts if len(part)]),
        np.repeat(np.arange(len(parts)), [len(part) for part in parts]),
        np.array([view.trs_from_cam.translation for view in references]),
        settings,
    )


def check_enough(settings: DetectorSettings, *, n_views: int, n_landmarks: int) -> None:
    """Refuse a database that cannot serve any shot.

    Raises:
        ScoreError: It has too few landmarks.
    """
    if n_landmarks < MIN_LANDMARKS:
        raise ScoreError(
            f"{settings.features}: {n_views} reference views give {n_landmarks} landmarks,"
            f" at least {MIN_LANDMARKS} needed; check that the campaign names database poses and"
            " that the reference images show lit terrain"
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


def landmarks_of_view(view: ReferenceView, camera: CameraModel, detector: Detector) -> Landmarks:
    """Find the landmarks of one reference view: its features whose depth is known."""
    is_usable: Mask = view.mask & np.isfinite(view.depth_m)
    features = detect_features(view.image, is_usable, detector)
    depth_m = interpolate_depth(
        view.depth_m, features.uv, step=MAX_DEPTH_STEP_PX / max(camera.fx_px, camera.fy_px)
    )
    good = np.flatnonzero(np.isfinite(depth_m))
    rays = camera.rays(features.uv[good])
    p_cam = np.column_stack([rays, np.ones(len(good))]) * depth_m[good, None]
    return Landmarks(
        view.trs_from_cam.apply(p_cam) if len(good) else np.empty((0, 3)),
        features.size_px[good] * depth_m[good] / camera.fx_px,
        features.descriptors[good],
    )
