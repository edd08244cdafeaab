"""Reflectors measured several times, and a T-MAC that must stand still."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform
from scipy.stats import chi2
from small_twin import ScriptedDialogue

from tronlab.calib.wizard.bench import Bench, Settings
from tronlab.calib.wizard.tracker import mean_reading, measure_reflectors, measure_still
from tronlab.devices.readings import PointReading, PoseReading
from tronlab.errors import CalibrationError, NotSettledError, TrackingLostError

PLACE = np.array([3.0, 1.0, -0.5])
STATED = np.diag([20e-6, 40e-6, 30e-6]) ** 2


def reading_at(p_trk_m: np.ndarray, covariance_m2: np.ndarray = STATED) -> PointReading:
    return PointReading("top_left", p_trk_m, covariance_m2, time_s=0.0)


def readings(rng: np.random.Generator, n: int, *, scatter: float = 1.0) -> list[PointReading]:
    noise = scatter * rng.multivariate_normal(np.zeros(3), STATED, n)
    return [reading_at(PLACE + d) for d in noise]


@dataclass
class FakeTracker:
    """Reports what it was given; an exception is raised."""

    script: list[Any]
    name: str = "tracker"
    windows_s: list[float] = field(default_factory=list)

    def measure_point(self, target: str, *, window_s: float) -> PointReading:
        return self._next(window_s)

    def measure_pose(self, *, window_s: float) -> PoseReading:
        return self._next(window_s)

    def _next(self, window_s: float) -> Any:
        self.windows_s.append(window_s)
        value = self.script.pop(0)
        if isinstance(value, Exception):
            raise value
        return value


def bench_with(script: Sequence[Any], **settings: Any) -> tuple[Bench, FakeTracker]:
    tracker = FakeTracker(list(script))
    devices: Any = SimpleNamespace(tracker=tracker)
    laboratory: Any = None
    mounting: Any = None
    bench = Bench(devices, laboratory, ScriptedDialogue(), mounting, Settings(**settings))
    return bench, tracker


def pose_at(x_m: float) -> PoseReading:
    covariance = np.diag([1e-4] * 3 + [5e-5] * 3) ** 2
    return PoseReading(RigidTransform.from_translation([x_m, 0.0, 0.0]), covariance, time_s=0.0)


def test_the_mean_of_independent_readings_agrees_with_its_covariance() -> None:
    rng = np.random.default_rng(1)
    nees = []
    for _ in range(300):
        mean, _ = mean_reading(readings(rng, 8))
        error = mean.p_trk_m - PLACE
        nees.append(error @ np.linalg.solve(mean.covariance_m2, error))
    low, high = chi2.ppf([0.005, 0.995], 3 * len(nees))
    assert low < sum(nees) < high


def test_readings_that_repeat_themselves_are_not_worth_more_than_one() -> None:
    rng = np.random.default_rng(2)
    mean, share = mean_reading(readings(rng, 8, scatter=0.05))
    assert share < 0.01
    np.testing.assert_allclose(mean.covariance_m2, STATED, rtol=0.01)


def test_readings_that_scatter_more_than_stated_say_so_in_their_covariance() -> None:
    rng = np.random.default_rng(3)
    mean, share = mean_reading(readings(rng, 8, scatter=4.0))
    assert 8.0 < share < 30.0
    np.testing.assert_allclose(mean.covariance_m2, STATED * share / 8)


def test_one_reading_is_its_own_mean() -> None:
    mean, _ = mean_reading([reading_at(PLACE)])
    np.testing.assert_array_equal(mean.p_trk_m, PLACE)
    np.testing.assert_array_equal(mean.covariance_m2, STATED)


def test_a_reading_that_lies_apart_is_repeated() -> None:
    good = readings(np.random.default_rng(4), 8)
    bad = reading_at(PLACE + 1e-3)
    bench, tracker = bench_with([*good[:3], bad, *good[3:7], good[7]], n_reflector_readings=8)
    measured = measure_reflectors(bench, ["top_left"])["top_left"]
    expected, _ = mean_reading([*good[:3], good[7], *good[3:7]])
    np.testing.assert_allclose(measured.p_trk_m, expected.p_trk_m, rtol=0, atol=1e-12)
    assert not tracker.script


def test_a_loose_reflector_is_named() -> None:
    rng = np.random.default_rng(5)
    script = [reading_at(PLACE + 1e-3 * rng.standard_normal(3)) for _ in range(60)]
    bench, _ = bench_with(script)
    with pytest.raises(CalibrationError, match="reflector top_left: readings lie apart"):
        measure_reflectors(bench, ["top_left"])


def test_a_lost_beam_is_tried_again_but_not_for_ever() -> None:
    lost = TrackingLostError("beam broken", device="tracker")
    bench, _ = bench_with([lost, lost, reading_at(PLACE)], n_reflector_readings=1)
    assert measure_reflectors(bench, ["top_left"])
    bench, _ = bench_with([lost, lost, lost], n_reflector_readings=1)
    with pytest.raises(TrackingLostError):
        measure_reflectors(bench, ["top_left"])


def test_the_t_mac_is_measured_once_two_looks_agree() -> None:
    bench, tracker = bench_with([pose_at(0.0), pose_at(5e-5), pose_at(1e-5)])
    assert measure_still(bench).trk_from_tmac.translation[0] == 1e-5
    assert tracker.windows_s == [0.5, 0.5, 2.0]


def test_a_t_mac_that_moves_is_not_measured() -> None:
    bench, _ = bench_with([pose_at(0.0), pose_at(1e-3)])
    with pytest.raises(NotSettledError, match=r"moves: 1\.000 mm"):
        measure_still(bench)
