"""Why an error is as large as it is: the rule, and the evidence it rests on."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tronlab.dataset.reader import Dataset
from tronlab.geometry.uncertainty import perturb
from tronlab.nav.core import CoreContext, Frame, NavigationResult
from tronlab.nav.cores import akaze_refined
from tronlab.score.evidence import read_evidence
from tronlab.score.reasons import Cause, Evidence, explain
from tronlab.score.rescoring.shot import CoreScore
from tronlab.score.results import ScoreResults, load_results, save_results
from tronlab.score.table import score_row, shot_facts

ROW = {
    "status": "ok",
    "position_error_m": 0.010,
    "bound_m": 0.001,
    "sigma_truth_m": 1e-4,
    "range_los_m": 2.0,
    "usable_fraction": 0.31,
    "n_inliers": 87,
    "n_features": 1234,
}
GOOD = Evidence(width_deg=20, height_deg=9, wrong_share=0.0, refit_error_m=0.010, noise_px=0.2)


@pytest.mark.parametrize(
    ("row", "evidence", "cause", "says"),
    [
        ({"status": "no_pose"}, replace(GOOD, no_pose="4 matches"), "no pose", "4 matches; 1234"),
        ({"sigma_truth_m": 0.006}, GOOD, "truth", "1.7 sigmas"),
        ({}, replace(GOOD, refit_error_m=1e-3, wrong_share=0.3), "wrong matches", "0.05 % of LOS"),
        ({}, replace(GOOD, refit_error_m=1e-3), "estimator", "87 matches within 20 x 9 deg"),
        ({"bound_m": 0.004}, GOOD, "view", "2.5 times that; 31 % of the image"),
        ({}, GOOD, "landmarks", "10.0 times that: all are displaced together"),
        ({}, replace(GOOD, smooth_ratio=9.0), "landmarks", "3.0 times as uncertain"),
        ({}, Evidence(), "unknown", "31 %"),
        ({"bound_m": np.nan}, Evidence(), "unknown", "31 %"),
        ({"bound_m": np.nan, "sigma_truth_m": np.nan}, GOOD, "unknown", "31 %"),
        ({"bound_m": 0.004}, Evidence(), "view", "0.2 % of LOS at best"),
        ({}, replace(GOOD, refit_error_m=np.inf, wrong_share=0.9), "wrong matches", "90 % of them"),
    ],
)
def test_the_first_that_applies_is_the_reason(
    row: dict[str, object], evidence: Evidence, cause: Cause, says: str
) -> None:
    reason = explain(ROW | row, evidence)
    assert reason.cause == cause
    assert reason.sentence.startswith(cause.capitalize())
    assert says in reason.sentence
    assert "nan" not in reason.sentence
    assert reason.sentence.endswith(".")


def test_what_the_gate_flagged_is_said() -> None:
    sentence = explain(ROW, replace(GOOD, flags=("saturation", "blur"))).sentence
    assert sentence.endswith("; the quality gate flagged saturation, blur.")


@pytest.fixture(scope="module")
def scored(plane_dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> ScoreResults:
    """A shot as the core answers it, with a spoilt pose, with spoilt matches, and unknown."""
    folder = tmp_path_factory.mktemp("scored")
    with Dataset(plane_dataset) as dataset:
        context = CoreContext(dataset.camera, dataset.references())
        result = akaze_refined(context).locate(Frame(dataset.image(5), dataset.mask(5)))
        facts = shot_facts(dataset, 5)
    assert result.trs_from_cam is not None
    off = perturb(result.trs_from_cam, np.array([0, 0, 0, 0.2, 0, 0]))
    rolled = np.roll(result.landmark_inliers, 7)
    mixed = np.where(np.arange(len(rolled)) % 3 == 0, rolled, result.landmark_inliers)
    answers: dict[str, NavigationResult] = {
        "as-it-is": result,
        "moved": replace(result, trs_from_cam=off),
        "mixed": replace(result, trs_from_cam=off, landmark_inliers=mixed),
        "shuffled": replace(result, trs_from_cam=off, landmark_inliers=np.flip(rolled)),
        "foreign": replace(result, trs_from_cam=off, database="of somebody else"),
    }
    scores = [
        CoreScore(name, facts.shot_id, score_row(name, 0, facts, answer), answer)
        for name, answer in answers.items()
    ]
    definition = {"kind": "installed", "target": "akaze-refined", "settings": {}}
    info = {
        "dataset": str(plane_dataset),
        "cores": list(answers),
        "software": {},
        "scored_utc": "",
        "definitions": dict.fromkeys(answers, definition),
    }
    save_results(folder, scores, info)
    return load_results(folder)


def test_matches_are_held_against_the_truth(scored: ScoreResults, plane_dataset: Path) -> None:
    shot_id = int(scored.scores["shot_id"].iloc[0])
    keys = {(core, 0, shot_id): core for core in scored.cores}
    with Dataset(plane_dataset) as dataset:
        evidence = read_evidence(scored, dataset, keys)
    found = {core: evidence[key] for key, core in keys.items()}
    rows = {str(row["core"]): row for row in scored.scores.to_dict("records")}
    causes = {core: explain(rows[core], each).cause for core, each in found.items()}
    assert found["as-it-is"].wrong_share < 0.02
    assert 20 < found["as-it-is"].width_deg < 66
    assert found["moved"].refit_error_m < 0.01
    assert causes["moved"] == "estimator"
    assert found["mixed"].wrong_share == pytest.approx(1 / 3, abs=0.05)
    assert found["mixed"].refit_error_m < 0.02
    assert causes["mixed"] == "wrong matches"
    assert found["shuffled"].wrong_share > 0.9
    assert found["shuffled"].refit_error_m > 0.02
    assert causes["shuffled"] == "wrong matches"
    assert np.isnan(found["foreign"].wrong_share)
    assert causes["foreign"] == "unknown"
    assert causes["as-it-is"] in ("truth", "view", "landmarks")
