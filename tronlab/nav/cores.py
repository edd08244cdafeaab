"""The built-in navigation cores, and the way from what a person names to one.

A built-in core is a preset of settings (``nav.settings``), any of which may be changed. Cores whose
settings of a stage agree share its work: database, features, matches.
"""

from dataclasses import replace
from importlib.metadata import version

import cv2

from tronlab.nav.core import CoreContext, Frame, NavigationCore, NavigationResult
from tronlab.nav.database_file import open_database
from tronlab.nav.installed import installed_core
from tronlab.nav.localisation import Fix, Localisation
from tronlab.nav.matching import load_kernels
from tronlab.nav.pose import NoPoseError
from tronlab.nav.settings import PRESETS, FeatureCoreSettings, core_settings
from tronlab.nav.sightings import landmark_finder
from tronlab.nav.sources import digest_of_stage
from tronlab.nav.specs import CoreSpec

BUILT_IN_CORES = tuple(PRESETS)


class FeatureCore:
    """A navigation core of one detector, one way of matching and one estimator."""

    def __init__(self, name: str, settings: FeatureCoreSettings, context: CoreContext) -> None:
        self._name = name
        self._settings = settings
        self._seed = context.seed
        self._finder = landmark_finder(settings, context)
        # Not in the first image's time: nor does a time limit's signal survive the compiler.
        load_kernels(settings.matching)

    @property
    def name(self) -> str:
        """Get the name the scores carry."""
        return self._name

    def locate(self, frame: Frame) -> NavigationResult:
        """Find ``trs_from_cam`` of one image; see ``NavigationCore``."""
        localisation = Localisation(self._finder, self._settings, frame, seed=self._seed)
        try:
            answer = self._fixed(localisation, localisation.fix())
        except NoPoseError as error:
            answer = NavigationResult("no_pose", reason=str(error))
        return replace(
            answer,
            n_features=len(localisation.features),
            n_matches=localisation.n_matches,
            time_detect_s=localisation.times_s["detect"],
            time_match_s=localisation.times_s["match"],
            time_pose_s=localisation.times_s["pose"],
        )

    def _fixed(self, localisation: Localisation, fix: Fix) -> NavigationResult:
        return NavigationResult(
            "ok",
            fix.trs_from_cam,
            fix.covariance,
            fix.bound,
            n_inliers=len(fix.matches),
            uv_inliers=localisation.features.uv[fix.matches.feature],
            landmark_inliers=fix.matches.landmark,
            database=self._finder.database.digest,
        )


def akaze(context: CoreContext) -> NavigationCore:
    """Make the paper's core with AKAZE features."""
    return _feature_core("akaze", context)


def brisk(context: CoreContext) -> NavigationCore:
    """Make the paper's core with BRISK features."""
    return _feature_core("brisk", context)


def akaze_refined(context: CoreContext) -> NavigationCore:
    """Make the core with AKAZE features and least squares."""
    return _feature_core("akaze-refined", context)


def brisk_refined(context: CoreContext) -> NavigationCore:
    """Make the core with BRISK features and least squares."""
    return _feature_core("brisk-refined", context)


def is_built_in(spec: CoreSpec) -> bool:
    """Tell whether a core is one of tronlab's own, which run in the process that scores.

    Raises:
        ScoreError: It is to be an installed one, and is not.
    """
    return spec.kind == "installed" and installed_core(spec.target).name in PRESETS


def make_core(spec: CoreSpec, context: CoreContext) -> NavigationCore:
    """Make an installed core, with the settings and the seed of ``spec``.

    Raises:
        DatasetError: Its database cannot be read.
        ScoreError: No such core, or a database of another detector.
        ConfigError: It has no such setting.
    """
    own = replace(context, settings=spec.settings, seed=spec.seed)
    return installed_core(spec.target).load()(own)


def built_in_identity(spec: CoreSpec) -> str:
    """Give what the answers of a built-in core depend on besides its settings, its seed and frames.

    Raises:
        DatasetError: Its database cannot be read.
        ConfigError: It has no such setting.
    """
    settings = core_settings(spec.target, spec.settings)
    database = "" if settings.database is None else open_database(settings.database).digest
    libraries = f"opencv {cv2.__version__}"
    if settings.pose.robust == "poselib":
        libraries += f" poselib {version('poselib')}"
    return f"{spec.target} {digest_of_stage('core')} {libraries} {database}".strip()


def _feature_core(preset: str, context: CoreContext) -> NavigationCore:
    return FeatureCore(preset, core_settings(preset, context.settings), context)
