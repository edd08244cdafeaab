"""The calibration record: what was measured, what followed from it, and for which rig.

A record is one JSON file a person can read: units stand in the keys, a pose carries both frame
names, every result its covariance, and the raw readings behind the results lie inside.
"""

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.calib.record_json import Fields, format_json, parse_json
from tronlab.devices.readings import DeviceIdentity, PoseReading
from tronlab.errors import CalibrationError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray, xyz_quat_from_pose
from tronlab.geometry.uncertainty import compose_covariance

SCHEMA = "tronlab-calibration"
SCHEMA_VERSION = 2
CAMERA_PARAMETERS = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3")
"""Order of rows and columns of ``camera_covariance``."""
IDENTIFIED_DEVICES = ("camera", "tracker", "tmac")
"""Whose exchange makes a record worthless."""


@dataclass(frozen=True, slots=True)
class CalibrationRecord:
    """The calibrated geometry of one rig, with its uncertainty and everything it came from."""

    rig_name: str
    created_utc: str
    """ISO 8601, ends in Z."""
    software: dict[str, str]
    """Versions of tronlab, Python and the libraries that shape the numbers."""
    devices: dict[str, DeviceIdentity]
    """Of camera, tracker and tmac."""
    camera: CameraModel
    camera_covariance: FloatArray
    """Of ``CAMERA_PARAMETERS``, shape (9, 9)."""
    trs_from_trk: RigidTransform
    trs_from_trk_covariance: FloatArray
    """Of (rotation vector, translation) in trs, shape (6, 6), rad and m; geometry.uncertainty."""
    tmac_from_cam: RigidTransform
    tmac_from_cam_covariance: FloatArray
    """Of (rotation vector, translation) in tmac, shape (6, 6), rad and m."""
    p_lamp_trs_m: FloatArray
    """Centre of the reflector on the lamp's housing, shape (3,), taken for the light itself."""
    p_lamp_trs_covariance_m2: FloatArray
    """Of the reflector, shape (3, 3); how far the light is from it is not known, and not in it."""
    statistics: dict[str, Any]
    """How well the solution fits what was measured; plain values."""
    inputs: dict[str, Any]
    """Raw readings and detections the results follow from; plain values."""

    @classmethod
    def load(cls, path: Path) -> "CalibrationRecord":
        """Read a record.

        Raises:
            CalibrationError: No such file, no record, a damaged one, or one of a newer schema.
        """
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            reason = error.strerror if isinstance(error, OSError) else "is not a text file"
            raise CalibrationError(
                f"calibration record {path}: {reason};\nmake one: tronlab calibrate"
            ) from error
        return cls.from_json(text, source=str(path))

    @classmethod
    def from_json(cls, text: str, *, source: str = "(text)") -> "CalibrationRecord":
        """Read a record from the text of its file; ``source`` is what errors call it.

        Raises:
            CalibrationError: As ``load``.
        """
        fields = Fields(parse_json(text, source), source)
        fields.check_schema(SCHEMA, SCHEMA_VERSION)
        return cls(
            rig_name=fields.text("rig_name"),
            created_utc=fields.text("created_utc"),
            software=fields.texts("software"),
            devices=fields.identities("devices", needed=IDENTIFIED_DEVICES),
            camera=fields.camera("camera"),
            camera_covariance=fields.covariance("camera_covariance", n=len(CAMERA_PARAMETERS)),
            trs_from_trk=fields.pose("trs_from_trk", parent="trs", child="trk"),
            trs_from_trk_covariance=fields.covariance("trs_from_trk.covariance_rad_m", n=6),
            tmac_from_cam=fields.pose("tmac_from_cam", parent="tmac", child="cam"),
            tmac_from_cam_covariance=fields.covariance("tmac_from_cam.covariance_rad_m", n=6),
            p_lamp_trs_m=fields.array("lamp.p_trs_m", shape=(3,)),
            p_lamp_trs_covariance_m2=fields.covariance("lamp.covariance_m2", n=3),
            statistics=fields.mapping("statistics"),
            inputs=fields.mapping("inputs"),
        )

    def to_json(self) -> str:
        """Give the text of the record's file."""
        return format_json(
            {
                "schema": SCHEMA,
                "schema_version": SCHEMA_VERSION,
                "rig_name": self.rig_name,
                "created_utc": self.created_utc,
                "software": self.software,
                "devices": {name: asdict(device) for name, device in self.devices.items()},
                "statistics": self.statistics,
                "camera": self.camera.to_dict(),
                "camera_covariance_of": list(CAMERA_PARAMETERS),
                "camera_covariance": self.camera_covariance.tolist(),
                "trs_from_trk": _pose_json(
                    self.trs_from_trk, self.trs_from_trk_covariance, parent="trs", child="trk"
                ),
                "tmac_from_cam": _pose_json(
                    self.tmac_from_cam, self.tmac_from_cam_covariance, parent="tmac", child="cam"
                ),
                "lamp": {
                    "p_trs_m": self.p_lamp_trs_m.tolist(),
                    "covariance_m2": self.p_lamp_trs_covariance_m2.tolist(),
                },
                "inputs": self.inputs,
            }
        )

    def save(self, path: Path) -> None:
        """Write the record, whole or not at all; folders are made, an existing file is replaced.

        Raises:
            CalibrationError: The file cannot be written.
        """
        part = path.with_name(path.name + ".part")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            part.write_text(self.to_json(), encoding="utf-8")
            os.replace(part, path)
        except OSError as error:
            raise CalibrationError(f"calibration record {path}: {error.strerror}") from error

    def trs_from_cam(self, reading: PoseReading) -> tuple[RigidTransform, FloatArray]:
        """Give where the camera is when the tracker reads this, and how sure that is.

        Returns:
            ``trs_from_cam`` and its covariance, shape (6, 6), rad and m, from those of the
            frame, the reading and the hand-eye transform, taken as independent.
        """
        trs_from_tmac = self.trs_from_trk * reading.trk_from_tmac
        covariance = compose_covariance(
            self.trs_from_trk,
            self.trs_from_trk_covariance,
            reading.trk_from_tmac,
            reading.covariance,
        )
        return trs_from_tmac * self.tmac_from_cam, compose_covariance(
            trs_from_tmac, covariance, self.tmac_from_cam, self.tmac_from_cam_covariance
        )

    def check_rig(self, rig_name: str) -> None:
        """Refuse to serve another rig.

        Raises:
            CalibrationError: The record was made on another rig.
        """
        if rig_name != self.rig_name:
            raise CalibrationError(
                f"calibration record of another rig: it was made on '{self.rig_name}' at"
                f" {self.created_utc}, this rig is '{rig_name}';"
                "\nname this rig's record, or make one: tronlab calibrate"
            )

    def check_devices(self, identities: Mapping[str, DeviceIdentity]) -> None:
        """Refuse to serve devices other than those it was made with.

        Args:
            identities: Of at least camera, tracker and tmac.

        Raises:
            CalibrationError: One of them was exchanged; all that were are named.
        """
        exchanged = [
            f"{name}: record '{self.devices[name]}', now '{identities.get(name, 'none')}'"
            for name in IDENTIFIED_DEVICES
            if name not in identities or not identities[name].is_same_device(self.devices[name])
        ]
        if exchanged:
            raise CalibrationError(
                f"calibration record of other devices, made on '{self.rig_name}' at"
                f" {self.created_utc}: {'; '.join(exchanged)};\nmake a new one: tronlab calibrate"
            )


def _pose_json(
    parent_from_child: RigidTransform, covariance: FloatArray, *, parent: str, child: str
) -> dict[str, Any]:
    return {
        "parent": parent,
        "child": child,
        "xyz_m_quat_xyzw": xyz_quat_from_pose(parent_from_child).tolist(),
        "covariance_of": "rotation vector (rad), translation (m), both in the parent frame",
        "covariance_rad_m": np.asarray(covariance).tolist(),
    }
