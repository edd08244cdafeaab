"""Leads through a calibration: measures each part at the rig, a person at its side or nobody."""

from tronlab.calib.wizard.bench import Bench, Settings
from tronlab.calib.wizard.board import measure_intrinsics, measure_stations
from tronlab.calib.wizard.dialogue import Dialogue, Progress, Unattended
from tronlab.calib.wizard.reflectors import measure_frame, measure_lamp
from tronlab.calib.wizard.robot import measure_robot
from tronlab.calib.wizard.session import ALL_PARTS, calibrate, devices_needed

__all__ = [
    "ALL_PARTS",
    "Bench",
    "Dialogue",
    "Progress",
    "Settings",
    "Unattended",
    "calibrate",
    "devices_needed",
    "measure_frame",
    "measure_intrinsics",
    "measure_lamp",
    "measure_robot",
    "measure_stations",
]
