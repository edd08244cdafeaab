import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2

from tronlab.calib.reflectors.lamp import solve_lamp
from tronlab.calib.results import FrameResult
from tronlab.devices.laboratory import LampSpec
from tronlab.devices.readings import PointReading
from tronlab.errors import CalibrationError
from tronlab.geometry.uncertainty import perturb

FRAME_COVARIANCE = np.diag([3e-5, 2e-5, 4e-5, 5e-5, 3e-5, 8e-5]) ** 2
SIGMA_M = 40e-6


def frame_at(trs_from_trk: RigidTransform) -> FrameResult:
    return FrameResult(trs_from_trk, FRAME_COVARIANCE)


def reading_of(p_trk_m: np.ndarray) -> PointReading:
    return PointReading("lamp", p_trk_m, SIGMA_M**2 * np.eye(3), 0.0)


def test_errors_agree_with_the_predicted_covariance() -> None:
    """With errors of the frame, of the reading and of the stated way to the light."""
    rng = np.random.default_rng(1)
    spec = LampSpec(
        p_trs_m=(-3.0, -2.0, 3.0), light_from_reflector_m=(0.1, -0.2, 0.05), light_sigma_m=2e-4
    )
    nees = []
    for _ in range(300):
        p_light = rng.uniform([-4.0, -3.0, 1.0], [-2.0, -2.0, 4.0])
        truth = RigidTransform.from_components([1.0, 2.0, 5.0], Rotation.random(rng=rng))
        p_reflector = p_light - spec.light_from_reflector_m - 2e-4 * rng.normal(size=3)
        p_trk = truth.inv().apply(p_reflector) + SIGMA_M * rng.normal(size=3)
        found = perturb(truth, np.sqrt(np.diag(FRAME_COVARIANCE)) * rng.normal(size=6))
        lamp = solve_lamp(reading_of(p_trk), frame_at(found), spec)
        error = lamp.p_trs_m - p_light
        nees.append(error @ np.linalg.solve(lamp.covariance_m2, error))
    low, high = chi2.ppf([0.005, 0.995], 3 * len(nees))
    assert low < sum(nees) < high


def test_statistics_say_what_was_measured_and_how_far_that_is_from_the_plan() -> None:
    spec = LampSpec(p_trs_m=(1.0, 2.0, 3.0), light_from_reflector_m=(0.0, 0.0, 0.1))
    frame = frame_at(RigidTransform.from_translation([0.0, 0.0, 2.0]))
    lamp = solve_lamp(reading_of(np.array([1.0, 2.0, 1.0])), frame, spec)
    np.testing.assert_allclose(lamp.p_trs_m, [1.0, 2.0, 3.1])
    np.testing.assert_allclose(lamp.statistics["p_reflector_trs_m"], [1.0, 2.0, 3.0])
    np.testing.assert_allclose(lamp.statistics["from_nominal_m"], [0.0, 0.0, 0.1], atol=1e-12)


@pytest.mark.parametrize(
    ("p_trk_m", "message"),
    [
        ([1000.0, 2000.0, 1000.0], r"is 2449 m from the tracker.*millimetres"),
        ([1.0, np.inf, 1.0], "not finite"),
        ([1.0, 2.0, -2.5], r"the light would be 0\.500 m behind the model"),
    ],
)
def test_readings_that_make_no_sense_are_refused(p_trk_m, message) -> None:
    frame = frame_at(RigidTransform.from_translation([0.0, 0.0, 2.0]))
    with pytest.raises(CalibrationError, match=f"lamp: .*{message}"):
        solve_lamp(reading_of(np.array(p_trk_m)), frame, LampSpec(p_trs_m=(0.0, 0.0, 3.0)))
