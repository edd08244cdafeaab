"""What is measured of the robot: the T-MAC at many places of arm and rail."""

from collections.abc import Callable

import numpy as np

from tronlab.calib.inputs import Points, RobotInput, RobotStationInput
from tronlab.calib.robot.solution import plan_robot_stations
from tronlab.calib.wizard.bench import Bench
from tronlab.calib.wizard.reflectors import measure_frame
from tronlab.calib.wizard.tracker import measure_still
from tronlab.calib.wizard.walk import GO, SKIP, STOP
from tronlab.devices.readings import RobotTarget
from tronlab.errors import LimitError, NotSettledError, TrackingLostError
from tronlab.geometry.poses import rotation_angle_rad

_STAGE = "robot station"


def _forget(_: object) -> None:
    """Keep nothing along the way."""


def measure_robot(
    bench: Bench, points: Points | None = None, *, keep: Callable[[RobotInput], None] = _forget
) -> RobotInput:
    """Drive through the robot's range and measure the T-MAC at each stop.

    Args:
        bench: Of its devices robot and tracker are used.
        points: The model's reflectors, if they were measured in this set-up of the tracker; by
            default they are measured now.
        keep: Is given all that was measured so far, again and again.

    Raises:
        CalibrationError: A reflector is mislabelled, out of place, or loose.
        DeviceError: A device failed.
    """
    if points is None:
        points = measure_frame(bench).points
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
    bench.dialogue.advance(_STAGE, n_done=len(targets), n_all=len(targets))
    return measured


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
