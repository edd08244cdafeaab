"""What is measured of the robot: the T-MAC at many places of arm and rail."""

from collections.abc import Callable

import numpy as np

from tronlab.calib.inputs import Points, RobotInput, RobotStationInput, point_readings
from tronlab.calib.reflectors.frame import solve_frame
from tronlab.calib.results import FrameResult
from tronlab.calib.robot.solution import MIN_STATIONS, plan_robot_stations, solve_robot
from tronlab.calib.wizard.bench import Bench
from tronlab.calib.wizard.reflectors import measure_frame
from tronlab.calib.wizard.tracker import measure_still
from tronlab.calib.wizard.walk import GO, SKIP, STOP
from tronlab.devices.readings import RobotTarget
from tronlab.errors import CalibrationError, LimitError, NotSettledError, TrackingLostError
from tronlab.geometry.poses import rotation_angle_rad

_STAGE = "robot station"


def _forget(_: object) -> None:
    """Keep nothing along the way."""


def measure_robot(
    bench: Bench, points: Points | None = None, *, keep: Callable[[RobotInput], None] = _forget
) -> RobotInput:
    """Drive through the robot's range, measure the T-MAC at each stop, and try what follows.

    Args:
        bench: Of its devices robot and tracker are used.
        points: The model's reflectors, if they were measured in this set-up of the tracker; by
            default they are measured now.
        keep: Is given all that was measured so far, again and again.

    Raises:
        CalibrationError: A reflector is mislabelled, out of place, or loose; or the stations, all
            or those up to where the person said stop, do not determine how the robot stands.
        DeviceError: A device failed.
    """
    if points is None:
        points = measure_frame(bench).points
    frame = solve_frame(point_readings(points), bench.laboratory.reflectors)
    measured = RobotInput(
        measured_utc=bench.utc_now(),
        mounting=bench.laboratory.mounting,
        reflectors=bench.laboratory.reflectors,
        points=points,
        stations=(),
    )
    targets = plan_robot_stations(bench.laboratory.mounting)
    for i, target in enumerate(targets):
        bench.dialogue.advance(_STAGE, n_done=i, n_all=len(targets))
        choice = bench.dialogue.choose(
            f"{_STAGE} {i + 1} of {len(targets)}: {_describe(target, targets[0])}", (GO, SKIP, STOP)
        )
        if choice == STOP:
            break
        if choice == GO:
            measured = _visit(bench, target, f"place {i}", measured)
            keep(measured)
            bench.dialogue.announce(_outlook(measured, frame))
    else:
        bench.dialogue.advance(_STAGE, n_done=len(targets), n_all=len(targets))
    solve_robot(measured.stations, frame, measured.mounting)
    return measured


def _outlook(measured: RobotInput, frame: FrameResult) -> str:
    """Say what the stations so far are worth."""
    n = len(measured.stations)
    if n < MIN_STATIONS:
        return f"  {n} measured, solved from {MIN_STATIONS} on"
    try:
        result = solve_robot(measured.stations, frame, measured.mounting)
    except CalibrationError as error:
        return f"  {n} measured, no solution so far: {error}"
    outliers = result.statistics["outliers"]
    doubtful = f"; stations that do not fit: {outliers}" if outliers else ""
    met_mm = result.statistics["held_out_rms_m"] * 1e3
    return f"  {n} measured; places held out are met to {met_mm:.3f} mm rms{doubtful}"


def _visit(bench: Bench, target: RobotTarget, name: str, measured: RobotInput) -> RobotInput:
    """Measure at one place; if it cannot be used, that is noted."""
    robot = bench.devices.robot
    try:
        robot.check(target)
        robot.move(target, timeout_s=bench.settings.move_timeout_s)
        reading = bench.persist(name, lambda: measure_still(bench))
    except (LimitError, TrackingLostError, NotSettledError) as error:
        bench.dialogue.announce(f"left out: {name}: {error}")
        return measured.model_copy(update={"skipped": (*measured.skipped, f"{name}: {error}")})
    station = RobotStationInput.of(robot.read(), reading)
    return measured.model_copy(update={"stations": (*measured.stations, station)})


def _describe(target: RobotTarget, first: RobotTarget) -> str:
    place = " ".join(f"{value:.2f}" for value in target.base_from_flange.translation)
    turn = rotation_angle_rad(first.base_from_flange, target.base_from_flange)
    return (
        f"rail at {target.rail_m:.2f} m, flange at {place} m,"
        f" turned by {np.degrees(turn):.0f} deg against the first"
    )
