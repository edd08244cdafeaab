"""One image on its way to a pose: match, find what agrees, look again, least squares."""

from collections.abc import Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.geometry.poses import FloatArray
from tronlab.nav.core import Frame
from tronlab.nav.features import Features
from tronlab.nav.matching import Matches, guided_matches
from tronlab.nav.pose import (
    Correspondences,
    NoPoseError,
    check_agreement,
    check_view,
    cramer_rao_bound,
    find_agreeing,
    refine_pose,
)
from tronlab.nav.settings import FeatureCoreSettings
from tronlab.nav.sightings import LandmarkFinder
from tronlab.nav.trust import trusted_matches

FIRST_FEATURES = 500
"""Anywhere on the terrain, so many features are sought first, the strongest all over the image:
most images need no more. Where the pose says, every feature is sought."""
CONTROL_PX = 40.0
"""How far a pose is turned to see how many matches a wrong one has."""
CONTROL_SIGMAS = 5.0
"""How many more the right one must have, in standard deviations of two counts."""
CONTROL_MATCHES = 250
"""So many, or a few more, are counted."""

Stage: TypeAlias = Literal["detect", "match", "pose"]


@dataclass(frozen=True, slots=True)
class Fix:
    """A pose, and what it rests on."""

    trs_from_cam: RigidTransform
    covariance: FloatArray | None
    bound: FloatArray | None
    matches: Matches
    """Those that agree."""


class Localisation:
    """The steps from one image to a pose, with the time each stage takes."""

    def __init__(
        self, finder: LandmarkFinder, settings: FeatureCoreSettings, frame: Frame, *, seed: int
    ) -> None:
        self._finder = finder
        self._matching = settings.matching
        self._pose = settings.pose
        self._frame = frame
        self._seed = seed
        self.features, time_detect_s = finder.features(frame)
        self.n_matches = 0
        """What the pose was last sought among."""
        self.times_s: dict[Stage, float] = {"detect": time_detect_s, "match": 0.0, "pose": 0.0}
        """As it took when it was computed; what comes from the store took longer then."""

    def fix(self) -> Fix:
        """Find the pose: near the prior, if there is one, else anywhere.

        Raises:
            NoPoseError: There is none to be had.
        """
        if not self._matching.guided:
            return self._fix(self._matches_anywhere())
        prior = self._frame.prior
        if prior is not None:
            # A wrong prior must not cost what the image alone gives.
            with suppress(NoPoseError):
                return self._checked_fix(self._matches_near(prior.trs_from_cam, prior.covariance))
        if self._pose.refine and len(self.features) > FIRST_FEATURES:
            with suppress(NoPoseError):
                return self._checked_fix(self._matches_anywhere(FIRST_FEATURES))
        return self._checked_fix(self._matches_anywhere())

    def _checked_fix(self, matches: Matches) -> Fix:
        fix = self._fix(matches)
        self._check_against_control(fix)
        return fix

    def _fix(self, matches: Matches) -> Fix:
        self.n_matches = len(matches)
        with self._timed("match"):
            database = self._finder.database
            trusted = trusted_matches(matches, self.features, database, self._matching)
        with self._timed("pose"):
            pose, agrees = self._agreeing(self._correspondences(trusted))
        if not self._pose.refine:
            used = trusted.take(np.flatnonzero(agrees))
            return Fix(pose, None, self._bound(pose, self._correspondences(used)), used)
        again = self._matches_near(pose) if self._matching.guided else matches
        with self._timed("pose"):
            return self._refined(pose, again)

    def _check_against_control(self, fix: Fix) -> None:
        """Refuse a pose that has hardly more matches than one that is surely wrong.

        Matches sought where a pose puts them agree with any pose; only right ones are many.

        Raises:
            NoPoseError: It is no better than the wrong one.
        """
        turn = Rotation.from_rotvec([CONTROL_PX / self._finder.camera.fy_px, 0.0, 0.0])
        pose = fix.trs_from_cam
        turned = RigidTransform.from_components(pose.translation, pose.rotation * turn)
        step = max(len(fix.matches) // CONTROL_MATCHES, 1)
        some = self.features.take(slice(None, None, step))
        n = int(np.count_nonzero(fix.matches.feature % step == 0))
        n_control = len(self._matches_near(turned, features=some))
        if n - n_control < CONTROL_SIGMAS * np.sqrt(n + n_control):
            raise NoPoseError(
                f"of {len(some)} features, {n} agree with the pose, and {n_control} with one that"
                f" is wrong: turned by {CONTROL_PX:g} px"
            )

    def _agreeing(self, matches: Correspondences) -> tuple[RigidTransform, NDArray[np.bool_]]:
        camera, settings = self._finder.camera, self._pose
        pose, agrees = find_agreeing(matches, camera, settings, seed=self._seed)
        if settings.robust != "none":
            looked_at = matches.take(slice(settings.n_best))
            check_agreement(pose, looked_at, camera, tolerance_px=settings.tolerance_px)
        return pose, agrees

    def _refined(self, start: RigidTransform, matches: Matches) -> Fix:
        self.n_matches = len(matches)
        settings, camera = self._pose, self._finder.camera
        every = self._correspondences(matches)
        estimate = refine_pose(start, every, camera, gate_px=settings.gate_px)
        bound = check_view(
            estimate.trs_from_cam,
            every.take(estimate.is_inlier),
            camera,
            sigma_px=estimate.noise_px,
            max_sigma_pct=settings.max_sigma_pct,
        )
        used = matches.take(np.flatnonzero(estimate.is_inlier))
        return Fix(estimate.trs_from_cam, estimate.covariance, bound, used)

    def _bound(self, pose: RigidTransform, matches: Correspondences) -> FloatArray | None:
        """Give the bound for matches that no least squares adjusted: it says how noisy they are."""
        try:
            estimate = refine_pose(pose, matches, self._finder.camera, gate_px=self._pose.gate_px)
            return cramer_rao_bound(
                estimate.trs_from_cam,
                matches.take(estimate.is_inlier),
                self._finder.camera,
                sigma_px=estimate.noise_px,
            )
        except NoPoseError:
            return None

    def _matches_anywhere(self, n_features: int | None = None) -> Matches:
        matches, time_s = self._finder.matches(self._frame, n_features)
        self.times_s["match"] += time_s
        return matches

    def _matches_near(
        self,
        pose: RigidTransform,
        covariance: FloatArray | None = None,
        *,
        features: Features | None = None,
    ) -> Matches:
        finder, sought = self._finder, self.features if features is None else features
        with self._timed("match"):
            return guided_matches(finder.database, sought, finder.camera, pose, covariance)

    def _correspondences(self, matches: Matches) -> Correspondences:
        found = self._finder.correspondences(self.features, matches)
        if self._pose.weigh_by_size:
            return found
        return replace(found, scale=np.ones(len(found)))

    @contextmanager
    def _timed(self, stage: Stage) -> Generator[None]:
        start_s = perf_counter()
        try:
            yield
        finally:
            self.times_s[stage] += perf_counter() - start_s
