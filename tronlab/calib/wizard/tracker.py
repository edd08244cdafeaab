"""Measuring with the tracker, so that one bad reading does no harm."""

from collections.abc import Iterable, Sequence

import numpy as np
from scipy.stats import chi2

from tronlab.calib.inputs import PointInput, Points
from tronlab.calib.wizard.bench import Bench
from tronlab.devices.readings import PointReading, PoseReading
from tronlab.errors import CalibrationError, NotSettledError
from tronlab.geometry.poses import FloatArray
from tronlab.geometry.uncertainty import pose_difference

_OUTLIER = float(chi2.ppf(0.9999, 3))
"""Squared Mahalanobis distance from the median beyond which a reading is repeated."""
_MAX_REPEATED = 3
"""Readings of one reflector: more are no accident."""
_SCATTER_LEVEL = 0.001
"""Scatter less probable than this is not what the stated covariance says."""
_STILL = float(chi2.ppf(1.0 - 1e-6, 6))
"""Two looks that differ by more, by their covariances, are of a T-MAC that moves."""


def measure_reflectors(bench: Bench, names: Iterable[str]) -> Points:
    """Measure reflectors, each several times; give the means, and the readings with them.

    Raises:
        TrackingLostError: The beam does not reach one of them.
        CalibrationError: The readings of one scatter as those of a reflector that is loose.
    """
    names = tuple(names)
    points: Points = {}
    for i, name in enumerate(names):
        bench.dialogue.advance("reflector", n_done=i, n_all=len(names))
        points[name] = _measure_reflector(bench, name)
    bench.dialogue.advance("reflector", n_done=len(names), n_all=len(names))
    return points


def measure_still(bench: Bench) -> PoseReading:
    """Measure the T-MAC after two looks at it agree.

    Raises:
        NotSettledError: It moves.
        TrackingLostError: The beam does not reach it.
    """
    tracker, settings = bench.devices.tracker, bench.settings
    looks = [tracker.measure_pose(window_s=settings.look_window_s) for _ in range(2)]
    check_still(*looks, device=tracker.name)
    return tracker.measure_pose(window_s=settings.window_s)


def look_again(bench: Bench, reading: PoseReading) -> None:
    """Look whether the T-MAC is still where it was measured.

    Raises:
        NotSettledError: It is not.
    """
    tracker = bench.devices.tracker
    look = tracker.measure_pose(window_s=bench.settings.look_window_s)
    check_still(reading, look, device=tracker.name)


def check_still(first: PoseReading, second: PoseReading, *, device: str) -> None:
    """Raise NotSettledError if two readings differ by more than their covariances explain."""
    difference = pose_difference(first.trk_from_tmac, second.trk_from_tmac)
    covariance = first.covariance + second.covariance
    if difference @ np.linalg.solve(covariance, difference) > _STILL:
        raise NotSettledError(
            f"the T-MAC moves: {np.linalg.norm(difference[3:]) * 1e3:.3f} mm and"
            f" {np.degrees(np.linalg.norm(difference[:3])):.4f} deg between two looks, more than"
            " the stated accuracy explains",
            device=device,
        )


def mean_reading(readings: Sequence[PointReading]) -> tuple[PointReading, float]:
    """Give the mean of several readings of one reflector, and their scatter.

    Averaging helps against what differs from reading to reading. As long as the readings scatter as
    the stated covariance C has it, their errors count as independent, and the mean has C / n. If
    they scatter significantly less, only the share s of the variance that does scatter is
    averaged: (1 - s) C + s C / n. If they scatter more, C is too small and grows by s.

    Args:
        readings: Of one reflector, in any order, at least one.

    Returns:
        The mean with its covariance, and the share s of the stated variance that scatters.
    """
    points = np.array([reading.p_trk_m for reading in readings])
    stated = np.mean([reading.covariance_m2 for reading in readings], axis=0)
    n = len(points)
    deviations = points - points.mean(axis=0)
    dof = 3 * (n - 1)
    chi_square = float(np.einsum("ij,ji->", deviations, np.linalg.solve(stated, deviations.T)))
    share = chi_square / dof if dof else 1.0
    low, high = chi2.ppf([_SCATTER_LEVEL, 1.0 - _SCATTER_LEVEL], dof) if dof else (0.0, np.inf)
    is_as_stated = low <= chi_square <= high
    averaged = 1.0 if is_as_stated else share
    common = max(1.0 - averaged, 0.0)
    mean = PointReading(
        target=readings[0].target,
        p_trk_m=points.mean(axis=0),
        covariance_m2=stated * (common + averaged / n),
        time_s=float(np.mean([reading.time_s for reading in readings])),
    )
    return mean, share


def _measure_reflector(bench: Bench, name: str) -> PointInput:
    readings = [_read_once(bench, name) for _ in range(bench.settings.n_reflector_readings)]
    for _ in range(_MAX_REPEATED + 1):
        outliers = _outliers(readings)
        if not len(outliers):
            break
        for i in outliers:
            bench.dialogue.announce(f"reflector {name}: a reading lies apart, it is repeated")
            readings[i] = _read_once(bench, name)
    else:
        raise CalibrationError(
            f"reflector {name}: readings lie apart again and again, by more than the stated"
            " accuracy; is it seated, is the beam free, does the tracker stand still?"
        )
    mean, share = mean_reading(readings)
    bench.dialogue.announce(
        f"reflector {name}: {len(readings)} readings, they scatter by {np.sqrt(share):.2f} of the"
        f" stated accuracy; sigma {_sigma_um(mean.covariance_m2):.0f} um a coordinate"
    )
    return PointInput.of(mean, readings)


def _read_once(bench: Bench, name: str) -> PointReading:
    return bench.persist(
        f"reflector {name}",
        lambda: bench.devices.tracker.measure_point(name, window_s=bench.settings.window_s),
    )


def _outliers(readings: Sequence[PointReading]) -> list[int]:
    """Give the readings that lie far from the median of all."""
    points = np.array([reading.p_trk_m for reading in readings])
    from_median = points - np.median(points, axis=0)
    return [
        i
        for i, (reading, d) in enumerate(zip(readings, from_median, strict=True))
        if d @ np.linalg.solve(reading.covariance_m2, d) > _OUTLIER
    ]


def _sigma_um(covariance_m2: FloatArray) -> float:
    return float(np.sqrt(np.trace(covariance_m2) / 3)) * 1e6
