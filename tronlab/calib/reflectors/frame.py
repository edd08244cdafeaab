"""The model frame F_TRS in the tracker's frame, from measured reflectors, and points in it."""

from collections.abc import Iterable, Mapping

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import RigidTransform
from scipy.stats import chi2

from tronlab.calib.reflectors.rigid_body import RigidBody, find_fault, find_mixed_units
from tronlab.calib.results import FrameResult, Statistics
from tronlab.devices.laboratory import ReflectorsSpec
from tronlab.devices.readings import PointReading
from tronlab.errors import CalibrationError
from tronlab.geometry.alignment import align_points_weighted, frame_from_reflectors
from tronlab.geometry.poses import FloatArray, skew

NAMES = ("top_left", "bottom_left", "top_right")
"""The reflectors that define the frame, in the order of its definition."""
_CONSTRAINED = np.array([0, 1, 2, 4, 5, 8])
"""Coordinates of the three centres in trs that the definition fixes: x, y, z of the first, y and z
of the second, z of the third."""
_RANGE_M = 160.0
"""Farther than any laser tracker for rooms measures."""
_UNLIKELY = 0.01
"""With a smaller chance of residuals as large as these, the marks are known less well than stated,
and the covariance is scaled to what the residuals say."""


def solve_frame(points: Mapping[str, PointReading], reflectors: ReflectorsSpec) -> FrameResult:
    """Find the model frame from its reflectors.

    Three define it (paper, section 3.3): then their nominal places serve as a check alone. With
    more the frame is the weighted least-squares fit to all nominal marks.

    Args:
        points: Measured centres of the reflectors by name.
        reflectors: The marks, and how high above them the centres are.

    Raises:
        CalibrationError: A reflector is missing, unknown, mislabelled or out of place, the unit is
            wrong, or the frame is left-handed; the message names it. Or the marks of the rig file
            do not lie as the frame is defined.
        DegenerateGeometryError: The reflectors are collinear.
    """
    nominal = nominal_centres(reflectors)
    _check_design(reflectors)
    check_points(points, tuple(nominal))
    measured = {name: points[name].p_trk_m for name in nominal}
    trk_from_trs = _by_definition(measured, reflectors)
    body = RigidBody.of(nominal, measured, tolerance_m=reflectors.length_tolerance_m)
    _check_body(body)
    covariances = np.array([points[name].covariance_m2 for name in nominal])
    if len(nominal) > len(NAMES):
        return _fit(body, covariances)
    trs_from_trk = trk_from_trs.inv()
    residuals_m = trs_from_trk.apply(body.measured_m) - body.nominal_m
    return FrameResult(
        trs_from_trk=trs_from_trk,
        covariance=_definition_covariance(trs_from_trk, body.measured_m, covariances),
        statistics=_statistics(body, residuals_m),
    )


def point_in_trs(reading: PointReading, frame: FrameResult) -> tuple[FloatArray, FloatArray]:
    """Give a measured point in trs, shape (3,), and its covariance (3, 3) with the frame's."""
    r = frame.trs_from_trk.rotation.as_matrix()
    jacobian = moved_by_frame(r @ reading.p_trk_m)
    covariance = r @ reading.covariance_m2 @ r.T + jacobian @ frame.covariance @ jacobian.T
    return frame.trs_from_trk.apply(reading.p_trk_m), covariance


def moved_by_frame(rotated_m: FloatArray) -> FloatArray:
    """Give the derivative (3, 6) of a point in trs by the frame's (rotation vector, translation).

    Args:
        rotated_m: The point from the tracker's origin, axes of trs, shape (3,).
    """
    return np.hstack([-skew(rotated_m), np.eye(3)])


def nominal_centres(reflectors: ReflectorsSpec) -> dict[str, FloatArray]:
    """Give where the centre of each reflector is meant to be, shape (3,), frame trs."""
    heights_m = reflectors.centre_heights_m
    return {
        name: np.array(p_mark) + np.array([0.0, 0.0, heights_m[name]])
        for name, p_mark in reflectors.points_m.items()
    }


def check_points(points: Mapping[str, PointReading], names: tuple[str, ...]) -> None:
    """Return if exactly the reflectors of these names were measured, all in one unit.

    Raises:
        CalibrationError: They were not; the message names the reflector.
    """
    if missing := [name for name in names if name not in points]:
        raise CalibrationError(
            f"F_TRS: reflector {' and '.join(missing)} was not measured;"
            "\nmeasure it, or take it out of 'reflectors' in the rig file"
        )
    if unknown := [name for name in points if name not in names]:
        raise CalibrationError(
            f"F_TRS: reflector {' and '.join(unknown)} is not in the design;"
            f" its reflectors: {', '.join(names)};"
            "\ncorrect the label, or 'reflectors' in the rig file"
        )
    for name in names:
        check_reading(points[name], f"F_TRS: reflector {name}")
    if mixed := find_mixed_units({name: points[name].p_trk_m for name in names}):
        raise CalibrationError(
            f"F_TRS: reflector {', '.join(mixed)} is more than 100 times as far away as the nearest"
            " one: millimetres among metres"
        )


def check_reading(reading: PointReading, what: str) -> None:
    """Return if a point and its covariance can be used.

    Raises:
        CalibrationError: Not finite, or the covariance is none.
    """
    if not np.isfinite(reading.p_trk_m).all():
        raise CalibrationError(f"{what}: was measured at {reading.p_trk_m.tolist()}: not finite")
    check_covariance(reading.covariance_m2, what)


