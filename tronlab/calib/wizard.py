"""Leads through a calibration: measures what is needed, then solves."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.calib.board import detect_board
from tronlab.calib.bundle import Station
from tronlab.calib.intrinsics import MIN_CORNERS
from tronlab.calib.measurements import Measurements, rounded
from tronlab.calib.record import CalibrationRecord
from tronlab.calib.solve import solve_calibration
from tronlab.calib.stations import plan_stations
from tronlab.calib.three_point import NAMES, solve_frame
from tronlab.devices.laboratory import LaboratorySpec
from tronlab.devices.readings import Frame
from tronlab.devices.registry import Devices
from tronlab.errors import CalibrationError, LimitError, TrackingLostError

LAMP_TARGET = "lamp"
_FULL_SCALE = {"Mono8": 255, "Mono12": 4095}
_BRIGHT_QUANTILE = 0.98
_AIMED_LEVEL = 0.7
"""Of full scale, for the bright parts of the image: far from saturation, well above the noise."""
_ACCEPTED_LEVELS = 0.5, 0.85
_EXPOSURE_TRIES = 8
_DARKEST = 0.035
"""An image darker than this says little about how much longer to expose."""


class Progress(Protocol):
    """Is told how far the calibration is."""

    def announce(self, text: str) -> None:
        """Say what happens next, or what was left out."""
        ...

    def advance(self, stage: str, *, n_done: int, n_all: int) -> None:
        """Say how far a stage is."""
        ...


@dataclass(frozen=True, slots=True)
class CalibrationSettings:
    """How a calibration measures."""

    window_s: float = 2.0
    """The tracker averages over this."""
    exposure_s: float = 0.005
    """Where the search for the exposure begins."""
    gain_db: float = 0.0
    pixel_format: str = "Mono8"
    move_timeout_s: float = 120.0
    grab_timeout_s: float = 10.0


def calibrate(
    devices: Devices,
    laboratory: LaboratorySpec,
    *,
    rig_name: str,
    software: Mapping[str, str],
    settings: CalibrationSettings,
    progress: Progress,
) -> CalibrationRecord:
    """Calibrate frame, camera, hand-eye transform and lamp.

    Args:
        devices: The rig's devices, connected.
        laboratory: The laboratory as designed; it says where to look.
        rig_name: Name of the rig, for the record.
        software: Versions, for the record.
        settings: How to measure.
        progress: Is told how far it is.

    Raises:
        CalibrationError: What was measured makes no sense or determines no answer.
        DeviceError: A device failed.
    """
    identities = {
        "camera": devices.camera.identify(),
        "tracker": devices.tracker.identify(),
        "tmac": devices.tracker.identify_target(),
    }
    measurements = measure(devices, laboratory, settings=settings, progress=progress)
    progress.announce(f"solving from {len(measurements.stations)} stations")
    return solve_calibration(measurements, rig_name=rig_name, devices=identities, software=software)


def measure(
    devices: Devices,
    laboratory: LaboratorySpec,
    *,
    settings: CalibrationSettings,
    progress: Progress,
) -> Measurements:
    """Measure reflectors, lamp and board; the board is taken away whatever happens."""
    devices.room.switch_lamp(on=True)
    readings = {
        name: devices.tracker.measure_point(name, window_s=settings.window_s)
        for name in (*NAMES, LAMP_TARGET)
    }
    lamp = readings.pop(LAMP_TARGET)
    solve_frame(readings, laboratory.reflectors)  # a swapped reflector shows before anything moves
    devices.operator.perform("place_board")
    try:
        stations, skipped = _visit(devices, laboratory, settings, progress)
    finally:
        devices.operator.perform("remove_board")
    return Measurements(
        laboratory=laboratory,
        reflectors=readings,
        lamp=lamp,
        stations=tuple(stations),
        skipped=tuple(skipped),
    )


def _visit(
    devices: Devices,
    laboratory: LaboratorySpec,
    settings: CalibrationSettings,
    progress: Progress,
) -> tuple[list[Station], list[str]]:
    """Look at the board from everywhere; what cannot be used is listed and left out."""
    poses = plan_stations(laboratory)
    stations: list[Station] = []
    skipped: list[str] = []
    is_exposed = False
    for i, trs_from_cam in enumerate(poses):
        progress.advance("stations", n_done=i, n_all=len(poses))
        try:
            _go_to(devices, laboratory, trs_from_cam, settings)
            if not is_exposed:
                _find_exposure(devices, settings)
                is_exposed = True
            station = _observe(devices, laboratory, settings)
        except (LimitError, TrackingLostError) as error:
            skipped.append(f"pose {i}: {error}")
            progress.announce(f"left out: {skipped[-1]}")
            continue
        if len(station.view) < MIN_CORNERS:
            skipped.append(f"pose {i}: {len(station.view)} corners, at least {MIN_CORNERS} needed")
            progress.announce(f"left out: {skipped[-1]}")
            continue
        stations.append(station)
    progress.advance("stations", n_done=len(poses), n_all=len(poses))
    return stations, skipped


def _go_to(
    devices: Devices,
    laboratory: LaboratorySpec,
    trs_from_cam: RigidTransform,
    settings: CalibrationSettings,
) -> None:
    target = laboratory.mounting.robot_target(trs_from_cam)
    devices.robot.check(target)
    devices.robot.move(target, timeout_s=settings.move_timeout_s)


def _observe(
    devices: Devices, laboratory: LaboratorySpec, settings: CalibrationSettings
) -> Station:
    reading = devices.tracker.measure_pose(window_s=settings.window_s)
    frame = devices.camera.grab(timeout_s=settings.grab_timeout_s)
    expected = laboratory.camera.nominal_model.shape
    if frame.image.shape != expected:
        raise CalibrationError(
            f"camera: delivers images of shape {frame.image.shape}, the rig file's"
            f" laboratory.camera says {expected}"
        )
    return Station(reading, rounded(detect_board(frame.image, laboratory.board)))


def _find_exposure(devices: Devices, settings: CalibrationSettings) -> None:
    """Set the exposure so that the white of the board is bright and nothing is saturated.

    Raises:
        CalibrationError: No exposure the camera can do gives such an image.
    """
    low, high = _ACCEPTED_LEVELS
    exposure_s, seen = settings.exposure_s, ""
    for _ in range(_EXPOSURE_TRIES):
        if exposure_s > settings.grab_timeout_s / 2:
            break
        try:
            devices.camera.configure(
                exposure_s=exposure_s, gain_db=settings.gain_db, pixel_format=settings.pixel_format
            )
        except LimitError as error:
            seen += f" {error};"
            break
        level = _brightness(devices.camera.grab(timeout_s=settings.grab_timeout_s))
        if low <= level <= high:
            return
        seen = f" at {exposure_s:.3g} s its white is at {level:.1%} of full scale;"
        exposure_s *= 0.25 if level > high else _AIMED_LEVEL / max(level, _DARKEST)
    raise CalibrationError(
        f"camera: no exposure found for the board (wanted {low:.0%} to {high:.0%}):{seen}"
        "\nis the lamp on, is the board in place?"
    )


def _brightness(frame: Frame) -> float:
    return float(np.quantile(frame.image, _BRIGHT_QUANTILE)) / _FULL_SCALE[frame.pixel_format]
