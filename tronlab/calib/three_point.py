"""The model frame F_TRS in the tracker's frame, from measured reflectors, and points in it."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.devices.laboratory import ReflectorsSpec
from tronlab.devices.readings import PointReading
from tronlab.errors import CalibrationError
from tronlab.geometry.alignment import frame_from_reflectors
from tronlab.geometry.poses import FloatArray, skew

NAMES = ("top_left", "bottom_left", "top_right")
"""The reflectors that define the frame, in the order of its definition."""
PAIRS = tuple(combinations(NAMES, 2))


@dataclass(frozen=True, slots=True)
class FrameSolution:
    """Where the model frame lies."""

    trs_from_trk: RigidTransform
    covariance: FloatArray
    """Of (rotation vector, translation) in trs, shape (6, 6), rad and m."""
    length_errors_m: dict[str, float]
    """Measured minus nominal distance of each pair of reflectors, keyed ``a-b``."""


def solve_frame(readings: Mapping[str, PointReading], reflectors: ReflectorsSpec) -> FrameSolution:
    """Find the model frame from its three reflectors (paper, section 3.3).

    Args:
        readings: Measured reflectors by name, at least those of ``NAMES``.
        reflectors: Where they are meant to be; only the lengths between them are used.

    Raises:
        CalibrationError: A reflector is missing, mislabelled or out of place; the message names it.
        DegenerateGeometryError: The reflectors are collinear.
    """
    missing = [name for name in NAMES if name not in readings]
    if missing:
        raise CalibrationError(f"F_TRS: reflector {' and '.join(missing)} was not measured")
    points = {name: readings[name].p_trk_m for name in NAMES}
    length_errors_m = _check_lengths(points, reflectors)
    trk_from_trs = frame_from_reflectors(*(points[name] for name in NAMES))
    trs_from_trk = trk_from_trs.inv()
    _check_side(trs_from_trk)
    covariances = [readings[name].covariance_m2 for name in NAMES]
    return FrameSolution(
        trs_from_trk=trs_from_trk,
        covariance=_frame_covariance(trs_from_trk, points, covariances),
        length_errors_m=length_errors_m,
    )


def point_in_trs(reading: PointReading, frame: FrameSolution) -> tuple[FloatArray, FloatArray]:
    """Give a measured point in trs, shape (3,), and its covariance (3, 3) with the frame's."""
    r = frame.trs_from_trk.rotation.as_matrix()
    jacobian = np.hstack([-skew(r @ reading.p_trk_m), np.eye(3)])
    covariance = r @ reading.covariance_m2 @ r.T + jacobian @ frame.covariance @ jacobian.T
    return frame.trs_from_trk.apply(reading.p_trk_m), covariance


def _frame_covariance(
    trs_from_trk: RigidTransform, points: Mapping[str, FloatArray], covariances: list[FloatArray]
) -> FloatArray:
    """Propagate the points' covariances to first order.

    In trs the reflectors lie at (0, 0, 0), (l, 0, 0) and (cx, cy, 0). Moving them by a, b and c
    turns the frame's axes by ((cz - az + wy cx) / cy, -(bz - az) / l, (by - ay) / l).
    """
    length = trs_from_trk.apply(points["bottom_left"])[0]
    cx, cy, _ = trs_from_trk.apply(points["top_right"])
    turn = np.zeros((3, 9))
    turn[2, [1, 4]] = [-1 / length, 1 / length]
    turn[1, [2, 5]] = [1 / length, -1 / length]
    turn[0, [2, 8]] = [-1 / cy, 1 / cy]
    turn[0] += turn[1] * cx / cy
    shift = skew(trs_from_trk.translation) @ turn
    shift[:, :3] -= np.eye(3)
    jacobian = np.vstack([-turn, shift])
    r = trs_from_trk.rotation.as_matrix()
    points_covariance = np.zeros((9, 9))
    for i, covariance in enumerate(covariances):
        points_covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = r @ covariance @ r.T
    return jacobian @ points_covariance @ jacobian.T


def _lengths(points: Mapping[str, FloatArray]) -> FloatArray:
    return np.array([float(np.linalg.norm(points[a] - points[b])) for a, b in PAIRS])


def _check_lengths(
    points: Mapping[str, FloatArray], reflectors: ReflectorsSpec
) -> dict[str, float]:
    nominal = _lengths({name: np.array(p) for name, p in reflectors.points_m.items()})
    tolerance = reflectors.length_tolerance_m
    errors = _lengths(points) - nominal
    is_wrong = np.abs(errors) > tolerance
    if is_wrong.any():
        table = "; ".join(
            f"{a} to {b} {length:.4f} m, nominal {expected:.4f} m"
            for (a, b), length, expected in zip(PAIRS, _lengths(points), nominal, strict=True)
        )
        raise CalibrationError(
            f"F_TRS: {_explain(points, nominal, is_wrong, tolerance)}"
            f" (allowed +-{tolerance * 1e3:g} mm: {table});"
            "\ncheck labels and seats of the reflectors, or correct 'reflectors' in the rig file"
        )
    return {f"{a}-{b}": float(error) for (a, b), error in zip(PAIRS, errors, strict=True)}


def _explain(
    points: Mapping[str, FloatArray],
    nominal: FloatArray,
    is_wrong: NDArray[np.bool_],
    tolerance: float,
) -> str:
    """Say which reflector is to blame for wrong lengths."""
    for names in permutations(NAMES):
        relabelled = {name: points[other] for name, other in zip(NAMES, names, strict=True)}
        if (np.abs(_lengths(relabelled) - nominal) <= tolerance).all():
            wrong = [name for name, other in zip(NAMES, names, strict=True) if name != other]
            return f"reflectors {', '.join(wrong)} are swapped: the lengths fit other labels"
    wrong_pairs = [pair for pair, wrong in zip(PAIRS, is_wrong, strict=True) if wrong]
    if len(wrong_pairs) == 1:
        return f"reflector {' or '.join(wrong_pairs[0])} is out of place"
    common = set(wrong_pairs[0]).intersection(*wrong_pairs[1:])
    if common:
        return f"reflector {common.pop()} is out of place"
    ratios = _lengths(points) / nominal
    if np.ptp(ratios) < 2 * tolerance / nominal.min():
        return f"all lengths are {ratios.mean():.5g} times the nominal ones: wrong unit or scale"
    return "no length between reflectors fits: top_left, bottom_left and top_right are in doubt"


def _check_side(trs_from_trk: RigidTransform) -> None:
    height_m = trs_from_trk.translation[2]
    if height_m <= 0:
        raise CalibrationError(
            f"F_TRS: the tracker would stand {-height_m:.3f} m behind the model, where it sees no"
            " reflector: bottom_left and top_right are swapped"
        )
