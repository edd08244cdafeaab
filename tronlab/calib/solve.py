"""From everything measured to everything that follows from it: the same inputs, the same results.

Images from stations and images alone see one camera, and if the board is the same one, one board:
they are solved together, so that each result rests on all there is.
"""

from tronlab.calib.camera.intrinsics import IntrinsicsSolution, solve_intrinsics
from tronlab.calib.camera.known_camera import known_camera
from tronlab.calib.hand_eye.bundle import Station
from tronlab.calib.hand_eye.pose_pairs import solve_pose_pairs
from tronlab.calib.hand_eye.solution import solve_hand_eye
from tronlab.calib.inputs import (
    Inputs,
    IntrinsicsInput,
    LampInput,
    PosePairsInput,
    RobotInput,
    StationsInput,
    point_readings,
    views_of,
)
from tronlab.calib.photometry.fit import solve_photometry
from tronlab.calib.reflectors.frame import solve_frame
from tronlab.calib.reflectors.lamp import solve_lamp
from tronlab.calib.results import (
    CameraResult,
    FrameResult,
    HandEyeResult,
    LampResult,
    Results,
    RobotResult,
)
from tronlab.calib.robot.solution import solve_robot


def solve(inputs: Inputs) -> Results:
    """Solve every part that was measured.

    Raises:
        DegenerateGeometryError: The measurements do not determine the answer.
        CalibrationError: The measurements contradict each other, or the rig file.
    """
    camera, hand_eye = _camera_and_hand_eye(inputs)
    return Results(
        frame=_frame(inputs),
        camera=camera,
        hand_eye=hand_eye,
        lamp=None if inputs.lamp is None else _lamp(inputs.lamp),
        robot=None if inputs.robot is None else _robot(inputs.robot),
        photometry=None if inputs.photometry is None else solve_photometry(inputs.photometry),
    )


def _frame(inputs: Inputs) -> FrameResult | None:
    if inputs.frame is None:
        return None
    return solve_frame(point_readings(inputs.frame.points), inputs.frame.reflectors)


def _lamp(lamp: LampInput) -> LampResult:
    frame = solve_frame(point_readings(lamp.points), lamp.reflectors)
    return solve_lamp(lamp.point.reading("lamp"), frame, lamp.lamp)


def _robot(robot: RobotInput) -> RobotResult:
    frame = solve_frame(point_readings(robot.points), robot.reflectors)
    return solve_robot(robot.stations, frame, robot.mounting)


def _camera_and_hand_eye(inputs: Inputs) -> tuple[CameraResult | None, HandEyeResult | None]:
    if isinstance(inputs.hand_eye, StationsInput):
        return _from_stations(inputs.hand_eye, inputs.intrinsics)
    camera = None if inputs.intrinsics is None else _intrinsics(inputs.intrinsics).result
    if isinstance(inputs.hand_eye, PosePairsInput):
        return camera, solve_pose_pairs(inputs.hand_eye)
    return camera, None


def _intrinsics(intrinsics: IntrinsicsInput) -> IntrinsicsSolution:
    views = views_of(intrinsics.views, intrinsics.pattern)
    return solve_intrinsics(views, intrinsics.nominal.model, intrinsics.pattern)


def _from_stations(
    measured: StationsInput, intrinsics: IntrinsicsInput | None
) -> tuple[CameraResult, HandEyeResult]:
    pattern = measured.pattern
    stations = [
        Station(station.reading.reading, station.view.view(pattern))
        for station in measured.stations
    ]
    free_views = ()
    if intrinsics is not None and intrinsics.pattern == pattern:
        free_views = views_of(intrinsics.views, pattern)
    views = [*(station.view for station in stations), *free_views]
    solve_camera = known_camera if measured.is_camera_known else solve_intrinsics
    solution = solve_hand_eye(
        stations,
        solve_camera(views, measured.nominal.model, pattern),
        pattern,
        free_views=free_views,
        is_camera_free=not measured.is_camera_known,
    )
    return solution.camera, solution.hand_eye
