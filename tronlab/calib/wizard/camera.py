"""Taking images of the board: the exposure, the robot's way there, and what is seen."""

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.calib.camera.board import BoardView, detect_board
from tronlab.calib.wizard.bench import Bench
from tronlab.devices.readings import Frame
from tronlab.errors import CalibrationError, LimitError

_FULL_SCALE = {"Mono8": 255, "Mono12": 4095}
_BRIGHT_QUANTILE = 0.98
_AIMED_LEVEL = 0.7
"""Of full scale, for the bright parts of the image: far from saturation, well above the noise."""
_ACCEPTED_LEVELS = 0.5, 0.85
_EXPOSURE_TRIES = 8
_DARKEST = 0.035
"""An image darker than this says little about how much longer to expose."""


def can_go_to(bench: Bench, trs_from_cam: RigidTransform) -> str:
    """Ask the robot's planner about a pose; an empty text says it can be reached."""
    try:
        bench.devices.robot.check(bench.mounting.robot_target(trs_from_cam))
    except LimitError as error:
        return str(error)
    return ""


def go_to(bench: Bench, trs_from_cam: RigidTransform) -> None:
    """Have the robot carry the camera there, as well as it knows.

    Raises:
        LimitError: It cannot; nothing moved.
    """
    target = bench.mounting.robot_target(trs_from_cam)
    bench.devices.robot.check(target)
    bench.devices.robot.move(target, timeout_s=bench.settings.move_timeout_s)


def look_at_board(bench: Bench) -> BoardView:
    """Take an image and find the corners of the board in it.

    Raises:
        CalibrationError: The camera delivers another size than the rig file says.
    """
    frame = bench.devices.camera.grab(timeout_s=bench.settings.grab_timeout_s)
    expected = bench.laboratory.camera.nominal_model.shape
    if frame.image.shape != expected:
        raise CalibrationError(
            f"camera: delivers images of shape {frame.image.shape}, the rig file's"
            f" laboratory.camera says {expected}"
        )
    return detect_board(frame.image, bench.laboratory.board)


def find_exposure(bench: Bench) -> None:
    """Set the exposure so that the white of the board is bright and nothing is saturated.

    Raises:
        CalibrationError: No exposure the camera can do gives such an image.
    """
    camera, settings = bench.devices.camera, bench.settings
    low, high = _ACCEPTED_LEVELS
    exposure_s, seen = settings.exposure_s, ""
    for _ in range(_EXPOSURE_TRIES):
        if exposure_s > settings.grab_timeout_s / 2:
            break
        try:
            camera.configure(
                exposure_s=exposure_s, gain_db=settings.gain_db, pixel_format=settings.pixel_format
            )
        except LimitError as error:
            seen += f" {error};"
            break
        level = _brightness(camera.grab(timeout_s=settings.grab_timeout_s))
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
