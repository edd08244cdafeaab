import pytest

from tronlab.devices.cell import PaceSpec
from tronlab.planning.duration import Timing, drift_checks_s, shot_duration

TIMING = Timing(
    settle_wait_s=0.5,
    settle_window_s=0.1,
    tracker_window_s=1.0,
    exposure_s=0.02,
    drift_window_s=2.0,
    n_reflectors=3,
    n_drift_checks=lambda n_shots: 2 + n_shots // 10,
)
PACE = PaceSpec(tracker_s=0.2, camera_s=0.05, read_s=0.03, write_s=0.01)


def test_a_shot_takes_two_looks_one_measurement_one_image_and_one_more_look():
    duration = shot_duration(TIMING, PACE, move_s=4.0)
    assert duration.move_s == 4.0
    assert duration.settle_s == pytest.approx(2 * (0.1 + 0.2) + 0.5)
    assert duration.tracker_s == pytest.approx(1.2)
    assert duration.camera_s == pytest.approx(0.07)
    assert duration.confirm_s == pytest.approx(0.3)
    assert duration.total_s == pytest.approx(4.0 + 1.1 + 1.2 + 0.07 + 0.3 + 0.03 + 0.01)


def test_each_drift_check_measures_every_reflector():
    assert drift_checks_s(TIMING, PACE, n_shots=25) == pytest.approx(4 * 3 * 2.2)
