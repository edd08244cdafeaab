"""What is known of single answers: their matches, held against the truth."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import Truth
from tronlab.errors import TronlabError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray
from tronlab.nav.core import CoreContext
from tronlab.nav.database import Database, build_database
from tronlab.nav.database_file import open_database
from tronlab.nav.pose import Correspondences, NoPoseError, refine_pose, residuals_px
from tronlab.nav.pose.projection import points_in_cam
from tronlab.nav.settings import PRESETS, core_settings
from tronlab.nav.stages import NOTHING_KEPT
from tronlab.score.matches import StoredAnswer
from tronlab.score.reasons import WRONG_PX, Evidence
from tronlab.score.rescoring.keys import calibration_key
from tronlab.score.rescoring.stage_files import StageFiles
from tronlab.score.results import ScoreResults

_GATE_PX = 6.0
"""Largest residual at the truth with which a match takes part in least squares, times how much less
certain it is than the best."""
_MIN_DEPTH_M = 1e-6

AnswerKey = tuple[str, int, int]
"""Core, seed and shot id."""


def read_evidence(
    results: ScoreResults,
    dataset: Dataset,
    wanted: Collection[AnswerKey],
    *,
    cache_dir: Path | None = None,
) -> Mapping[AnswerKey, Evidence]:
    """Look into some answers.

    Landmarks are those of the database that the core used, found anew or taken from the stage
    store; where it is not to be had, as with cores of others, what follows from it stays NaN.

    Args:
        results: The scoring.
        dataset: The one that was scored.
        wanted: Which answers.
        cache_dir: Where stages of earlier scorings are kept; None: nowhere.

    Raises:
        IntegrityError: The dataset is damaged.
        ScoreError: The answers cannot be read.
    """
    databases = _Databases(results, dataset, cache_dir)
    rows = {int(shot_id): i for i, shot_id in enumerate(dataset.shot_ids)}
    found: dict[AnswerKey, Evidence] = {}
    for answer in _chosen(results, wanted):
        i = rows[answer.shot_id]
        quality = dataset.quality(i)
        seen = _Seen(dataset.camera, dataset.truth(i), answer, databases.of(answer))
        found[answer.core, answer.seed, answer.shot_id] = Evidence(
            no_pose=answer.reason,
            flags=() if quality is None else tuple(quality.flags),
            **seen.spread_deg(),
            **seen.held_against_truth(),
        )
    return found


def _chosen(results: ScoreResults, wanted: Collection[AnswerKey]) -> Iterator[StoredAnswer]:
    for answer in results.answers():
        if (answer.core, answer.seed, answer.shot_id) in wanted:
            yield answer


@dataclass(frozen=True, slots=True)
class _Seen:
    """The matches of one answer."""

    camera: CameraModel
    truth: Truth
    answer: StoredAnswer
    database: Database | None

    def spread_deg(self) -> dict[str, float]:
        """Give the angles that the matches cover."""
        uv = self.answer.uv_inliers
        if not len(uv):
            return {}
        angles_deg = np.degrees(np.arctan(self.camera.rays(uv)))
        width_deg, height_deg = np.ptp(angles_deg, axis=0).tolist()
        return {"width_deg": width_deg, "height_deg": height_deg}

    def held_against_truth(self) -> dict[str, float]:
        """Give how many matches are wrong, and what least squares makes of them."""
        if self.database is None or not len(self.answer.landmark_inliers):
            return {}
        matches, truth = self._correspondences(self.database), self.truth.trs_from_cam
        off_px = np.linalg.norm(residuals_px(truth, matches, self.camera), axis=1)
        # Behind the camera, which is NaN, is as wrong as can be.
        wrong_share = float((~(off_px <= WRONG_PX)).mean())
        try:
            refit = refine_pose(truth, matches, self.camera, gate_px=_GATE_PX)
        except NoPoseError:
            return {"wrong_share": wrong_share, "refit_error_m": np.inf}
        error_m = np.linalg.norm(refit.trs_from_cam.translation - truth.translation)
        return {
            "wrong_share": wrong_share,
            "refit_error_m": float(error_m),
            "noise_px": refit.noise_px,
            "smooth_ratio": refit.smooth_ratio,
        }

    def _correspondences(self, database: Database) -> Correspondences:
        """Give the matches; how certain each is follows from its landmark's size in the image."""
        uv, landmarks = self.answer.uv_inliers, self.answer.landmark_inliers
        matches = Correspondences(
            uv, self.camera.rays(uv), database.p_trs_m[landmarks], np.ones(len(uv))
        )
        depth_m: FloatArray = points_in_cam(self.truth.trs_from_cam, matches)[:, 2]
        size = database.size_m[landmarks] / np.maximum(depth_m, _MIN_DEPTH_M)
        return Correspondences(matches.uv, matches.rays, matches.p_trs_m, size / size.min())


class _Databases:
    """The databases of the cores of a scoring, each opened or built once."""

    def __init__(self, results: ScoreResults, dataset: Dataset, cache_dir: Path | None) -> None:
        self._definitions = results.definitions
        self._dataset = dataset
        self._stages = NOTHING_KEPT if cache_dir is None else StageFiles(cache_dir)
        self._by_digest: dict[str, Database | None] = {}

    def of(self, answer: StoredAnswer) -> Database | None:
        """Give the database that an answer counts its landmarks in; None: it is not to be had."""
        if not answer.database:
            return None
        if answer.database not in self._by_digest:
            self._by_digest[answer.database] = self._found(answer)
        return self._by_digest[answer.database]

    def _found(self, answer: StoredAnswer) -> Database | None:
        definition: Mapping[str, Any] = self._definitions.get(answer.core, {})
        target = str(definition.get("target", ""))
        if definition.get("kind") != "installed" or target not in PRESETS:
            return None
        try:
            settings = core_settings(target, definition.get("settings", {}))
            if settings.database is not None:
                database = open_database(settings.database)
            else:
                database = build_database(self._context(), settings.detector)
        except TronlabError:  # what was scored then is not there any more
            return None
        return database if database.digest == answer.database else None

    def _context(self) -> CoreContext:
        return CoreContext(
            self._dataset.camera,
            self._dataset.references(),
            stages=self._stages,
            references_key=calibration_key(self._dataset),
        )
