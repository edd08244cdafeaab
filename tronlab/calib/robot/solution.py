"""Where robot and rail stand in F_TRS, so that a pose of the camera can be driven to.

Only driving rests on this, never the truth: that comes from the tracker at every shot.
"""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.calib.inputs import RobotStationInput
from tronlab.calib.reflectors.frame import check_covariance, check_range
from tronlab.calib.results import FrameResult, RobotResult, Statistics
from tronlab.calib.robot.fit import RobotFit, fit_robot
from tronlab.calib.robot.model import RobotModel, RobotStations
from tronlab.devices.laboratory import MountingSpec
from tronlab.devices.readings import RobotTarget
from tronlab.errors import CalibrationError, DegenerateGeometryError
from tronlab.geometry.poses import FloatArray, pose_along_boresight, rotation_angle_rad, skew

MIN_STATIONS = 6
MIN_RAIL_M = 0.1
"""The rail must move by at least so much."""
MIN_TURN_RAD = np.radians(3.0)
"""Least root mean square of the arm's turns about each of two axes."""
_REACH_M = 10.0
"""No arm is so long: a longer one is in millimetres."""
_SAME_SCALE = 0.1
"""How much a metre of the rail may differ from one of the tracker."""
_LEAST_FORWARD = 0.5
"""Cosine between the rail and x of base: driving takes care of the way along x with the rail."""
_N_PLANNED = 20
_RAIL_MARGIN = 0.02
"""Of the rail's length, left at either end."""
_TILTS_DEG = ((0, 0), (18, 0), (0, 18), (-18, 0), (0, -18), (12, 12), (-12, 12))
_ROLLS_DEG = (0, 18, -18)
_ARM_HEIGHT_M = 1.2
_PLACES_M = ((0.0, 0.0), (-0.25, 0.2), (0.25, -0.2), (0.25, 0.2), (-0.25, -0.2))
"""Of the flange, along y and z of base."""


def solve_robot(
    stations: Sequence[RobotStationInput], frame: FrameResult, mounting: MountingSpec
) -> RobotResult:
    """Find how rail, base and T-MAC are mounted, from encoders and tracker.

    Args:
        stations: With the arm turned about two axes at least, along the rail.
        frame: Where the model frame lies in that set-up of the tracker.
        mounting: As designed: a comparison, which changes nothing.

    Raises:
        DegenerateGeometryError: Too few stations, the rail stood still, or the arm did not turn.
        CalibrationError: Wrong units, or too many stations contradict the others.
    """
    if len(stations) < MIN_STATIONS:
        raise DegenerateGeometryError(
            f"robot: {len(stations)} stations, at least {MIN_STATIONS} needed"
        )
    measured = RobotStations.of(stations)
    _check_geometry(measured)
    _check_values(measured)
    fit = fit_robot(measured)
    _check_rail(fit.model.rail_axis)
    trs_from_rail = frame.trs_from_trk * fit.model.trk_from_rail
    return RobotResult(
        trs_from_rail=trs_from_rail,
        rail_axis=fit.model.rail_axis,
        flange_from_tmac=fit.model.flange_from_tmac,
        covariance=_with_frame(fit, frame),
        statistics={**_statistics(fit), **_from_nominal(fit.model, trs_from_rail, mounting)},
    )


def plan_robot_stations(mounting: MountingSpec) -> tuple[RobotTarget, ...]:
    """Give where to measure: along the whole rail, the arm turned a little about all its axes.

    The camera always looks towards the model within 30 deg, so that the tracker keeps the T-MAC in
    view; the rail only goes forward, because it comes to stand elsewhere from the other side.
    """
    low_m, high_m = mounting.rail_range_m
    margin_m = _RAIL_MARGIN * (high_m - low_m)
    looking = pose_along_boresight(np.zeros(3), boresight=[0, 0, -1], right=[0, 1, 0])
    base_from_flange = mounting.nominal.robot_target(looking).base_from_flange.rotation
    rails_m = np.linspace(low_m + margin_m, high_m - margin_m, _N_PLANNED)
    return tuple(
        RobotTarget(float(rail_m), _arm_pose(i, base_from_flange, mounting.arm_forward_m))
        for i, rail_m in enumerate(rails_m)
    )


def _arm_pose(i: int, looking: Rotation, forward_m: float) -> RigidTransform:
    """Give ``base_from_flange``; turns and places run through cycles of different length."""
    tilt_y, tilt_z = _TILTS_DEG[i % len(_TILTS_DEG)]
    turn = Rotation.from_euler(
        "xyz", (_ROLLS_DEG[i % len(_ROLLS_DEG)], tilt_y, tilt_z), degrees=True
    )
    aside_m, up_m = _PLACES_M[i % len(_PLACES_M)]
    place = np.array([forward_m, aside_m, _ARM_HEIGHT_M + up_m])
    return RigidTransform.from_components(place, turn * looking)


