"""What images show of the database: features and their matches, each computed once.

Cores of one process share this work when their settings agree, and scorings share it over time by
the stage store of the context.
"""

import hashlib
from collections.abc import Callable
from functools import cached_property
from time import perf_counter
from typing import TypeVar

import cv2
import numpy as np

from tronlab.errors import ScoreError
from tronlab.geometry.poses import FloatArray
from tronlab.nav.core import CoreContext, Frame
from tronlab.nav.database import Database, build_database
from tronlab.nav.database_file import open_database
from tronlab.nav.features import Features, detect_features, make_detector
from tronlab.nav.matching import Matcher, Matches, open_matcher
from tronlab.nav.pose import Correspondences
from tronlab.nav.settings import DetectorSettings, FeatureCoreSettings
from tronlab.nav.sources import digest_of_stage
from tronlab.nav.stages import Arrays, stage_key

T = TypeVar("T")


class FeatureFinder:
    """The features of images, by one detector; remembers the last image."""

    def __init__(self, settings: DetectorSettings, context: CoreContext) -> None:
        self._detector = make_detector(settings)
        self._settings = settings.model_dump(mode="json")
        self._stages = context.stages
        self._last: tuple[str, tuple[Features, float]] | None = None

    def key(self, frame: Frame) -> str:
        """Give the key of what ``find`` gives."""
        return stage_key(
            frame=frame.key or fingerprint(frame),
            detector=self._settings,
            opencv=cv2.__version__,
            sources=digest_of_stage("features"),
        )

    def find(self, frame: Frame, key: str) -> tuple[Features, float]:
        """Give the features of an image and the time it took to find them, seconds."""
        if self._last is None or self._last[0] != key:
            self._last = key, self._kept(key) or self._found(frame, key)
        return self._last[1]

    def _kept(self, key: str) -> tuple[Features, float] | None:
        kept = self._stages.load("features", key)
        if kept is None:
            return None
        features = Features(kept["uv"], kept["size_px"], kept["descriptors"])
        return features, float(kept["time_s"])

    def _found(self, frame: Frame, key: str) -> tuple[Features, float]:
        start_s = perf_counter()
        features = detect_features(frame.image, frame.mask, self._detector)
        time_s = perf_counter() - start_s
        arrays: Arrays = {
            "uv": features.uv,
            "size_px": features.size_px,
            "descriptors": features.descriptors,
            "time_s": np.array(time_s),
        }
        self._stages.save("features", key, arrays)
        return features, time_s


class LandmarkFinder:
    """Features and matches of images against one database; remembers the last image."""

    def __init__(self, settings: FeatureCoreSettings, context: CoreContext) -> None:
        self.camera = context.camera
        self.database = _database(settings, context)
        self._context = context
        self._settings = settings
        self._features = shared(
            context,
            f"features {settings.detector.model_dump_json()}",
            lambda: FeatureFinder(settings.detector, context),
        )
        self._last: tuple[str, tuple[Matches, float]] | None = None
        self._rays: tuple[Features, FloatArray] | None = None
        """Through the features of the last image: lens equations take time to solve."""

    def features(self, frame: Frame) -> tuple[Features, float]:
        """Give the features of an image and the time it took to find them, seconds."""
        return self._features.find(frame, self._features.key(frame))

    def matches(self, frame: Frame, n_features: int | None = None) -> tuple[Matches, float]:
        """Give the matches of an image, found without a prior, and the time it took, seconds.

        Args:
            frame: The image.
            n_features: Of its features only the first; None: all.
        """
        key = stage_key(
            features=self._features.key(frame),
            n_features=n_features,
            database=self.database.digest,
            method=self._settings.matching.method,
            sources=digest_of_stage("matching"),
        )
        if self._last is None or self._last[0] != key:
            sought = self.features(frame)[0].take(slice(n_features))
            self._last = key, self._kept(key) or self._matched(sought, key)
        return self._last[1]

    def correspondences(self, features: Features, matches: Matches) -> Correspondences:
        """Give image positions and points of matches."""
        if self._rays is None or self._rays[0] is not features:
            self._rays = features, self.camera.rays(features.uv)
        return Correspondences(
            features.uv[matches.feature],
            self._rays[1][matches.feature],
            self.database.p_trs_m[matches.landmark],
            features.size_px[matches.feature] / features.size_px.min(initial=np.inf),
        )

    @cached_property
    def _matcher(self) -> Matcher:
        """Get the matcher: made when the first image is not to be had from the store."""
        return open_matcher(self._settings.matching, self.database, self._context.stages)

    def _kept(self, key: str) -> tuple[Matches, float] | None:
        kept = self._context.stages.load("matches", key)
        if kept is None:
            return None
        matches = Matches(kept["feature"], kept["landmark"], kept["distance"], kept["ratio"])
        return matches, float(kept["time_s"])

    def _matched(self, features: Features, key: str) -> tuple[Matches, float]:
        matcher = self._matcher
        start_s = perf_counter()
        matches = matcher.match(features)
        time_s = perf_counter() - start_s
        arrays: Arrays = {
            "feature": matches.feature,
            "landmark": matches.landmark,
            "distance": matches.distance,
            "ratio": matches.ratio,
            "time_s": np.array(time_s),
        }
        self._context.stages.save("matches", key, arrays)
        return matches, time_s


def landmark_finder(settings: FeatureCoreSettings, context: CoreContext) -> LandmarkFinder:
    """Give the finder for these settings: the same one to all cores of a process."""
    what = f"{settings.detector.model_dump_json()} {settings.database} {settings.matching.method}"
    return shared(context, f"landmarks {what}", lambda: LandmarkFinder(settings, context))


def shared(context: CoreContext, key: str, make: Callable[[], T]) -> T:
    """Give what is kept under a key of the context; make it the first time."""
    key = f"tronlab.nav {key}"
    if key not in context.shared:
        context.shared[key] = make()
    return context.shared[key]  # pyright: ignore[reportReturnType]  # one key, one type


def fingerprint(frame: Frame) -> str:
    """Give a text that tells the image and the mask of a frame from all others."""
    digest = hashlib.blake2b(digest_size=16)
    for array in (frame.image, frame.mask):
        digest.update(f"{array.dtype} {array.shape}".encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def _database(settings: FeatureCoreSettings, context: CoreContext) -> Database:
    """Open the file the settings name, or find the landmarks of the dataset's reference views.

    Raises:
        DatasetError: The file cannot be read.
        ScoreError: Its landmarks are of another detector.
    """
    if settings.database is None:
        what = f"database {settings.detector.model_dump_json()}"
        return shared(context, what, lambda: build_database(context, settings.detector))
    database = open_database(settings.database)
    if database.detector.features != settings.detector.features:
        raise ScoreError(
            f"{settings.database}: its landmarks are {database.detector.features} features, the"
            f" core has {settings.detector.features}; name another core, or build a database with"
            f" --features {settings.detector.features}"
        )
    return database
