"""What a core is offered beforehand: as uncertain as it says, whatever the order of shots."""

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.geometry.uncertainty import pose_difference
from tronlab.nav.core import NavigationResult, PosePrior
from tronlab.score.rescoring.prior import PriorSettings, drawn_prior, prior_after

TRUTH = RigidTransform.from_components([1.0, 2.0, 3.0], Rotation.from_rotvec([0.4, 2.0, -1.0]))
SETTINGS = PriorSettings(source="truth", position_sigma_m=0.2, rotation_sigma_deg=3.0, seed=5)


def test_the_error_of_a_drawn_prior_is_that_of_its_covariance() -> None:
    n = 500
    priors = [drawn_prior(SETTINGS, shot_id, TRUTH) for shot_id in range(n)]
    differences = np.array([pose_difference(p.trs_from_cam, TRUTH) for p in priors])
    whitened = differences / np.sqrt(np.diag(priors[0].covariance))
    assert np.sqrt(np.diag(priors[0].covariance)) == pytest.approx([np.radians(3)] * 3 + [0.2] * 3)
    low, high = stats.chi2.ppf([0.001, 0.999], 6 * n)
    assert low < (whitened**2).sum() < high
    assert np.abs(whitened.mean(axis=0)).max() < 4 / np.sqrt(n)


def test_a_prior_is_the_same_for_a_shot_whenever_it_is_drawn() -> None:
    first, again = (drawn_prior(SETTINGS, 7, TRUTH).trs_from_cam.as_matrix() for _ in range(2))
    np.testing.assert_array_equal(first, again)
    for other in (SETTINGS.model_copy(update={"seed": 6}), SETTINGS):
        shot_id = 7 if other.seed == 6 else 8
        assert np.abs(drawn_prior(other, shot_id, TRUTH).trs_from_cam.as_matrix() - first).max() > 0


def test_what_is_known_gets_less_certain_with_every_image_without_an_answer() -> None:
    grown = SETTINGS.covariance()
    lost = NavigationResult("no_pose")
    assert prior_after(SETTINGS, None, lost) is None
    known = prior_after(SETTINGS, None, NavigationResult("ok", TRUTH, np.eye(6)))
    assert known is not None
    np.testing.assert_allclose(known.covariance, np.eye(6) + grown)
    known = prior_after(SETTINGS, known, lost)
    assert known is not None
    np.testing.assert_allclose(known.covariance, np.eye(6) + 2 * grown)
    unsure = prior_after(SETTINGS, PosePrior(TRUTH, np.eye(6)), NavigationResult("ok", TRUTH))
    assert unsure is not None
    np.testing.assert_allclose(unsure.covariance, grown)
