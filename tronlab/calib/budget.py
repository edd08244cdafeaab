"""Error budget: what each step of a calibration contributes to the uncertainty of camera poses.

A pose ``trs_from_cam = trs_from_trk * trk_from_tmac * tmac_from_cam`` is uncertain by the frame, by
the tracker's reading and by the hand-eye transform. To first order their covariances add, so that
each has its share. How far landmarks move in the image by it is what a navigation core is charged
with though it is not its fault; lens and lamp are listed beside for the same reason. The
registration of the terrain model, which no record knows, comes on top in the truth of a dataset.

Every figure is one sigma of a length: the root of the summed variances along its axes.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.calib.camera.projection import project_with_jacobian
from tronlab.calib.camera.projection_uncertainty import projection_sigma_px
from tronlab.calib.record import CalibrationRecord
from tronlab.calib.results import CameraResult, FrameResult, HandEyeResult, LampResult
from tronlab.calib.tracker_accuracy import TrackerAccuracy, tracker_accuracy
from tronlab.devices.laboratory import ReflectorsSpec
from tronlab.errors import CalibrationError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray, pose_along_boresight
from tronlab.geometry.uncertainty import compose_covariance

CONTRIBUTIONS = ("tracker position", "tracker rotation", "frame", "hand-eye")
"""What the pose of a camera is uncertain by, in the order of all arrays."""
SWEEP_RANGES_M = tuple(float(r) for r in np.round(np.arange(0.5, 5.01, 0.1), 1))
"""Where a budget is made for if there is no campaign."""
RELIEF_M = 0.1
"""Height on the model whose shadow is looked at."""
_N_LANDMARKS = 41
"""Landmarks are looked for in so many rows and columns of the image."""
_TOLERANCE_M = 1e-9


@dataclass(frozen=True, slots=True)
class Budget:
    """What contributes how much at each of n poses; contributions as in ``CONTRIBUTIONS``."""

    source: str
    """The record."""
    tracker: TrackerAccuracy
    lever_m: float
    """From T-MAC to camera."""
    range_los_m: FloatArray
    """From the camera to the model's plane along the optical axis, shape (n,)."""
    distance_trk_m: FloatArray
    """From tracker to T-MAC, shape (n,)."""
    position_m: FloatArray
    """Of the camera's centre, shape (n, 4)."""
    rotation_rad: FloatArray
    """Of the camera, shape (n, 4)."""
    image_px: FloatArray
    """How far landmarks on the model move in the image, shape (n, 4)."""
    intrinsics_px: FloatArray
    """How far they move by the intrinsics, what a turn explains apart, shape (n,)."""
    shadow_px: FloatArray
    """How far the shadow of ``RELIEF_M`` moves by the lamp, shape (n,); NaN without lamp."""
    shadow_m: float
    """The same on the model."""

    @property
    def total_position_m(self) -> FloatArray:
        """Get the uncertainty of the camera's centre, shape (n,)."""
        return _root_sum(self.position_m)

    @property
    def total_rotation_rad(self) -> FloatArray:
        """Get the uncertainty of the camera's rotation, shape (n,)."""
        return _root_sum(self.rotation_rad)

    @property
    def total_image_px(self) -> FloatArray:
        """Get how far landmarks move in the image by the pose's uncertainty, shape (n,)."""
        return _root_sum(self.image_px)

    def columns(self) -> dict[str, FloatArray]:
        """Give everything as the columns of a table, with the units in their names."""
        columns = {"range_los_m": self.range_los_m, "distance_trk_m": self.distance_trk_m}
        for unit, factor, values in (
            ("mm", 1e3, self.position_m),
            ("mdeg", np.degrees(1e3), self.rotation_rad),
            ("px", 1.0, self.image_px),
        ):
            for name, column in zip(CONTRIBUTIONS, values.T, strict=True):
                columns[f"{name.replace(' ', '_').replace('-', '_')}_{unit}"] = factor * column
            columns[f"total_{unit}"] = factor * _root_sum(values)
        return {
            **columns,
            "total_pct_los": 100 * self.total_position_m / self.range_los_m,
            "intrinsics_px": self.intrinsics_px,
            "shadow_px": self.shadow_px,
        }


@dataclass(frozen=True, slots=True)
class _Calibration:
    """The parts of a record that a budget needs."""

    frame: FrameResult
    camera: CameraResult
    hand_eye: HandEyeResult
    lamp: LampResult | None
    reflectors: ReflectorsSpec
    tracker: TrackerAccuracy
    rays_cam: FloatArray
    """Directions in which landmarks are looked for, shape (n, 3)."""
    lens_px2: FloatArray
    """Variance of where the intrinsics put them, of both coordinates, shape (n,)."""

    @property
    def p_centre_trs_m(self) -> FloatArray:
        """Get the middle of the model, shape (3,)."""
        return _size_m(self.reflectors) / 2


