"""Stations from images and poses of a hand whose accuracy nobody states."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.calib.camera.intrinsics import solve_intrinsics
from tronlab.calib.camera.known_camera import known_camera
from tronlab.calib.hand_eye.closed_forms import check_motions, solve_closed_forms
from tronlab.calib.hand_eye.contradictions import check_agreement
from tronlab.calib.hand_eye.pose_fit import PosePairs, fit_pose_pairs
from tronlab.calib.hand_eye.pose_pairs import best_start
from tronlab.calib.inputs import CameraValues, PoseInput, Setup, StationInput, StationsInput
from tronlab.calib.offline.files import written_utc
from tronlab.calib.offline.images import ImageViews, nominal_camera, read_views
from tronlab.devices.laboratory import PatternSpec
from tronlab.devices.readings import PoseReading
from tronlab.errors import CalibrationError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray


def stations_of_images(
    hands: Mapping[Path, RigidTransform],
    pattern: PatternSpec,
    *,
    camera: CameraModel | None,
    setup: Setup,
) -> StationsInput:
    """Find the board in each image and give the hand's poses the accuracy they show.

    Args:
        hands: trk_from_tmac by image.
        pattern: What is printed on the board.
        camera: A calibrated camera, taken as it is; without one it is calibrated with the rest.
        setup: Where the camera is.

    Raises:
        CalibrationError: An image cannot be read, is of another size than the camera's, or poses
            and images contradict each other.
        DegenerateGeometryError: They do not determine camera and hand-eye transform.
    """
    found = _views_of(hands, pattern)
    views = [view.view(pattern) for view in found.views.values()]
    if camera is not None:
        _check_size(camera, found.size_px)
    nominal = camera or nominal_camera(found.size_px)
    used = [hands[path] for path in found.views]
    solve_camera = solve_intrinsics if camera is None else known_camera
    covariance = _covariance_of_hands(used, solve_camera(views, nominal, pattern).cam_from_board)
    sigma_rad, sigma_m = np.sqrt(covariance[[0, 3], [0, 3]])
    assumed = (
        f"poses: without accuracy in the files; {np.degrees(sigma_rad):.3f} deg and"
        f" {1e3 * sigma_m:.2f} mm taken, as they scatter against the images"
    )
    return StationsInput(
        measured_utc=written_utc(hands),
        pattern=pattern,
        nominal=CameraValues.of(nominal),
        stations=tuple(
            StationInput(reading=PoseInput.of(PoseReading(hand, covariance, float(i))), view=view)
            for i, (hand, view) in enumerate(zip(used, found.views.values(), strict=True))
        ),
        is_camera_known=camera is not None,
        setup=setup,
        skipped=found.skipped,
        notes=(assumed,),
    )


def _views_of(hands: Mapping[Path, RigidTransform], pattern: PatternSpec) -> ImageViews:
    for path in hands:
        if not path.is_file():
            raise CalibrationError(f"{path}: no such file, but it has a pose")
    return read_views(list(hands), pattern)


def _check_size(camera: CameraModel, size_px: tuple[int, int]) -> None:
    if (camera.width_px, camera.height_px) != size_px:
        raise CalibrationError(
            f"the camera's images have {camera.width_px} x {camera.height_px} pixels, those given"
            f" {size_px[0]} x {size_px[1]}; it is another camera, or they were resized"
        )


def _covariance_of_hands(
    hands: Sequence[RigidTransform], boards: Sequence[RigidTransform]
) -> FloatArray:
    """Give one covariance for all poses, shape (6, 6), from how they scatter against the boards.

    What the images add to the scatter is small against a robot's, and counts as its own.
    """
    check_motions(hands)
    check_agreement(hands, boards)
    pairs = PosePairs(RigidTransform.concatenate(hands), RigidTransform.concatenate(boards))
    fit = fit_pose_pairs(pairs, best_start(pairs, solve_closed_forms(hands, boards)))
    hand_turn, board_turn, shift = fit.variances
    return np.diag([hand_turn + board_turn] * 3 + [shift] * 3)
