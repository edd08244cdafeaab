"""Poses, priors, cameras and results in the headers of messages, and back."""

from collections.abc import Mapping
from typing import Any, TypeAlias, cast, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.errors import FrameError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray, pose_from_xyz_quat, xyz_quat_from_pose
from tronlab.nav.answers import checked
from tronlab.nav.core import NavigationResult, PosePrior, Status
from tronlab.nav.foreign.messages import AnyArray, Message, brief

Json: TypeAlias = dict[str, Any]
N_USUAL_DISTORTION = 5
_QUATERNION_TOLERANCE = 1e-3
_COUNTS = ("n_features", "n_matches", "n_inliers")
_DURATIONS = ("time_detect_s", "time_match_s", "time_pose_s")


def pose_to_json(trs_from_cam: RigidTransform) -> Json:
    """Give a pose as the header has it."""
    xyz_quat = xyz_quat_from_pose(trs_from_cam).tolist()
    return {
        "parent": "trs",
        "child": "cam",
        "position_m": xyz_quat[:3],
        "quaternion_xyzw": xyz_quat[3:],
    }


def pose_from_json(value: object) -> RigidTransform:
    """Read ``trs_from_cam``.

    Raises:
        ValueError: It is of other frames, or no pose.
    """
    pose = _object("pose", value)
    frames = pose.get("parent"), pose.get("child")
    if frames != ("trs", "cam"):
        raise ValueError(
            f"the pose has parent {brief(frames[0])} and child {brief(frames[1])};"
            " it must be trs_from_cam: parent 'trs', child 'cam'"
        )
    xyz = _numbers("position_m", pose.get("position_m"), 3)
    quaternion = _numbers("quaternion_xyzw", pose.get("quaternion_xyzw"), 4)
    try:
        return pose_from_xyz_quat([*xyz, *quaternion], tolerance=_QUATERNION_TOLERANCE)
    except FrameError as error:
        raise ValueError(f"{error}: position_m {xyz}, quaternion_xyzw {quaternion}") from error


def camera_to_json(camera: CameraModel) -> Json:
    """Give a camera; the rational terms of its distortion only where it has them."""
    values = camera.to_dict()
    if not any(camera.distortion[N_USUAL_DISTORTION:]):
        values["distortion"] = values["distortion"][:N_USUAL_DISTORTION]
    return values


def prior_to_json(prior: PosePrior | None) -> Json | None:
    """Give a prior, or null."""
    if prior is None:
        return None
    return {
        "pose": pose_to_json(prior.trs_from_cam),
        "covariance": np.asarray(prior.covariance, np.float64).ravel().tolist(),
    }


def prior_from_json(value: object) -> PosePrior | None:
    """Read a prior.

    Raises:
        ValueError: It is none.
    """
    if value is None:
        return None
    prior = _object("prior", value)
    covariance = _matrix("covariance", prior.get("covariance"))
    if covariance is None:
        raise ValueError("the prior has no covariance")
    return PosePrior(pose_from_json(prior.get("pose")), covariance)


def result_to_json(result: NavigationResult, number: int) -> tuple[Json, dict[str, AnyArray]]:
    """Give header and arrays of a result."""
    header: Json = {
        "type": "result",
        "number": number,
        "status": result.status,
        "reason": result.reason,
        "database": result.database,
        **{name: int(getattr(result, name)) for name in _COUNTS},
        **{name: float(getattr(result, name)) for name in _DURATIONS if getattr(result, name)},
    }
    if result.trs_from_cam is not None:
        header["pose"] = pose_to_json(result.trs_from_cam)
    for name in ("covariance", "bound"):
        if (matrix := getattr(result, name)) is not None:
            header[name] = np.asarray(matrix, np.float64).ravel().tolist()
    arrays: dict[str, AnyArray] = {}
    if len(result.uv_inliers):
        arrays["uv_inliers"] = np.asarray(result.uv_inliers, np.float64)
    if len(result.landmark_inliers):
        arrays["landmark_inliers"] = np.asarray(result.landmark_inliers, np.int64)
    return header, arrays


def result_from_message(message: Message, *, waited_s: float) -> NavigationResult:
    """Read a result.

    Args:
        message: Of type ``result``.
        waited_s: Time it took; of the pose, if the core measured nothing itself.

    Raises:
        ValueError: Something in it cannot be; the message names it.
        MessageError: Its arrays are described wrongly.
    """
    header, arrays = message.header, message.arrays()
    status = header.get("status")
    if status not in get_args(Status):
        raise ValueError(f"status is {brief(status)}, must be {', '.join(get_args(Status))}")
    durations: Json = {name: header[name] for name in _DURATIONS if header.get(name) is not None}
    if not any(durations.values()):
        durations = {"time_pose_s": waited_s}
    counts: Json = {name: header[name] for name in _COUNTS if header.get(name) is not None}
    return checked(
        NavigationResult(
            cast(Status, status),
            pose_from_json(header.get("pose")) if status == "ok" else None,
            covariance=_matrix("covariance", header.get("covariance")),
            bound=_matrix("bound", header.get("bound")),
            uv_inliers=arrays.get("uv_inliers", np.empty((0, 2))).astype(np.float64),
            landmark_inliers=_landmarks(arrays),
            database=_text(header, "database"),
            reason=_text(header, "reason"),
            **counts,
            **durations,
        )
    )


def _landmarks(arrays: Mapping[str, AnyArray]) -> NDArray[np.intp]:
    landmarks = arrays.get("landmark_inliers", np.empty(0, np.intp))
    if landmarks.dtype.kind not in "iu":
        raise ValueError(f"landmark_inliers are {landmarks.dtype}, must be whole numbers")
    return landmarks.astype(np.intp)


def _text(header: Mapping[str, object], name: str) -> str:
    value = header.get(name)
    if value is not None and not isinstance(value, str):
        raise ValueError(f"{name} is {brief(value)}, must be text")
    return value or ""


def _matrix(name: str, value: object) -> FloatArray | None:
    if value is None:
        return None
    return np.array(_numbers(name, value, 36), np.float64).reshape(6, 6)


def _object(name: str, value: object) -> Mapping[str, object]:
    if not isinstance(value, dict):
        raise ValueError(f"{name} is {brief(value)}, must be an object")
    return cast(Mapping[str, object], value)


def _numbers(name: str, value: object, n: int) -> list[float]:
    values = cast(list[object], value) if isinstance(value, list) else []
    if len(values) != n or not all(
        isinstance(number, int | float) and not isinstance(number, bool) for number in values
    ):
        raise ValueError(f"{name} is {brief(value)}, must be {n} numbers")
    try:
        return [float(cast(float, number)) for number in values]
    except OverflowError:
        raise ValueError(f"{name} is {brief(value)}: no such large numbers") from None