def error_budget(record: CalibrationRecord, poses: Sequence[RigidTransform]) -> Budget:
    """Make the error budget of camera poses.

    Args:
        record: Must have frame, intrinsics and hand-eye transform, and what they were solved from.
        poses: Camera poses ``trs_from_cam``, at least one; nominal ones will do.

    Raises:
        CalibrationError: The record lacks a part, or a camera does not see the model.
    """
    calibration = _calibration(record)
    rows = [_pose_row(calibration, pose, f"pose {i}") for i, pose in enumerate(poses, start=1)]
    shadow = _shadow_covariance(calibration)
    return Budget(
        source=record.source,
        tracker=calibration.tracker,
        lever_m=float(np.linalg.norm(calibration.hand_eye.tmac_from_cam.translation)),
        range_los_m=np.array([row.range_los_m for row in rows]),
        distance_trk_m=np.array([row.distance_trk_m for row in rows]),
        position_m=np.array([_sigmas(row.covariances[:, 3:, 3:]) for row in rows]),
        rotation_rad=np.array([_sigmas(row.covariances[:, :3, :3]) for row in rows]),
        image_px=np.array([_image_sigmas(row) for row in rows]),
        intrinsics_px=np.sqrt([calibration.lens_px2[row.is_seen].mean() for row in rows]),
        shadow_px=np.array([_rms_sigma(row.by_point, shadow) for row in rows]),
        shadow_m=float(np.sqrt(np.trace(shadow))),
    )


def sweep(record: CalibrationRecord) -> tuple[RigidTransform, ...]:
    """Give camera poses straight before the middle of the model, at ``SWEEP_RANGES_M``.

    Raises:
        CalibrationError: The record does not say where the reflectors are.
    """
    centre, out = _calibration(record).p_centre_trs_m, np.array([0.0, 0.0, 1.0])
    return tuple(
        pose_along_boresight(centre + range_m * out, boresight=-out, right=(0.0, 1.0, 0.0))
        for range_m in SWEEP_RANGES_M
    )


def _calibration(record: CalibrationRecord) -> _Calibration:
    results, measured = record.results, record.inputs.frame
    frame, camera, hand_eye = results.frame, results.camera, results.hand_eye
    if frame is None or camera is None or hand_eye is None or measured is None:
        parts = {"frame": frame, "intrinsics": camera, "hand-eye": hand_eye, "reflectors": measured}
        missing = ", ".join(name for name, part in parts.items() if part is None)
        raise CalibrationError(
            f"calibration record {record.source}: an error budget needs {missing}, which it lacks;"
            f"\nmeasure all parts: tronlab calibrate all --rig RIG.yaml --record {record.source}"
        )
    uv_px = _pixels(camera.camera)
    return _Calibration(
        frame=frame,
        camera=camera,
        hand_eye=hand_eye,
        lamp=results.lamp,
        reflectors=measured.reflectors,
        tracker=tracker_accuracy(record),
        rays_cam=np.column_stack([camera.camera.rays(uv_px), np.ones(len(uv_px))]),
        lens_px2=2 * projection_sigma_px(camera, uv_px) ** 2,
    )


@dataclass(frozen=True, slots=True)
class _PoseRow:
    range_los_m: float
    distance_trk_m: float
    covariances: FloatArray
    """Of ``trs_from_cam``, one a contribution, shape (4, 6, 6)."""
    is_seen: NDArray[np.bool_]
    """Which of the directions meet the model; the n landmarks are there."""
    by_pose: FloatArray
    """How they move by a small (rotation, translation) of the camera in trs, shape (n, 2, 6)."""
    by_point: FloatArray
    """How they move if they move themselves in trs, shape (n, 2, 3)."""


def _pose_row(calibration: _Calibration, trs_from_cam: RigidTransform, what: str) -> _PoseRow:
    frame, hand_eye = calibration.frame, calibration.hand_eye
    camera = calibration.camera.camera
    trk_from_tmac = frame.trs_from_trk.inv() * trs_from_cam * hand_eye.tmac_from_cam.inv()
    distance_m = float(np.linalg.norm(trk_from_tmac.translation))
    is_seen, landmarks = _landmarks(calibration, trs_from_cam)
    range_m = _range_m(trs_from_cam)
    if not np.isfinite(range_m) or not is_seen.any():
        raise CalibrationError(
            f"error budget: {what} at {np.round(trs_from_cam.translation, 3).tolist()} m looks past"
            " the model; its optical axis must meet the plane of the reflectors, and part of the"
            " model must be in view"
        )
    cam_from_trs = trs_from_cam.inv()
    _, by_cam, _ = project_with_jacobian(camera, cam_from_trs.apply(landmarks))
    by_point = by_cam @ cam_from_trs.rotation.as_matrix()
    from_camera = landmarks - trs_from_cam.translation
    return _PoseRow(
        range_los_m=range_m,
        distance_trk_m=distance_m,
        covariances=_contributions(calibration, trk_from_tmac, distance_m),
        is_seen=is_seen,
        by_pose=np.concatenate([np.cross(by_point, from_camera[:, None]), -by_point], axis=2),
        by_point=by_point,
    )