def check_covariance(covariance: FloatArray, what: str) -> None:
    """Return if a matrix is a covariance.

    Raises:
        CalibrationError: It has values that are not finite, is not symmetric, or has a negative
            variance.
    """
    is_symmetric = np.isfinite(covariance).all() and np.allclose(covariance, covariance.T)
    if not is_symmetric or np.linalg.eigvalsh(covariance)[0] < -1e-9 * np.trace(covariance):
        raise CalibrationError(
            f"{what}: {covariance.tolist()} is no covariance: not finite, not symmetric or negative"
        )


def check_weight(covariance: FloatArray, what: str) -> None:
    """Return if a covariance, shape (3, 3), makes a weight.

    Raises:
        CalibrationError: It is singular.
    """
    if np.linalg.matrix_rank(covariance, hermitian=True) < 3:
        raise CalibrationError(
            f"{what}: its covariance {covariance.tolist()} is singular, so the least-squares fit"
            " cannot weigh it;\nstate the accuracy of the tracker"
        )


def check_range(p_trk_m: FloatArray, what: str) -> None:
    """Return if a point lies where a tracker can measure it.

    Raises:
        CalibrationError: It is so far away that it must be in millimetres.
    """
    distance_m = float(np.linalg.norm(p_trk_m))
    if distance_m > _RANGE_M:
        raise CalibrationError(
            f"{what}: is {distance_m:.4g} m from the tracker, which sees {_RANGE_M:g} m at most:"
            " it is in millimetres"
        )


def _check_design(reflectors: ReflectorsSpec) -> None:
    """Return if the marks of the rig file lie as the definition of the frame has them."""
    for name, p_mark in reflectors.points_m.items():
        if max(map(abs, p_mark)) > _RANGE_M:
            raise CalibrationError(
                f"F_TRS: 'reflectors' in the rig file: {name} is at {list(p_mark)} m, farther than"
                f" a tracker sees ({_RANGE_M:g} m at most): it is in millimetres"
            )
    down, right = np.array(reflectors.bottom_left_m), np.array(reflectors.top_right_m)
    off_m = max(*np.abs(down[1:]), abs(right[2]))
    if off_m > reflectors.length_tolerance_m or down[0] < 0.0 or right[1] < 0.0:
        raise CalibrationError(
            f"F_TRS: 'reflectors' in the rig file: bottom_left_m {down.tolist()} must lie on the"
            f" X-axis at x > 0, and top_right_m {right.tolist()} in the X-Y plane at y > 0 (allowed"
            f" +-{reflectors.length_tolerance_m * 1e3:g} mm): these define the frame;"
            "\nare the two swapped?"
        )


def _by_definition(
    measured: Mapping[str, FloatArray], reflectors: ReflectorsSpec
) -> RigidTransform:
    """Give ``trk_from_trs`` by the three reflectors that define it."""
    heights_m = [reflectors.centre_heights_m[name] for name in NAMES]
    return frame_from_reflectors(*(measured[name] for name in NAMES), heights_m=heights_m)


def _check_body(body: RigidBody) -> None:
    fault = find_fault(body)
    if fault is not None:
        raise CalibrationError(
            f"F_TRS: {fault} (allowed +-{body.tolerance_m * 1e3:g} mm);"
            "\ncheck labels and seats of the reflectors, or correct 'reflectors' in the rig file"
        )


def _fit(body: RigidBody, covariances: FloatArray) -> FrameResult:
    """Fit all reflectors, each weighted by its covariance."""
    for name, covariance in zip(body.names, covariances, strict=True):
        check_weight(covariance, f"F_TRS: reflector {name}")
    fit = align_points_weighted(body.nominal_m, body.measured_m, covariances)
    p_value = float(chi2.sf(fit.chi_square, fit.dof))
    scale = fit.chi_square / fit.dof if p_value < _UNLIKELY else 1.0
    return FrameResult(
        trs_from_trk=fit.a_from_b,
        covariance=scale * fit.covariance,
        statistics={
            **_statistics(body, -fit.residuals_m),
            "chi_square": fit.chi_square,
            "dof": fit.dof,
            "p_value": p_value,
            "covariance_scale": scale,
        },
    )


def _definition_covariance(
    trs_from_trk: RigidTransform, measured_m: FloatArray, covariances: FloatArray
) -> FloatArray:
    """Propagate the points' covariances to first order.

    The definition fixes six coordinates of the centres in trs. Errors of the points are undone by
    the errors of the frame that keep these coordinates.
    """
    r = trs_from_trk.rotation.as_matrix()
    by_frame = np.vstack([moved_by_frame(r @ point) for point in measured_m])
    by_points = _block_diagonal([r for _ in measured_m])
    jacobian = np.linalg.solve(by_frame[_CONSTRAINED], by_points[_CONSTRAINED])
    return jacobian @ _block_diagonal(covariances) @ jacobian.T


def _block_diagonal(blocks: Iterable[FloatArray]) -> FloatArray:
    return np.asarray(block_diag(*blocks), dtype=np.float64)


def _statistics(body: RigidBody, residuals_m: FloatArray) -> Statistics:
    """Give what is found at every frame.

    Args:
        body: The reflectors.
        residuals_m: Measured minus nominal centres in trs, shape (n, 3).
    """
    others = [body.changed(order) for order in body.labellings() if body.changed(order)]
    return {
        "n_reflectors": len(body.names),
        "length_errors_m": body.length_errors_m,
        "residuals_m": dict(zip(body.names, residuals_m.tolist(), strict=True)),
        "warnings": [
            f"the labels of {', '.join(names)} could be exchanged unnoticed: by all lengths the"
            " reflectors lie alike"
            for names in others
        ],
    }
