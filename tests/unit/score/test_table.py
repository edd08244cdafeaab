"""Rows of the table of scores: errors against what truth, core and bound know of themselves."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import Truth
from tronlab.nav.core import NavigationResult
from tronlab.score.evaluation.consistency import (
    efficiency,
    nees_consistency,
    nees_quantiles,
    truth_limit,
)
from tronlab.score.light import lamp_position, phase_angle_rad
from tronlab.score.table import (
    COLUMNS,
    DEFAULTS,
    ShotFacts,
    pose_crc,
    score_row,
    score_table,
    shot_facts,
    with_all_columns,
)

DOWN = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
TRUTH = Truth(
    RigidTransform.from_components([0.0, 0.0, 2.0], DOWN),
    np.diag([1e-8] * 3 + [1e-8, 4e-8, 4e-8]),
    range_los_m=2.0,
    usable_fraction=0.9,
)


def row_of(result, *, phase_rad=np.nan):
    return score_row("mine", 3, ShotFacts(7, TRUTH, "good", phase_rad), result)


def ok(shift_m, **fields):
    return NavigationResult(
        "ok", RigidTransform.from_translation(shift_m) * TRUTH.trs_from_cam, **fields
    )


def test_sigmas_are_roots_of_traces_of_the_position_part():
    covariance = np.diag([9.0, 9.0, 9.0, 1e-6, 4e-6, 4e-6])
    row = row_of(ok([0.001, 0.0, 0.0], covariance=covariance, bound=covariance / 4))
    assert (row["core"], row["seed"], row["shot_id"]) == ("mine", 3, 7)
    assert row["sigma_truth_m"] == pytest.approx(3e-4)
    assert row["sigma_core_m"] == pytest.approx(3e-3)
    assert row["bound_m"] == pytest.approx(1.5e-3)
    assert row["nees"] == pytest.approx(1e-6 / (1e-6 + 1e-8))


@pytest.mark.parametrize(
    "covariance", [None, np.full((6, 6), np.nan), -np.eye(6), np.zeros((6, 6)) - 1e-8]
)
def test_what_is_no_covariance_leaves_its_cells_empty(covariance):
    row = row_of(ok([0.001, 0.0, 0.0], covariance=covariance))
    assert np.isnan(row["nees"])
    assert np.isnan(row["sigma_core_m"])
    assert np.isfinite(row["position_error_m"])


def test_without_a_pose_only_the_shot_is_known():
    row = row_of(NavigationResult("timeout"), phase_rad=np.pi / 4)
    table = score_table([row])
    assert list(table.columns) == list(COLUMNS)
    known = ["range_los_m", "usable_fraction", "sigma_truth_m", "phase_deg"]
    assert table.loc[0, known].notna().all()
    assert table.loc[0, ["nees", "bound_m", "sigma_core_m", "position_error_m"]].isna().all()
    assert table.loc[0, "phase_deg"] == pytest.approx(45.0)


def test_honest_covariances_have_the_nees_of_theory():
    """Errors drawn from the sum of both covariances: chi-square with three degrees of freedom."""
    rng = np.random.default_rng(4)
    half = rng.normal(size=(3, 3))
    covariance = np.diag([1e-8] * 6)
    covariance[3:, 3:] = 1e-6 * (half @ half.T + 0.1 * np.eye(3))
    total = covariance[3:, 3:] + TRUTH.covariance[3:, 3:]
    errors_m = rng.multivariate_normal(np.zeros(3), total, 400)
    rows = [row_of(ok(error_m, covariance=covariance, bound=covariance)) for error_m in errors_m]
    table = score_table(rows).assign(shot_id=range(400))
    assert stats.kstest(table["nees"], stats.chi2(3).cdf).pvalue > 0.01
    found = nees_consistency(table)
    assert found.verdict == "consistent"
    low, high = stats.chi2.ppf([0.025, 0.975], 1200) / 400
    assert (found.bounds.low, found.bounds.high) == pytest.approx((low, high))
    # Root mean square of error over bound: the expectation of the square is trace over trace.
    expected = np.sqrt(np.trace(total) / np.trace(covariance[3:, 3:]))
    assert efficiency(table).rms_ratio == pytest.approx(expected, rel=0.1)
    sure = table.assign(nees=1.5 * table["nees"])
    assert nees_consistency(sure).verdict == "too sure"
    assert nees_consistency(table.assign(nees=table["nees"] / 2)).verdict == "too cautious"
    assert nees_consistency(table.assign(nees=np.nan)).verdict == "not known"


def test_the_laboratory_is_the_limit_below_two_sigmas():
    sigma_m = 3e-4
    rows = [row_of(ok([factor * sigma_m, 0.0, 0.0])) for factor in (0.1, 1.9, 2.1, 30.0)]
    rows.append(row_of(NavigationResult("no_pose")))
    found = truth_limit(score_table(rows).assign(shot_id=range(5)))
    assert (found.within.n_hits, found.within.n) == (2, 4)
    assert found.median_ratio == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("p_lamp_m", "angle_deg"),
    [([0, 0, 9], 0.0), ([5, 0, 5], 45.0), ([0, -3, 0], 90.0), ([0, 0, -1], 180.0)],
)
def test_phase_is_the_angle_at_the_terrain(p_lamp_m, angle_deg):
    angle_rad = phase_angle_rad(TRUTH, np.array(p_lamp_m, dtype=np.float64))
    assert np.degrees(angle_rad) == pytest.approx(angle_deg)


def test_phase_of_what_is_not_known_is_not_known():
    assert np.isnan(phase_angle_rad(replace(TRUTH, range_los_m=np.nan), np.ones(3)))


def test_the_lamp_is_where_the_record_has_it_or_nowhere():
    assert lamp_position(json.dumps({"lamp": {"p_trs_m": [1, 2, 3.5]}})) == (1.0, 2.0, 3.5)
    for text in (
        "",
        "[]",
        "{}",
        '{"lamp": {"p_trs_m": [1, 2]}}',
        '{"lamp": {"p_trs_m": [1, 2, NaN]}}',
    ):
        assert lamp_position(text) is None


def test_each_shot_has_the_lamp_of_its_session(small_dataset, monkeypatch):
    with Dataset(small_dataset) as dataset:
        truth = dataset.truth(2)
        assert np.isnan(shot_facts(dataset, 2).phase_rad)
        [session] = dataset.sessions
        record = json.dumps({"lamp": {"p_trs_m": [4.0, 0.0, 3.0]}})
        dataset.__dict__["sessions"] = (replace(session, calibration_json=record),)
        facts = shot_facts(dataset, 2)
        assert (facts.shot_id, facts.truth_state) == (2, dataset.truth_states[2])
        assert facts.phase_rad == phase_angle_rad(truth, np.array([4.0, 0.0, 3.0]))


@pytest.mark.parametrize("n_shots", [1, 61])
def test_the_mean_nees_of_honest_poses_is_chi_square(n_shots):
    shares = np.array([0.025, 0.5, 0.975])
    expected = stats.chi2.ppf(shares, 3 * n_shots) / n_shots
    np.testing.assert_allclose(nees_quantiles(shares, n_shots), expected)


def test_a_pose_is_known_by_its_checksum_but_for_its_last_digits():
    pose = TRUTH.trs_from_cam
    crc = pose_crc(pose)
    assert crc == pose_crc(pose * RigidTransform.from_translation([0.0, 0.0, 1e-13]))
    assert crc != pose_crc(pose * RigidTransform.from_translation([0.0, 0.0, 1e-8]))
    about_the_axis = RigidTransform.from_rotation(Rotation.from_euler("z", 1e-6))
    assert crc != pose_crc(pose * about_the_axis)


def test_a_table_of_an_earlier_version_gets_what_it_lacks():
    table = score_table([row_of(ok([0.001, 0.0, 0.0]))])
    old = with_all_columns(table.drop(columns=list(DEFAULTS)))
    assert old[list(COLUMNS)].astype(COLUMNS).loc[0, "seed"] == 0
    assert old.loc[0, "truth_state"] == "unchecked"
    pd.testing.assert_frame_equal(with_all_columns(table), table)