def _contributions(
    calibration: _Calibration, trk_from_tmac: RigidTransform, distance_m: float
) -> FloatArray:
    """Give the covariance of ``trs_from_cam`` by each contribution alone, shape (4, 6, 6)."""
    frame, hand_eye, none = calibration.frame, calibration.hand_eye, np.zeros((6, 6))
    position = calibration.tracker.covariance(distance_m)
    rotation = position.copy()
    position[:3], rotation[3:] = 0.0, 0.0
    trs_from_tmac = frame.trs_from_trk * trk_from_tmac
    of_frame_reading_hand_eye = (
        (none, position, none),
        (none, rotation, none),
        (frame.covariance, none, none),
        (none, none, hand_eye.covariance),
    )
    return np.array(
        [
            compose_covariance(
                trs_from_tmac,
                compose_covariance(frame.trs_from_trk, of_frame, trk_from_tmac, of_reading),
                hand_eye.tmac_from_cam,
                of_hand_eye,
            )
            for of_frame, of_reading, of_hand_eye in of_frame_reading_hand_eye
        ]
    )


def _landmarks(
    calibration: _Calibration, trs_from_cam: RigidTransform
) -> tuple[NDArray[np.bool_], FloatArray]:
    """Give which directions meet the model's plane between its reflectors, and where, (n, 3)."""
    directions = trs_from_cam.rotation.apply(calibration.rays_cam)
    is_towards = (directions[:, 2] < 0) & (trs_from_cam.translation[2] > 0)
    along = np.full(len(directions), np.nan)
    along[is_towards] = -trs_from_cam.translation[2] / directions[is_towards, 2]
    points = trs_from_cam.translation + along[:, None] * directions
    size = _size_m(calibration.reflectors)
    is_seen = ((points >= -_TOLERANCE_M) & (points <= size + _TOLERANCE_M)).all(axis=1)
    return is_seen, points[is_seen]


def _pixels(camera: CameraModel) -> FloatArray:
    """Give pixels all over the image, shape (n, 2)."""
    u = np.linspace(0, camera.width_px - 1, _N_LANDMARKS)
    v = np.linspace(0, camera.height_px - 1, _N_LANDMARKS)
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


def _size_m(reflectors: ReflectorsSpec) -> FloatArray:
    """Give how far the model reaches from the origin of trs, shape (3,)."""
    return np.array([reflectors.bottom_left_m[0], reflectors.top_right_m[1], 0.0])


def _range_m(trs_from_cam: RigidTransform) -> float:
    """Give the distance to the model's plane along the optical axis; NaN if it is not met."""
    slope = float(trs_from_cam.rotation.as_matrix()[2, 2])
    range_m = -float(trs_from_cam.translation[2]) / slope if slope else np.nan
    return range_m if range_m > 0 else np.nan


def _image_sigmas(row: _PoseRow) -> FloatArray:
    return np.array([_rms_sigma(row.by_pose, covariance) for covariance in row.covariances])


def _rms_sigma(jacobians: FloatArray, covariance: FloatArray) -> float:
    """Give one sigma of a length in the image, root mean square over the landmarks."""
    flat = jacobians.reshape(-1, jacobians.shape[2])
    return float(np.sqrt(np.trace(flat.T @ flat @ covariance) / len(jacobians)))


def _shadow_covariance(calibration: _Calibration) -> FloatArray:
    """Give the covariance of where the shadow of ``RELIEF_M`` ends on the model, shape (3, 3)."""
    lamp = calibration.lamp
    if lamp is None:
        return np.full((3, 3), np.nan)
    above_m = float(lamp.p_trs_m[2]) - RELIEF_M
    if above_m <= 0:
        raise CalibrationError(
            f"error budget: the lamp is at z = {lamp.p_trs_m[2]:.3f} m of trs, it must be in front"
            " of the model; see to the reflectors' names, or to the lamp's part of the record"
        )
    top = calibration.p_centre_trs_m + np.array([0.0, 0.0, RELIEF_M])
    by_lamp = np.eye(3)
    by_lamp[:, 2] = (top - lamp.p_trs_m) / above_m
    by_lamp[2] = 0.0
    by_lamp *= -RELIEF_M / above_m
    return by_lamp @ lamp.covariance_m2 @ by_lamp.T


def _sigmas(covariances: FloatArray) -> FloatArray:
    return np.sqrt(np.trace(covariances, axis1=1, axis2=2))


def _root_sum(values: FloatArray) -> FloatArray:
    return np.sqrt((values**2).sum(axis=1))