def _check_geometry(stations: RobotStations) -> None:
    travel_m = float(np.ptp(stations.rail_m))
    if travel_m < MIN_RAIL_M:
        raise DegenerateGeometryError(
            f"robot: the rail moved by {travel_m:.4f} m (at least {MIN_RAIL_M:g} m needed): its"
            " direction and scale are not determined; measure along the rail"
        )
    arms = stations.base_from_flange.rotation
    turns = (arms * arms.mean().inv()).as_rotvec()
    _, spread, axes = np.linalg.svd(turns / np.sqrt(len(turns)))
    if spread[1] < MIN_TURN_RAD:
        turned = f"about one axis ({', '.join(f'{v:.2f}' for v in axes[0])}) of base only"
        turned = turned if spread[0] >= MIN_TURN_RAD else f"by {np.degrees(spread[0]):.2f} deg"
        raise DegenerateGeometryError(
            f"robot: the arm turned {turned} (at least {np.degrees(MIN_TURN_RAD):.0f} deg about two"
            " axes needed): the place of the T-MAC on the flange is not determined;"
            " turn the arm about two axes"
        )


def _check_values(stations: RobotStations) -> None:
    for i, p_trk_m in enumerate(stations.trk_from_tmac.translation):
        check_covariance(stations.covariances[i], f"robot: station {i}: T-MAC")
        check_range(p_trk_m, f"robot: station {i}: T-MAC")
    reaches_m = np.linalg.norm(stations.base_from_flange.translation, axis=1)
    i = int(reaches_m.argmax())
    if reaches_m[i] > _REACH_M:
        raise CalibrationError(
            f"robot: station {i}: the flange is {reaches_m[i]:.4g} m from the base (at most"
            f" {_REACH_M:g} m): it is in millimetres"
        )


def _check_rail(axis: FloatArray) -> None:
    scale = float(np.linalg.norm(axis))
    if abs(scale - 1.0) > _SAME_SCALE:
        raise CalibrationError(
            f"robot: for 1 m of the rail's encoder the base moves by {scale:.5g} m (allowed 1 m"
            f" +-{_SAME_SCALE:.0%}): the encoder's unit is wrong"
        )
    if abs(axis[0]) < _LEAST_FORWARD * scale:
        raise CalibrationError(
            "robot: the rail runs along"
            f" ({', '.join(f'{value:.3f}' for value in axis)}) of base, it must run along x;"
            "\nturn the robot's base frame, or correct what the robot's driver takes for it"
        )


def _with_frame(fit: RobotFit, frame: FrameResult) -> FloatArray:
    """Take the covariance from trk to trs, and add that of the frame."""
    r = frame.trs_from_trk.rotation.as_matrix()
    turned = np.asarray(block_diag(r, r, np.eye(9)), dtype=np.float64)
    covariance = turned @ fit.covariance @ turned.T
    lever = skew(r @ fit.model.trk_from_rail.translation)
    by_frame = np.block([[np.eye(3), np.zeros((3, 3))], [-lever, np.eye(3)]])
    covariance[:6, :6] += by_frame @ frame.covariance @ by_frame.T
    return covariance


def _statistics(fit: RobotFit) -> Statistics:
    residuals_m = np.linalg.norm(fit.residuals[:, 3:], axis=1)
    held_out_m = np.linalg.norm(fit.held_out[:, 3:], axis=1)
    held_out_rad = np.linalg.norm(fit.held_out[:, :3], axis=1)
    return {
        "n_stations": len(fit.is_used),
        "outliers": np.flatnonzero(~fit.is_used).tolist(),
        "repeatability_sigma_m": fit.noise.sigma_m,
        "repeatability_sigma_rad": fit.noise.sigma_rad,
        "residuals_m": residuals_m.tolist(),
        "held_out_rms_m": float(np.sqrt((held_out_m**2).mean())),
        "held_out_max_m": float(held_out_m.max()),
        "held_out_rms_rad": float(np.sqrt((held_out_rad**2).mean())),
    }


def _from_nominal(
    model: RobotModel, trs_from_rail: RigidTransform, mounting: MountingSpec
) -> Statistics:
    """Say how far all stands from the design."""
    rail, tmac = mounting.trs_from_rail.pose, mounting.flange_from_tmac.pose
    return {
        "rail_from_nominal_m": _distance_m(rail, trs_from_rail),
        "rail_from_nominal_rad": rotation_angle_rad(rail, trs_from_rail),
        "tmac_from_nominal_m": _distance_m(tmac, model.flange_from_tmac),
        "tmac_from_nominal_rad": rotation_angle_rad(tmac, model.flange_from_tmac),
    }


def _distance_m(a: RigidTransform, b: RigidTransform) -> float:
    return float(np.linalg.norm(a.translation - b.translation))
