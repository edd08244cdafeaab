"""Measuring at a rig, or reading files: from a command's arguments to a saved record."""

import sys
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from tronlab.cli.calibration_files import (
    Keep,
    journal,
    load_existing,
    record_path,
    refuse_existing,
    save_record,
)
from tronlab.cli.exit_codes import INTERRUPTED

if TYPE_CHECKING:
    from tronlab.calib.inputs import PartName
    from tronlab.calib.record import CalibrationRecord
    from tronlab.calib.wizard import Dialogue
    from tronlab.campaign.rig import Rig
    from tronlab.devices.laboratory import LaboratorySpec, MountingSpec
    from tronlab.devices.mounting import Mounting
    from tronlab.devices.readings import DeviceIdentity
    from tronlab.devices.registry import Devices


def measure_all(rig_path: Path, record: Path | None, *, yes: bool, seed: int, force: bool) -> None:
    """Measure every part of a rig's calibration and save the record.

    Raises:
        CalibrationError: There is a record already, or what was measured makes no sense.
        DeviceError: A device failed.
    """
    from tronlab.calib.wizard import ALL_PARTS
    from tronlab.campaign.rig import load_rig

    rig = load_rig(rig_path)
    path = record_path(record, rig.name)
    refuse_existing(path, force=force)
    _measure_and_save(ALL_PARTS, rig, path, None, yes=yes, seed=seed)


def measure_part(
    part: "PartName", rig_path: Path, record: Path | None, *, yes: bool, seed: int
) -> None:
    """Measure one part of a rig's calibration; a record that exists keeps its other parts.

    Raises:
        CalibrationError: The record is another rig's, or what was measured makes no sense.
        DeviceError: A device failed.
    """
    from tronlab.campaign.rig import load_rig

    rig = load_rig(rig_path)
    path = record_path(record, rig.name)
    _measure_and_save((part,), rig, path, load_existing(path, rig.name), yes=yes, seed=seed)


def solve_files(path: Path, rig_name: str, **parts: Any) -> None:
    """Solve what was read from files; a record that exists keeps its other parts.

    Args:
        path: File of the record.
        rig_name: Whose it is.
        parts: What was read, by the names of ``Inputs``.

    Raises:
        CalibrationError: The record is another rig's, or what was read determines no answer.
    """
    from tronlab.calib.solve import solve

    draft = _draft(rig_name, load_existing(path, rig_name), {}, valid_days=None)
    inputs = draft.inputs.with_parts(**parts)
    finish(replace(draft, inputs=inputs, results=solve(inputs)), path)


def finish(record: "CalibrationRecord", path: Path) -> None:
    """Save a record and show what it is worth."""
    from tronlab.cli.calibration_verdict import verdict
    from tronlab.report.calibration import write_pictures

    kept = save_record(record, path)
    typer.echo(verdict(record))
    pictures = write_pictures(record, path.with_name(f"{path.stem}_pictures"))
    if pictures:
        typer.echo(f"pictures: {len(pictures)} in {pictures[0].parent}")
    if kept:
        typer.echo(f"the record before is kept in {kept}")
    typer.echo(path)


def _measure_and_save(
    parts: "tuple[PartName, ...]",
    rig: "Rig",
    path: Path,
    before: "CalibrationRecord | None",
    *,
    yes: bool,
    seed: int,
) -> None:
    try:
        with journal(path) as keep:
            finish(_measure(parts, rig, before, yes=yes, seed=seed, keep=keep), path)
    except KeyboardInterrupt:
        typer.echo("interrupted", err=True)
        raise typer.Exit(INTERRUPTED) from None


def _measure(
    parts: "tuple[PartName, ...]",
    rig: "Rig",
    before: "CalibrationRecord | None",
    *,
    yes: bool,
    seed: int,
    keep: Keep,
) -> "CalibrationRecord":
    from tronlab.calib.wizard import Bench, calibrate, devices_needed
    from tronlab.devices.registry import connected

    # A session of its own for each set of parts: simulated devices then measure with other noise.
    devices = rig.open_devices(seed, session=f"calibration of {', '.join(parts)}")
    needed = devices_needed(parts)
    with _dialogue(yes=yes) as dialogue, connected(devices, needed):
        draft = _draft(
            rig.name,
            before,
            _identities(parts, devices),
            valid_days=rig.config.calibration.valid_days,
        )
        laboratory = rig.config.laboratory
        if not _is_ready(dialogue, parts, laboratory, is_moving="robot" in needed):
            raise typer.Abort
        bench = Bench(devices, laboratory, dialogue, _mounting(before, laboratory.mounting))
        return calibrate(parts, bench, draft, keep=keep)


def _is_ready(
    dialogue: "Dialogue",
    parts: "tuple[PartName, ...]",
    laboratory: "LaboratorySpec",
    *,
    is_moving: bool,
) -> bool:
    """Say what must be prepared, and ask whether it is."""
    if {"frame", "lamp", "robot"}.intersection(parts):
        targets = [*laboratory.reflectors.points_m, *(["lamp"] if "lamp" in parts else [])]
        dialogue.announce(
            f"Seat the reflectors: {', '.join(targets)}; keep the tracker's beam free."
        )
    move = "The robot will move; you are asked before each move. " if is_moving else ""
    return dialogue.confirm(f"{move}Go on?")


@contextmanager
def _dialogue(*, yes: bool) -> "Generator[Dialogue]":
    from tronlab.calib.wizard import Unattended
    from tronlab.campaign.live import open_live
    from tronlab.cli.terminal import TerminalDialogue

    if not yes:
        yield TerminalDialogue()
        return
    with open_live(sys.stderr) as live:
        yield Unattended(live)


def _identities(parts: "tuple[PartName, ...]", devices: "Devices") -> "dict[str, DeviceIdentity]":
    """Ask the devices that a record is bound to, as far as these parts use them."""
    identities: dict[str, DeviceIdentity] = {}
    if {"intrinsics", "hand_eye"}.intersection(parts):
        identities["camera"] = devices.camera.identify()
    if set(parts) != {"intrinsics"}:
        identities["tracker"] = devices.tracker.identify()
    if {"robot", "hand_eye"}.intersection(parts):
        identities["tmac"] = devices.tracker.identify_target()
    return identities


def _draft(
    rig_name: str,
    before: "CalibrationRecord | None",
    identities: "Mapping[str, DeviceIdentity]",
    *,
    valid_days: float | None,
) -> "CalibrationRecord":
    """Give the record to be, without results: that of before, if its devices are still the same.

    Raises:
        CalibrationError: A device was exchanged since.
    """
    from datetime import UTC, datetime

    from tronlab.calib.inputs import Inputs
    from tronlab.calib.record import CalibrationRecord
    from tronlab.calib.results import Results
    from tronlab.campaign.provenance import software_versions

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


def _mounting(before: "CalibrationRecord | None", nominal: "MountingSpec") -> "Mounting":
    """Give how to drive: as calibrated, if both robot and hand-eye transform were."""
    if before is None or before.results.robot is None or before.results.hand_eye is None:
        return nominal.nominal
    return before.mounting(nominal)
