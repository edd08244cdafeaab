"""The results of a calibration in the record's file: units in the keys, frames in the poses."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

from scipy.spatial.transform import RigidTransform

from tronlab.calib.camera.projection import (
    DISTORTION_MODELS,
    INTRINSICS,
    N_INTRINSICS,
    DistortionModel,
)
from tronlab.calib.record_json import Fields
from tronlab.calib.results import (
    CameraResult,
    FrameResult,
    HandEyeResult,
    LampResult,
    PhotometryResult,
    Results,
    RobotResult,
)
from tronlab.geometry.poses import xyz_quat_from_pose

T = TypeVar("T")

_POSE_COVARIANCE = "rotation vector (rad), translation (m), both in the parent frame"


def results_to_json(results: Results) -> dict[str, Any]:
    """Give the parts that there are as plain values."""
    parts = {
        "frame": _present(_frame_to_json, results.frame),
        "camera": _present(_camera_to_json, results.camera),
        "hand_eye": _present(_hand_eye_to_json, results.hand_eye),
        "lamp": _present(_lamp_to_json, results.lamp),
        "robot": _present(_robot_to_json, results.robot),
        "photometry": _present(_photometry_to_json, results.photometry),
    }
    return {name: part for name, part in parts.items() if part is not None}


def results_from_json(fields: Fields) -> Results:
    """Read the parts that there are.

    Raises:
        CalibrationError: A part makes no sense; the message names the key.
    """
    return Results(
        frame=_frame(fields) if fields.has("frame") else None,
        camera=_camera(fields) if fields.has("camera") else None,
        hand_eye=_hand_eye(fields) if fields.has("hand_eye") else None,
        lamp=_lamp(fields) if fields.has("lamp") else None,
        robot=_robot(fields) if fields.has("robot") else None,
        photometry=_photometry(fields) if fields.has("photometry") else None,
    )


def _present(to_json: Callable[[T], dict[str, Any]], part: T | None) -> dict[str, Any] | None:
    return None if part is None else to_json(part)


def _frame_to_json(part: FrameResult) -> dict[str, Any]:
    return {
        "trs_from_trk": _pose(part.trs_from_trk, parent="trs", child="trk"),
        "covariance_of": _POSE_COVARIANCE,
        "covariance_rad_m": part.covariance.tolist(),
        "statistics": part.statistics,
    }


def _frame(fields: Fields) -> FrameResult:
    return FrameResult(
        trs_from_trk=fields.pose("frame.trs_from_trk", parent="trs", child="trk"),
        covariance=fields.covariance("frame.covariance_rad_m", n=6),
        statistics=fields.mapping("frame.statistics"),
    )


def _camera_to_json(part: CameraResult) -> dict[str, Any]:
    return {
        "model": part.model,
        "intrinsics": part.camera.to_dict(),
        "covariance_of": list(INTRINSICS),
        "covariance": part.covariance.tolist(),
        "board_bow_m": part.bow_m.tolist(),
        "statistics": part.statistics,
    }


def _camera(fields: Fields) -> CameraResult:
    model = fields.one_of("camera.model", DISTORTION_MODELS)
    return CameraResult(
        camera=fields.camera("camera.intrinsics"),
        covariance=fields.covariance("camera.covariance", n=N_INTRINSICS),
        model=cast("DistortionModel", model),
        bow_m=fields.array("camera.board_bow_m", shape=(3,)),
        statistics=fields.mapping("camera.statistics"),
    )


def _hand_eye_to_json(part: HandEyeResult) -> dict[str, Any]:
    return {
        "tmac_from_cam": _pose(part.tmac_from_cam, parent="tmac", child="cam"),
        "covariance_of": _POSE_COVARIANCE,
        "covariance_rad_m": part.covariance.tolist(),
        "statistics": part.statistics,
    }


def _hand_eye(fields: Fields) -> HandEyeResult:
    return HandEyeResult(
        tmac_from_cam=fields.pose("hand_eye.tmac_from_cam", parent="tmac", child="cam"),
        covariance=fields.covariance("hand_eye.covariance_rad_m", n=6),
        statistics=fields.mapping("hand_eye.statistics"),
    )


def _lamp_to_json(part: LampResult) -> dict[str, Any]:
    return {
        "p_trs_m": part.p_trs_m.tolist(),
        "covariance_m2": part.covariance_m2.tolist(),
        "statistics": part.statistics,
    }


def _lamp(fields: Fields) -> LampResult:
    return LampResult(
        p_trs_m=fields.array("lamp.p_trs_m", shape=(3,)),
        covariance_m2=fields.covariance("lamp.covariance_m2", n=3),
        statistics=fields.mapping("lamp.statistics"),
    )


def _robot_to_json(part: RobotResult) -> dict[str, Any]:
    return {
        "trs_from_rail": _pose(part.trs_from_rail, parent="trs", child="rail"),
        "rail_axis_m_per_m": part.rail_axis.tolist(),
        "flange_from_tmac": _pose(part.flange_from_tmac, parent="flange", child="tmac"),
        "covariance_of": "trs_from_rail (6), rail_axis (3), flange_from_tmac (6); rad and m",
        "covariance_rad_m": part.covariance.tolist(),
        "statistics": part.statistics,
    }


def _robot(fields: Fields) -> RobotResult:
    return RobotResult(
        trs_from_rail=fields.pose("robot.trs_from_rail", parent="trs", child="rail"),
        rail_axis=fields.array("robot.rail_axis_m_per_m", shape=(3,)),
        flange_from_tmac=fields.pose("robot.flange_from_tmac", parent="flange", child="tmac"),
        covariance=fields.covariance("robot.covariance_rad_m", n=15),
        statistics=fields.mapping("robot.statistics"),
    )


def _photometry_to_json(part: PhotometryResult) -> dict[str, Any]:
    return {
        "function": part.photometry.model_dump(mode="json"),
        "weight_sigma": part.weight_sigma,
        "statistics": part.statistics,
    }


def _photometry(fields: Fields) -> PhotometryResult:
    return PhotometryResult(
        photometry=fields.photometry("photometry"),
        weight_sigma=float(fields.array("photometry.weight_sigma", shape=())),
        statistics=fields.mapping("photometry.statistics"),
    )


def _pose(parent_from_child: RigidTransform, *, parent: str, child: str) -> dict[str, Any]:
    numbers = xyz_quat_from_pose(parent_from_child).tolist()
    return {"parent": parent, "child": child, "xyz_m_quat_xyzw": numbers}
