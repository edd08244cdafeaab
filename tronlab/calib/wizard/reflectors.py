"""What is measured at reflectors: the model frame, and the lamp."""

from tronlab.calib.inputs import FrameInput, LampInput, Points, point_readings
from tronlab.calib.reflectors.frame import solve_frame
from tronlab.calib.wizard.bench import Bench
from tronlab.calib.wizard.tracker import measure_reflectors

LAMP_TARGET = "lamp"
"""Name of the reflector on the lamp's housing."""


def measure_frame(bench: Bench) -> FrameInput:
    """Measure the reflectors that define the model frame, and try whether they do.

    Raises:
        CalibrationError: A reflector is mislabelled, out of place, or loose.
        DeviceError: The tracker failed.
    """
    reflectors = bench.laboratory.reflectors
    measured = FrameInput(
        measured_utc=bench.utc_now(),
        reflectors=reflectors,
        points=measure_reflectors(bench, reflectors.points_m),
    )
    solve_frame(point_readings(measured.points), reflectors)
    return measured


def measure_lamp(bench: Bench, points: Points | None = None) -> LampInput:
    """Measure the reflector on the lamp.

    Args:
        bench: Of its devices the tracker is used.
        points: The model's reflectors, if they were measured in this set-up of the tracker; by
            default they are measured now.

    Raises:
        CalibrationError: As ``measure_frame``.
        DeviceError: The tracker failed.
    """
    if points is None:
        points = measure_frame(bench).points
    measured_utc = bench.utc_now()
    point = measure_reflectors(bench, (LAMP_TARGET,))[LAMP_TARGET]
    return LampInput(
        measured_utc=measured_utc,
        lamp=bench.laboratory.lamp,
        reflectors=bench.laboratory.reflectors,
        points=points,
        point=point,
    )
