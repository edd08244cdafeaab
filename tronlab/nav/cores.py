"""The built-in navigation cores, and the way from a core's name to a core.

``akaze`` and ``brisk`` are the paper's estimator (section 2.3): the best matches through EPnP, none
of them questioned by geometry. Best is the least ambiguous here, not the smallest difference of
descriptors: docs/decisions/0006 says why. ``akaze-refined`` and ``brisk-refined`` take them through
RANSAC, and all that agree through robust least squares. Cores with the same detector share its
work: database, features, matches.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from time import perf_counter
from typing import TypeAlias

import numpy as np

from tronlab.errors import ScoreError
from tronlab.geometry.camera import CameraModel
from tronlab.nav.core import CoreContext, NavigationCore, NavigationResult
from tronlab.nav.database import Database, build_database
from tronlab.nav.features import AKAZE, BRISK, Detector, Features, GreyImage, Mask, detect_features
from tronlab.nav.matching import LandmarkIndex, Matches
from tronlab.nav.pose import Correspondences, NoPoseError, refine_pose, solve_epnp, solve_ransac

ENTRY_POINT_GROUP = "tronlab.navigation_cores"
BUILT_IN_CORES = ("akaze", "brisk", "akaze-refined", "brisk-refined")

TRUSTED_SIZE_PX = 30.0
"""Largest feature the paper's estimator trusts."""
RANSAC_MAX_RATIO = 0.8
N_RANSAC = 500
RANSAC_TOLERANCE_PX = 4.0
GATE_PX = 6.0


@dataclass(frozen=True, slots=True)
class Sighting:
    """What one image shows of the database."""

    features: Features
    matches: Matches
    time_detect_s: float
    time_match_s: float


class LandmarkFinder:
    """Database, features and matches of one detector; remembers the last image it saw."""

    def __init__(self, detector: Detector, context: CoreContext) -> None:
        self.camera: CameraModel = context.camera
        self.database: Database = build_database(context.references, context.camera, detector)
        self.detector: Detector = detector
        self._index = LandmarkIndex(self.database)
        self._last: tuple[bytes, Sighting] | None = None

    def sight(self, image: GreyImage, mask: Mask) -> Sighting:
        """Find and match the features of an image, once for an image and mask."""
        key = _fingerprint(image, mask)
        if self._last is None or self._last[0] != key:
            self._last = key, self._sight(image, mask)
        return self._last[1]

    def correspondences(self, sighting: Sighting, matches: Matches) -> Correspondences:
        """Give image positions and points of some of the matches of a sighting."""
        uv = sighting.features.uv[matches.feature]
        size_px = sighting.features.size_px[matches.feature]
        return Correspondences(
            uv,
            self.camera.rays(uv),
            self.database.p_trs_m[matches.landmark],
            size_px / sighting.features.size_px.min(initial=np.inf),
        )

    def _sight(self, image: GreyImage, mask: Mask) -> Sighting:
        start_s = perf_counter()
        features = detect_features(image, mask, self.detector)
        detected_s = perf_counter()
        matches = self._index.match(features)
        return Sighting(features, matches, detected_s - start_s, perf_counter() - detected_s)


Estimator: TypeAlias = Callable[[LandmarkFinder, Sighting], NavigationResult]


class FeatureCore:
    """A navigation core of one detector and one estimator."""

    def __init__(self, name: str, finder: LandmarkFinder, estimator: Estimator) -> None:
        self._name = name
        self._finder = finder
        self._estimator = estimator

    @property
    def name(self) -> str:
        """Get the name the scores carry."""
        return self._name

    def locate(self, image: GreyImage, mask: Mask) -> NavigationResult:
        """Find ``trs_from_cam`` of one image; see ``NavigationCore``."""
        sighting = self._finder.sight(image, mask)
        start_s = perf_counter()
        try:
            answer = self._estimator(self._finder, sighting)
        except NoPoseError as error:
            answer = NavigationResult("no_pose", reason=str(error))
        return NavigationResult(
            answer.status,
            answer.trs_from_cam,
            answer.covariance,
            n_features=len(sighting.features),
            n_matches=len(sighting.matches),
            n_inliers=len(answer.uv_inliers),
            uv_inliers=answer.uv_inliers,
            time_detect_s=sighting.time_detect_s,
            time_match_s=sighting.time_match_s,
            time_pose_s=perf_counter() - start_s,
            reason=answer.reason,
        )


