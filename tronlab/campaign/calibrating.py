"""Measuring a rig's calibration: from its devices to a record."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime

from tronlab.calib import wizard
from tronlab.calib.inputs import Inputs, PartName
from tronlab.calib.record import CalibrationRecord
from tronlab.calib.results import Results
from tronlab.calib.wizard import Dialogue
from tronlab.campaign.provenance import software_versions
from tronlab.campaign.rig import Rig
from tronlab.devices.laboratory import LaboratorySpec, MountingSpec
from tronlab.devices.mounting import Mounting
from tronlab.devices.readings import DeviceIdentity
from tronlab.devices.registry import Devices, connected
from tronlab.errors import CalibrationError

__all__ = ["NotReadyToMeasureError", "draft_of", "measure_parts"]


class NotReadyToMeasureError(CalibrationError):
    """The person who was asked does not want the measurement to begin."""


def measure_parts(
    parts: Sequence[PartName],
    rig: Rig,
    before: CalibrationRecord | None,
    *,
    dialogue: Dialogue,
    seed: int,
    keep: Callable[[CalibrationRecord], None],
) -> CalibrationRecord:
    """Measure parts of a rig's calibration.

    Args:
        parts: Which.
        rig: The rig; its devices are connected for the time.
        before: The record whose other parts stay; None: there is none.
        dialogue: The person at the rig.
        seed: Of the measurement noise of simulated devices.
        keep: Is given a draft with all that was measured so far, again and again.

    Returns:
        The record, not saved yet.

    Raises:
        NotReadyToMeasureError: The person does not want to.
        CalibrationError: A device was exchanged since ``before``, or what was measured makes no
            sense.
        DeviceError: A device failed.
    """
    # A session of its own for each set of parts: simulated devices then measure with other noise.
    devices = rig.open_devices(seed, session=f"calibration of {', '.join(parts)}")
    needed = wizard.devices_needed(parts)
    with connected(devices, needed):
        draft = draft_of(
            rig.name,
            before,
            _identities(parts, devices),
            valid_days=rig.config.calibration.valid_days,
        )
        laboratory = rig.config.laboratory
        _see_that_all_is_ready(dialogue, parts, laboratory, is_moving="robot" in needed)
        mounting = _mounting(before, laboratory.mounting)
        bench = wizard.Bench(devices, laboratory, dialogue, mounting)
        return wizard.calibrate(tuple(parts), bench, draft, keep=keep)


def draft_of(
    rig_name: str,
    before: CalibrationRecord | None,
    identities: Mapping[str, DeviceIdentity],
    *,
    valid_days: float | None,
) -> CalibrationRecord:
    """Give the record to be, without results: that of before, if its devices are still the same.

    Raises:
        CalibrationError: A device was exchanged since.
    """
    devices = dict(identities)
    if before is not None:
        used_before = {name: one for name, one in before.devices.items() if name in identities}
        replace(before, devices=used_before).check_devices(identities)
        devices = {**before.devices, **identities}
    return CalibrationRecord(
        rig_name=rig_name,
        created_utc=f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}",
        software=software_versions(),
        devices=devices,
        results=Results(),
        inputs=before.inputs if before is not None else Inputs(),
        valid_days=valid_days,
    )


def _see_that_all_is_ready(
    dialogue: Dialogue,
    parts: Sequence[PartName],
    laboratory: LaboratorySpec,
    *,
    is_moving: bool,
) -> None:
    """Say what must be prepared, and ask whether it is.

    Raises:
        NotReadyToMeasureError: It is not.
    """
    if {"frame", "lamp", "robot"}.intersection(parts):
        targets = [*laboratory.reflectors.points_m, *(["lamp"] if "lamp" in parts else [])]
        dialogue.announce(
            f"Seat the reflectors: {', '.join(targets)}; keep the tracker's beam free."
        )
    move = "The robot will move; you are asked before each move. " if is_moving else ""
    if not dialogue.confirm(f"{move}Go on?"):
        raise NotReadyToMeasureError("nothing was measured: not ready")


def _identities(parts: Sequence[PartName], devices: Devices) -> dict[str, DeviceIdentity]:
    """Ask the devices that a record is bound to, as far as these parts use them."""
    identities: dict[str, DeviceIdentity] = {}
    if {"intrinsics", "hand_eye"}.intersection(parts):
        identities["camera"] = devices.camera.identify()
    if set(parts) != {"intrinsics"}:
        identities["tracker"] = devices.tracker.identify()
    if {"robot", "hand_eye"}.intersection(parts):
        identities["tmac"] = devices.tracker.identify_target()
    return identities


def _mounting(before: CalibrationRecord | None, nominal: MountingSpec) -> Mounting:
    """Give how to drive: as calibrated, if both robot and hand-eye transform were."""
    if before is None or before.results.robot is None or before.results.hand_eye is None:
        return nominal.nominal
    return before.mounting(nominal)
