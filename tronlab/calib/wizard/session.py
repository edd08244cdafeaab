"""A session: measures the parts asked for, one after the other, then solves all there is."""

from collections.abc import Callable, Collection
from dataclasses import replace
from typing import TypeAlias

from tronlab.calib.inputs import FrameInput, PartName
from tronlab.calib.record import CalibrationRecord
from tronlab.calib.results import Results
from tronlab.calib.solve import solve
from tronlab.calib.wizard.bench import Bench
from tronlab.calib.wizard.board import measure_intrinsics, measure_stations
from tronlab.calib.wizard.reflectors import measure_frame, measure_lamp
from tronlab.calib.wizard.robot import measure_robot

Keep: TypeAlias = Callable[[CalibrationRecord], None]

ALL_PARTS: tuple[PartName, ...] = ("frame", "lamp", "robot", "hand_eye")
"""What makes a record complete; the camera is calibrated from the stations of the hand-eye."""
_USED: dict[PartName, tuple[str, ...]] = {
    "frame": ("tracker",),
    "lamp": ("tracker",),
    "robot": ("tracker", "robot"),
    "intrinsics": ("robot", "camera", "room", "operator"),
    "hand_eye": ("tracker", "robot", "camera", "room", "operator"),
}


def devices_needed(parts: Collection[PartName]) -> frozenset[str]:
    """Give the kinds of devices that measuring these parts takes."""
    return frozenset(kind for part in parts for kind in _USED[part])


def _forget(_: object) -> None:
    """Keep nothing along the way."""


def calibrate(
    parts: Collection[PartName],
    bench: Bench,
    draft: CalibrationRecord,
    *,
    keep: Keep = _forget,
) -> CalibrationRecord:
    """Measure parts of a calibration, and solve them with those measured before.

    Reflectors come first: that they are swapped shows before anything moves. The robot moves on its
    own before the board is put in its way.

    Args:
        parts: What to measure, ``ALL_PARTS`` for a complete record.
        bench: The rig.
        draft: The record to be, without results: whose it is, and the inputs to go on from.
        keep: Is given the draft with all that was measured so far, again and again, so that
            nothing is lost whatever happens.

    Raises:
        CalibrationError: What was measured makes no sense or determines no answer.
        DeviceError: A device failed.
    """
    inputs = draft.inputs

    def take(**measured: object) -> None:
        nonlocal inputs
        inputs = inputs.with_parts(**measured)
        keep(replace(draft, inputs=inputs, results=Results()))

    frame: FrameInput | None = None
    if "frame" in parts:
        frame = measure_frame(bench)
        take(frame=frame)
    points = frame.points if frame else None
    if "lamp" in parts:
        lamp = measure_lamp(bench, points)
        points = lamp.points
        take(lamp=lamp)
    if "robot" in parts:
        take(robot=measure_robot(bench, points, keep=lambda robot: take(robot=robot)))
    if "intrinsics" in parts:
        take(intrinsics=measure_intrinsics(bench, keep=lambda views: take(intrinsics=views)))
    if "hand_eye" in parts:
        take(hand_eye=measure_stations(bench, keep=lambda stations: take(hand_eye=stations)))
    bench.dialogue.announce("solving")
    return replace(draft, inputs=inputs, results=solve(inputs))
