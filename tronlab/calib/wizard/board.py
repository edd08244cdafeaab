"""What is measured with the board: images alone, or stations for camera and hand-eye."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.calib.camera.board import BoardView
from tronlab.calib.camera.coverage import coverage_picture
from tronlab.calib.camera.intrinsics import solve_intrinsics
from tronlab.calib.hand_eye.bundle import Station
from tronlab.calib.hand_eye.solution import solve_hand_eye
from tronlab.calib.inputs import (
    CameraValues,
    IntrinsicsInput,
    PoseInput,
    StationInput,
    StationsInput,
    ViewInput,
)
from tronlab.calib.results import HandEyeResult
from tronlab.calib.wizard.bench import Bench
from tronlab.calib.wizard.camera import look_at_board
from tronlab.calib.wizard.next_station import LEVER_M, Outlook, covariance_of, rank_stations, weigh
from tronlab.calib.wizard.stations import N_FIXED
from tronlab.calib.wizard.tracker import look_again, measure_still
from tronlab.calib.wizard.walk import board_in_place, walk
from tronlab.devices.laboratory import LaboratorySpec
from tronlab.devices.readings import PoseReading
from tronlab.errors import CalibrationError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray

_EXPECTED_POSE_SIGMA = np.repeat([1e-4, 5e-5], 3)
"""Of a T-MAC reading, until there is one: rotation vector and translation, rad and m."""


def _forget(_: object) -> None:
    """Keep nothing along the way."""


def measure_intrinsics(
    bench: Bench, *, keep: Callable[[IntrinsicsInput], None] = _forget
) -> IntrinsicsInput:
    """Take images of the board from many poses, without the tracker.

    Args:
        bench: Robot, camera, room and operator are used.
        keep: Is given all that was measured so far, again and again.

    Raises:
        CalibrationError: The board is in no image, or no pose can be reached.
        DeviceError: A device failed.
    """
    empty = IntrinsicsInput(
        measured_utc=bench.utc_now(),
        pattern=bench.laboratory.board.pattern,
        nominal=CameraValues.of(bench.laboratory.camera.nominal_model),
        views=(),
    )
    views = _Views(bench, keep, empty)
    with board_in_place(bench):
        walk(bench, views)
    return views.measured


def measure_stations(
    bench: Bench, *, keep: Callable[[StationsInput], None] = _forget
) -> StationsInput:
    """Measure T-MAC and board from the stations that tell most about the hand-eye transform.

    Args:
        bench: All its devices are used.
        keep: Is given all that was measured so far, again and again.

    Raises:
        CalibrationError: The board is in no image, or no pose can be reached.
        DeviceError: A device failed.
    """
    empty = StationsInput(
        measured_utc=bench.utc_now(),
        pattern=bench.laboratory.board.pattern,
        nominal=CameraValues.of(bench.laboratory.camera.nominal_model),
        stations=(),
    )
    stations = _Stations(bench, keep, empty, _first_outlook(bench.laboratory))
    with board_in_place(bench):
        walk(bench, stations)
    return stations.measured


@dataclass
class _Views:
    """Collects images of the board."""

    bench: Bench
    hand_over: Callable[[IntrinsicsInput], None]
    measured: IntrinsicsInput
    stage: str = "view"
    views: list[BoardView] = field(default_factory=list[BoardView])

    @property
    def n_wanted(self) -> int:
        return self.bench.settings.n_views

    @property
    def n_done(self) -> int:
        return len(self.views)

    def rank(self, candidates: Mapping[int, RigidTransform]) -> Sequence[int]:
        """Keep the order of the pool: it runs through image, distances and tilts."""
        return sorted(candidates)

    def reason(self, number: int) -> str:
        del number
        return "distances, tilts and places in the image take turns"

    def observe(self) -> BoardView:
        return look_at_board(self.bench)

    def keep(self, trs_from_cam: RigidTransform, view: BoardView) -> None:
        del trs_from_cam
        self.views.append(view)
        self._change(views=(*self.measured.views, ViewInput.of(view)))

    def leave_out(self, reason: str) -> None:
        self._change(skipped=(*self.measured.skipped, reason))

    def outlook(self) -> str:
        return coverage_picture(self.views, self.measured.nominal.model)

    def _change(self, **fields: object) -> None:
        self.measured = self.measured.model_copy(update=fields)
        self.hand_over(self.measured)


@dataclass
class _Stations:
    """Collects stations, and knows what is still badly known."""

    bench: Bench
    hand_over: Callable[[StationsInput], None]
    measured: StationsInput
    expected: Outlook
    stage: str = "station"
    places: list[tuple[RigidTransform, BoardView]] = field(
        default_factory=list[tuple[RigidTransform, BoardView]]
    )
    promised: dict[int, FloatArray] = field(default_factory=dict[int, FloatArray])
    """Information that each candidate will have, by its number."""
    known_m: float = float("inf")
    """How well the hand-eye transform is known so far, and ..."""
    known_with_m: dict[int, float] = field(default_factory=dict[int, float])
    """... with each candidate, by its number; see ``weigh``."""
    reading: PoseReading | None = None
    """Of the T-MAC, when the board was looked at last."""
    verdict: str = f"solved from station {N_FIXED} on"
    """What the stations so far say."""

    @property
    def n_wanted(self) -> int:
        return self.bench.settings.n_stations

    @property
    def n_done(self) -> int:
        return len(self.places)

    def rank(self, candidates: Mapping[int, RigidTransform]) -> Sequence[int]:
        """Begin as the pool does; then prefer what makes the hand-eye transform best known."""
        numbers = sorted(candidates)
        if self.n_done < N_FIXED:
            return numbers
        for number in numbers:
            if number not in self.promised:
                self.promised[number] = self.expected.information_of(candidates[number])
        so_far = [self.expected.information_from(*place) for place in self.places]
        ranking = rank_stations(so_far, [self.promised[number] for number in numbers])
        self.known_m = weigh(covariance_of(so_far))
        self.known_with_m = {numbers[i]: known_m for known_m, i in ranking}
        return list(self.known_with_m)

    def reason(self, number: int) -> str:
        if number not in self.known_with_m:
            return f"the first {N_FIXED} stations are fixed"
        return (
            f"of those left it tells most: hand-eye transform known to"
            f" {self.known_with_m[number] * 1e3:.4f} mm instead of {self.known_m * 1e3:.4f} mm"
            f" (rotation over {LEVER_M:g} m)"
        )

    def observe(self) -> BoardView:
        """Measure the T-MAC, look at the board, and see that nothing moved meanwhile."""
        self.reading = measure_still(self.bench)
        view = look_at_board(self.bench)
        look_again(self.bench, self.reading)
        return view

    def keep(self, trs_from_cam: RigidTransform, view: BoardView) -> None:
        if self.reading is None:
            raise RuntimeError("a station is kept before it was observed")
        self.places.append((trs_from_cam, view))
        station = StationInput(reading=PoseInput.of(self.reading), view=ViewInput.of(view))
        self._change(stations=(*self.measured.stations, station))
        if self.n_done >= N_FIXED:
            self._learn(self.reading)

    def leave_out(self, reason: str) -> None:
        self._change(skipped=(*self.measured.skipped, reason))

    def outlook(self) -> str:
        views = [view for _, view in self.places]
        return f"{coverage_picture(views, self.measured.nominal.model)}\n  {self.verdict}"

    def _learn(self, reading: PoseReading) -> None:
        """Solve what there is: it shows early what does not fit, and sharpens what is expected."""
        try:
            camera, hand_eye, corner_sigma_px = _solve_so_far(self.measured)
        except CalibrationError as error:
            self.verdict = f"no solution so far: {error}"
            return
        if not self.promised:
            self.expected = replace(
                self.expected,
                camera=camera,
                tmac_from_cam=hand_eye.tmac_from_cam,
                pose_sigma=_sigma_by_kind(reading.covariance),
                corner_sigma_px=corner_sigma_px,
            )
        outliers = hand_eye.statistics["outlier_stations"]
        doubtful = f"; stations that do not fit: {outliers}" if outliers else ""
        worst = hand_eye.statistics["least_determined"]
        self.verdict = f"least determined: {worst}{doubtful}"

    def _change(self, **fields: object) -> None:
        self.measured = self.measured.model_copy(update=fields)
        self.hand_over(self.measured)


def _solve_so_far(measured: StationsInput) -> tuple[CameraModel, HandEyeResult, float]:
    """Give camera, hand-eye transform and sigma of a corner; the lens is not chosen yet."""
    pattern = measured.pattern
    stations = [Station(one.reading.reading, one.view.view(pattern)) for one in measured.stations]
    views = [station.view for station in stations]
    intrinsics = solve_intrinsics(views, measured.nominal.model, pattern, model="brown")
    solution = solve_hand_eye(stations, intrinsics, pattern)
    return solution.camera.camera, solution.hand_eye, intrinsics.sigma_px


def _first_outlook(laboratory: LaboratorySpec) -> Outlook:
    mounting = laboratory.mounting
    return Outlook(
        pattern=laboratory.board.pattern,
        camera=laboratory.camera.nominal_model,
        tmac_from_cam=mounting.flange_from_tmac.pose.inv() * mounting.flange_from_cam.pose,
        trs_from_board=laboratory.board.trs_from_board.pose,
        pose_sigma=_EXPECTED_POSE_SIGMA,
    )


def _sigma_by_kind(covariance: FloatArray) -> FloatArray:
    """Give one sigma for all components of rotation, and one for those of translation, (6,)."""
    variances = np.diag(covariance).reshape(2, 3).mean(axis=1)
    return np.repeat(np.sqrt(variances), 3)
