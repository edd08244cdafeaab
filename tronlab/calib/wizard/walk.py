"""The walk round the board: propose a pose, drive there, look, and say what is still missing."""

from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from typing import Protocol

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.calib.camera.board import BoardView
from tronlab.calib.camera.coverage import describe_view
from tronlab.calib.camera.view_checks import MIN_CORNERS
from tronlab.calib.wizard.bench import Bench
from tronlab.calib.wizard.camera import can_go_to, find_exposure, go_to
from tronlab.calib.wizard.stations import board_centre_m, plan_stations
from tronlab.errors import CalibrationError, LimitError, NotSettledError, TrackingLostError

GO, SKIP, STOP = "go", "skip", "stop"
_MAX_BLIND = 3
"""Images in a row without any corner: the board is not there."""


class Collector(Protocol):
    """Takes what a walk is for."""

    stage: str
    """What a place is called."""

    @property
    def n_wanted(self) -> int:
        """Get how many places are enough."""
        ...

    @property
    def n_done(self) -> int:
        """Get how many places were kept."""
        ...

    def rank(self, candidates: Mapping[int, RigidTransform]) -> Sequence[int]:
        """Give the numbers of candidates ``trs_from_cam``, the most useful first."""
        ...

    def reason(self, number: int) -> str:
        """Say why the candidate of that number, the best of the last ``rank``, is proposed."""
        ...

    def observe(self) -> BoardView:
        """Measure here and now; nothing is kept yet."""
        ...

    def keep(self, trs_from_cam: RigidTransform, view: BoardView) -> None:
        """Keep what was observed last, a view from about that pose."""
        ...

    def leave_out(self, reason: str) -> None:
        """Note that a place could not be used."""
        ...

    def outlook(self) -> str:
        """Say how far it is, and what is still undetermined."""
        ...


@contextmanager
def board_in_place(bench: Bench) -> Generator[None]:
    """Have the board placed, and taken away whatever happens."""
    bench.devices.room.switch_lamp(on=True)
    bench.devices.operator.perform("place_board")
    try:
        yield
    finally:
        bench.devices.operator.perform("remove_board")


def walk(bench: Bench, collector: Collector) -> None:
    """Visit places until enough were kept, none is left, or the person says stop.

    Raises:
        CalibrationError: No place can be reached, or the board is in no image.
    """
    candidates = dict(enumerate(plan_stations(bench.laboratory)))
    n_blind, is_exposed = 0, False
    while collector.n_done < collector.n_wanted:
        bench.dialogue.advance(collector.stage, n_done=collector.n_done, n_all=collector.n_wanted)
        number = _propose(bench, collector, candidates)
        if number is None:
            break
        trs_from_cam = candidates.pop(number)
        choice = _ask(bench, collector, trs_from_cam, collector.reason(number))
        if choice == STOP:
            break
        if choice == SKIP:
            continue
        name = f"pose {number}"
        try:
            go_to(bench, trs_from_cam)
            if not is_exposed:
                find_exposure(bench)
                is_exposed = True
            view = bench.persist(name, collector.observe)
        except (LimitError, TrackingLostError, NotSettledError) as error:
            _leave_out(bench, collector, f"{name}: {error}")
            continue
        n_blind = 0 if len(view) else n_blind + 1
        _take(bench, collector, trs_from_cam, view, name)
        if n_blind == _MAX_BLIND:
            raise _no_board(bench)
    bench.dialogue.advance(collector.stage, n_done=collector.n_done, n_all=collector.n_wanted)


def _propose(
    bench: Bench, collector: Collector, candidates: dict[int, RigidTransform]
) -> int | None:
    """Give the most useful place that the robot can reach; what it cannot is left out."""
    first_reason = ""
    for number in collector.rank(candidates):
        reason = can_go_to(bench, candidates[number])
        if not reason:
            return number
        del candidates[number]
        _leave_out(bench, collector, f"pose {number}: {reason}")
        first_reason = first_reason or reason
    if not collector.n_done:
        raise CalibrationError(
            f"board: none of the planned poses round it can be reached; the first: {first_reason};"
            "\ncheck laboratory.board in the rig file: square_m, trs_from_board; lengths are metres"
        )
    bench.dialogue.announce("no further pose can be reached")
    return None


def _ask(bench: Bench, collector: Collector, trs_from_cam: RigidTransform, reason: str) -> str:
    return bench.dialogue.choose(
        f"{collector.stage} {collector.n_done + 1} of {collector.n_wanted}:"
        f" {_describe(bench, trs_from_cam)}; the robot can reach it; {reason}",
        (GO, SKIP, STOP),
    )


def _describe(bench: Bench, trs_from_cam: RigidTransform) -> str:
    board = bench.laboratory.board
    cam_from_board = trs_from_cam.inv() * board.trs_from_board.pose
    distance_m = float(np.linalg.norm(cam_from_board.apply(board_centre_m(board))))
    axes = cam_from_board.rotation.as_matrix()
    tilt = np.arccos(min(abs(float(axes[2, 2])), 1.0))
    roll = np.arctan2(axes[1, 0], axes[0, 0])
    return (
        f"{distance_m:.2f} m from the board, tilted by {np.degrees(tilt):.0f} deg, rolled by"
        f" {np.degrees(roll):.0f} deg"
    )


def _take(
    bench: Bench,
    collector: Collector,
    trs_from_cam: RigidTransform,
    view: BoardView,
    name: str,
) -> None:
    """Keep what was seen, if it is enough."""
    seen = describe_view(view, bench.laboratory.board, bench.laboratory.camera.nominal_model)
    if len(view) < MIN_CORNERS:
        _leave_out(bench, collector, f"{name}: {seen}, at least {MIN_CORNERS} needed")
        return
    collector.keep(trs_from_cam, view)
    bench.dialogue.announce(f"{collector.stage} {collector.n_done}: {seen}")
    bench.dialogue.announce(collector.outlook())


def _leave_out(bench: Bench, collector: Collector, reason: str) -> None:
    collector.leave_out(reason)
    bench.dialogue.announce(f"left out: {reason}")


def _no_board(bench: Bench) -> CalibrationError:
    board = bench.laboratory.board
    return CalibrationError(
        f"board: not found in {_MAX_BLIND} images in a row; is it in place, and is it what"
        f" laboratory.board in the rig file says: {board.kind}, {board.columns} x {board.rows}"
        f" squares, {board.dictionary}?"
    )
