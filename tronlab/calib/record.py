"""The calibration record: what was measured, what followed from it, and for which rig.

A record is one JSON file a person can read: units stand in the keys, a pose carries both frame
names, every result its covariance, and the raw readings behind the results lie inside. A part that
was not measured is missing. The signature tells an edited record from one that was calibrated.
"""

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, TypeVar

from scipy.spatial.transform import RigidTransform

from tronlab.calib.inputs import Inputs
from tronlab.calib.record_json import Fields, format_json, parse_json
from tronlab.calib.results import Results
from tronlab.calib.results_json import results_from_json, results_to_json
from tronlab.devices.laboratory import MountingSpec
from tronlab.devices.mounting import Mounting
from tronlab.devices.readings import DeviceIdentity, PoseReading
from tronlab.errors import CalibrationError, ConfigError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray
from tronlab.geometry.uncertainty import compose_covariance
from tronlab.render.photometry import Photometry
from tronlab.yaml_models import parse_mapping

SCHEMA = "tronlab-calibration"
SCHEMA_VERSION = 3

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class CalibrationRecord:
    """The calibrated geometry of one rig, with its uncertainty and everything it came from."""

    rig_name: str
    created_utc: str
    """ISO 8601, ends in Z."""
    software: dict[str, str]
    """Versions of tronlab, Python and the libraries that shape the numbers."""
    devices: dict[str, DeviceIdentity]
    """Of camera, tracker and tmac; of those that were used, if not all parts were measured."""
    results: Results
    inputs: Inputs = field(default_factory=Inputs)
    valid_days: float | None = None
    """How long after its oldest part was measured the record serves; None: without end."""
    source: str = field(default="(new)", compare=False)
    """What errors call the record: its file."""

    @classmethod
    def load(cls, path: Path, *, check_signature: bool = True) -> "CalibrationRecord":
        """Read a record; ``check_signature`` is whether to refuse one that was edited.

        Raises:
            CalibrationError: No such file, no record, a damaged or edited one, or one of another
                schema.
        """
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            reason = error.strerror if isinstance(error, OSError) else "is not a text file"
            raise CalibrationError(
                f"calibration record {path}: {reason};"
                f"\nmake one: tronlab calibrate all --rig RIG.yaml --record {path}"
            ) from error
        return cls.from_json(text, source=str(path), check_signature=check_signature)

    @classmethod
    def from_json(
        cls, text: str, *, source: str = "(text)", check_signature: bool = True
    ) -> "CalibrationRecord":
        """Read a record from the text of its file.

        Args:
            text: The text.
            source: What errors call the record.
            check_signature: Whether to refuse a record that was edited.

        Raises:
            CalibrationError: As ``load``.
        """
        values = parse_json(text, source)
        fields = Fields(values, source)
        fields.check_schema(SCHEMA, SCHEMA_VERSION)
        if check_signature:
            _check_signature(values, source)
        results = results_from_json(fields)
        return cls(
            rig_name=fields.text("rig_name"),
            created_utc=fields.text("created_utc"),
            software=fields.texts("software"),
            devices=fields.identities("devices", needed=()),
            results=results,
            inputs=_inputs(fields, source),
            valid_days=fields.optional_number("valid_days"),
            source=source,
        )

    def to_json(self) -> str:
        """Give the text of the record's file."""
        values: dict[str, Any] = {
            "schema": SCHEMA,
            "schema_version": SCHEMA_VERSION,
            "rig_name": self.rig_name,
            "created_utc": self.created_utc,
            "valid_days": self.valid_days,
            "software": self.software,
            "devices": {name: asdict(device) for name, device in self.devices.items()},
            **results_to_json(self.results),
            "inputs": self.inputs.model_dump(mode="json", exclude_none=True),
        }
        # Read back: what counts is what the file says, and a tuple comes back as a list.
        values = json.loads(format_json(values))
        return format_json({**values, "signature": signature_of(values)})

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

    @property
    def camera(self) -> CameraModel:
        """Get the intrinsics; like all parts, missing ones raise CalibrationError."""
        return self._part(self.results.camera, "intrinsics").camera

    @property
    def trs_from_trk(self) -> RigidTransform:
        """Get where the tracker stands."""
        return self._part(self.results.frame, "frame").trs_from_trk

    @property
    def tmac_from_cam(self) -> RigidTransform:
        """Get where the camera sits on the T-MAC."""
        return self._part(self.results.hand_eye, "hand-eye").tmac_from_cam

    @property
    def p_lamp_trs_m(self) -> FloatArray:
        """Get the centre of the light, shape (3,)."""
        return self._part(self.results.lamp, "lamp").p_trs_m

    @property
    def photometry(self) -> Photometry:
        """Get how the paint of the model reflects light."""
        return self._part(self.results.photometry, "photometry").photometry

    def check_complete(self) -> None:
        """Refuse to serve a campaign without all it needs.

        Robot and photometry are not among that, unless the campaign asks for them.

        Raises:
            CalibrationError: A part is missing.
        """
        for part in (self.camera, self.trs_from_trk, self.tmac_from_cam, self.p_lamp_trs_m):
            del part

    def trs_from_cam(self, reading: PoseReading) -> tuple[RigidTransform, FloatArray]:
        """Give where the camera is when the tracker reads this, and how sure that is.

        Returns:
            ``trs_from_cam`` and its covariance, shape (6, 6), rad and m, from those of the
            frame, the reading and the hand-eye transform, taken as independent.
        """
        frame = self._part(self.results.frame, "frame")
        hand_eye = self._part(self.results.hand_eye, "hand-eye")
        trs_from_tmac = frame.trs_from_trk * reading.trk_from_tmac
        covariance = compose_covariance(
            frame.trs_from_trk, frame.covariance, reading.trk_from_tmac, reading.covariance
        )
        return trs_from_tmac * hand_eye.tmac_from_cam, compose_covariance(
            trs_from_tmac, covariance, hand_eye.tmac_from_cam, hand_eye.covariance
        )

    def mounting(self, nominal: MountingSpec) -> Mounting:
        """Give how to drive to a pose: as calibrated, or as designed if the robot was not."""
        robot = self.results.robot
        if robot is None:
            return nominal.nominal
        return Mounting(
            trs_from_rail=robot.trs_from_rail,
            rail_axis=robot.rail_axis,
            flange_from_cam=robot.flange_from_tmac * self.tmac_from_cam,
            arm_forward_m=nominal.arm_forward_m,
        )

    @property
    def expires_utc(self) -> datetime | None:
        """Get until when the record serves; None: without end."""
        if self.valid_days is None:
            return None
        dates = [*self.inputs.measured_at_rig_utc.values()] or [self.created_utc]
        return min(map(datetime.fromisoformat, dates)) + timedelta(days=self.valid_days)

    def check_validity(self, now: datetime | None = None) -> None:
        """Refuse to serve beyond its time.

        Args:
            now: By default, now.

        Raises:
            CalibrationError: The record has expired; the message says which part is too old.
        """
        expires = self.expires_utc
        if expires is None or (now or datetime.now(UTC)) <= expires:
            return
        dates = self.inputs.measured_at_rig_utc
        oldest = min(dates, key=lambda name: dates[name]) if dates else "all"
        part, measured_utc = oldest.replace("_", "-"), dates.get(oldest, self.created_utc)
        raise CalibrationError(
            f"calibration record {self.source}: expired at {expires:%Y-%m-%d %H:%M} UTC: {part} was"
            f" measured at {measured_utc}, and the record is valid for {self.valid_days:g} days;"
            f"\nmeasure it anew: {measuring_command(part, self.source)}"
        )

    def check_rig(self, rig_name: str) -> None:
        """Refuse to serve another rig.

        Raises:
            CalibrationError: The record was made on another rig.
        """
        if rig_name != self.rig_name:
            raise CalibrationError(
                f"calibration record {self.source}: of another rig: it was made on"
                f" '{self.rig_name}' at {self.created_utc}, this rig is '{rig_name}';"
                "\nname this rig's record, or make one: tronlab calibrate all --rig RIG.yaml"
            )

    def check_devices(self, identities: Mapping[str, DeviceIdentity]) -> None:
        """Refuse to serve devices other than those it was made with.

        Args:
            identities: Of at least camera, tracker and tmac.

        Raises:
            CalibrationError: One of them was exchanged; all that were are named.
        """
        exchanged = [
            f"{name}: record '{device}', now '{identities.get(name, 'none')}'"
            for name, device in self.devices.items()
            if name not in identities or not identities[name].is_same_device(device)
        ]
        if exchanged:
            raise CalibrationError(
                f"calibration record {self.source}: of other devices, made on '{self.rig_name}' at"
                f" {self.created_utc}: {'; '.join(exchanged)};"
                "\nmake a new one: tronlab calibrate all --rig RIG.yaml"
            )

    def _part(self, part: T | None, name: str) -> T:
        if part is None:
            raise CalibrationError(
                f"calibration record {self.source}: has no {name};"
                f"\nmeasure it: {measuring_command(name, self.source)}"
            )
        return part


def measuring_command(part: str, record: str) -> str:
    """Give the command that measures a part of the record in that file."""
    source = "--from DATASET" if part == "photometry" else "--rig RIG.yaml"
    return f"tronlab calibrate {part} {source} --record {record}"


def signature_of(values: Mapping[str, Any]) -> str:
    """Give the hash of a record's plain values, ``signature`` itself left out."""
    unsigned = {name: value for name, value in values.items() if name != "signature"}
    text = json.dumps(unsigned, sort_keys=True, separators=(",", ":"))
    return "sha256:" + hashlib.sha256(text.encode()).hexdigest()


def _check_signature(values: Mapping[str, Any], source: str) -> None:
    if values.get("signature") != signature_of(values):
        raise CalibrationError(
            f"calibration record {source}: signature: does not match: the file was changed after it"
            " was calibrated;\nrestore it, or solve it again from its readings:"
            f" tronlab calibrate rerun {source} --out NEW.json"
        )


def _inputs(fields: Fields, source: str) -> Inputs:
    try:
        return parse_mapping(fields.mapping("inputs"), Inputs, key="inputs")
    except ConfigError as error:
        raise CalibrationError(f"calibration record {source}: {error}") from error