def best_matches(sighting: Sighting, *, max_ratio: float) -> Matches:
    """Give the least ambiguous matches: very similar to one landmark, and to no other."""
    matches = sighting.matches
    return matches.take(np.flatnonzero(matches.ratio <= max_ratio))


def estimate_by_epnp(finder: LandmarkFinder, sighting: Sighting) -> NavigationResult:
    """Estimate as the paper does: EPnP on the best matches, all of them trusted.

    Large features are left out: their places are pixels off, and EPnP weighs all alike.
    """
    best = best_matches(sighting, max_ratio=finder.detector.trusted_ratio)
    is_small = sighting.features.size_px[best.feature] <= TRUSTED_SIZE_PX
    trusted = finder.correspondences(sighting, best.take(np.flatnonzero(is_small)))
    return NavigationResult("ok", solve_epnp(trusted), uv_inliers=trusted.uv)


def estimate_by_least_squares(finder: LandmarkFinder, sighting: Sighting) -> NavigationResult:
    """Estimate by RANSAC on the most similar matches, then least squares on all that agree."""
    best = finder.correspondences(
        sighting, best_matches(sighting, max_ratio=RANSAC_MAX_RATIO).first(N_RANSAC)
    )
    start, _ = solve_ransac(best, tolerance=RANSAC_TOLERANCE_PX / finder.camera.fx_px)
    every = finder.correspondences(sighting, sighting.matches)
    estimate = refine_pose(start, every, finder.camera, gate_px=GATE_PX)
    return NavigationResult(
        "ok",
        estimate.trs_from_cam,
        estimate.covariance,
        uv_inliers=every.uv[estimate.is_inlier],
    )


def akaze(context: CoreContext) -> NavigationCore:
    """Make the paper's core with AKAZE features."""
    return FeatureCore("akaze", _finder(AKAZE, context), estimate_by_epnp)


def brisk(context: CoreContext) -> NavigationCore:
    """Make the paper's core with BRISK features."""
    return FeatureCore("brisk", _finder(BRISK, context), estimate_by_epnp)


def akaze_refined(context: CoreContext) -> NavigationCore:
    """Make the core with AKAZE features and least squares."""
    return FeatureCore("akaze-refined", _finder(AKAZE, context), estimate_by_least_squares)


def brisk_refined(context: CoreContext) -> NavigationCore:
    """Make the core with BRISK features and least squares."""
    return FeatureCore("brisk-refined", _finder(BRISK, context), estimate_by_least_squares)


def known_cores() -> dict[str, EntryPoint]:
    """Give every installed core by name."""
    return {point.name: point for point in entry_points(group=ENTRY_POINT_GROUP)}


def make_core(name: str, context: CoreContext) -> NavigationCore:
    """Make one core.

    Raises:
        ScoreError: No such core; the message lists the known ones.
    """
    cores = known_cores()
    if name not in cores:
        raise ScoreError(
            f"no navigation core '{name}'; known cores: {', '.join(sorted(cores)) or 'none'}"
        )
    return cores[name].load()(context)


def _finder(detector: Detector, context: CoreContext) -> LandmarkFinder:
    key = f"tronlab.nav.{detector.name}"
    if key not in context.shared:
        context.shared[key] = LandmarkFinder(detector, context)
    return context.shared[key]  # pyright: ignore[reportReturnType]  # the key belongs to this class


def _fingerprint(image: GreyImage, mask: Mask) -> bytes:
    digest = hashlib.blake2b(digest_size=16)
    for array in (image, mask):
        digest.update(f"{array.dtype} {array.shape}".encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.digest()
