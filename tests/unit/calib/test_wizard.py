"""The wizard on the twin, with a quarter of the pixels and no terrain."""

import re
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from scipy.stats import chi2
from small_twin import SmallTwin, make_small_twin

from tronlab.calib.camera.projection import free_intrinsics, intrinsics_of
from tronlab.calib.inputs import FrameInput, Inputs, StationsInput
from tronlab.calib.record import CalibrationRecord
from tronlab.calib.rerun import rerun
from tronlab.calib.results import Results
from tronlab.calib.wizard import (
    ALL_PARTS,
    Settings,
    calibrate,
    devices_needed,
    measure_frame,
    measure_intrinsics,
    measure_lamp,
    measure_robot,
    measure_stations,
)
from tronlab.errors import CalibrationError, DeviceTimeoutError
from tronlab.geometry.uncertainty import pose_difference

pytestmark = pytest.mark.opencv
FEW = Settings(n_stations=7, n_views=7, n_reflector_readings=2)
DRAFT = CalibrationRecord(
    rig_name="small",
    created_utc="2026-01-02T03:04:05Z",
    software={"tronlab": "0"},
    devices={},
    results=Results(),
)


@dataclass
class Journal:
    """Keeps what a session hands over along the way."""

    drafts: list[CalibrationRecord] = field(default_factory=list)

    def __call__(self, draft: CalibrationRecord) -> None:
        self.drafts.append(draft)


@dataclass
class Done:
    twin: SmallTwin
    record: CalibrationRecord
    journal: Journal


@pytest.fixture(scope="module")
def done() -> Done:
    twin, journal = make_small_twin(Settings(n_stations=12), surface={}), Journal()
    record = calibrate(ALL_PARTS, twin.bench, DRAFT, keep=journal)
    return Done(twin, record, journal)


def nees(error: np.ndarray, covariance: np.ndarray) -> float:
    return float(error @ np.linalg.solve(covariance, error))


def stations_of(record: CalibrationRecord) -> StationsInput:
    assert isinstance(record.inputs.hand_eye, StationsInput)
    return record.inputs.hand_eye


def test_every_result_lies_within_its_covariance(done: Done) -> None:
    truth, results = done.twin.world.laboratory, done.record.results
    assert results.frame is not None
    assert results.hand_eye is not None
    assert results.camera is not None
    assert results.lamp is not None
    frame_error = pose_difference(results.frame.trs_from_trk, truth.trk_from_trs.inv())
    assert nees(frame_error, results.frame.covariance) < chi2.ppf(0.999, 6)
    tmac_from_cam = truth.flange_from_tmac.inv() * truth.flange_from_cam
    hand_eye_error = pose_difference(results.hand_eye.tmac_from_cam, tmac_from_cam)
    assert nees(hand_eye_error, results.hand_eye.covariance) < chi2.ppf(0.999, 6)
    free = free_intrinsics(results.camera.model)
    error = (intrinsics_of(results.camera.camera) - intrinsics_of(truth.camera))[free]
    covariance = results.camera.covariance[np.ix_(free, free)]
    assert nees(error, covariance) < chi2.ppf(0.999, len(free))
    lamp_error = results.lamp.p_trs_m - truth.p_targets_trs_m["lamp"]
    assert nees(lamp_error, results.lamp.covariance_m2) < chi2.ppf(0.999, 3)


def test_the_truth_of_a_shot_is_known_to_what_is_wanted(done: Done) -> None:
    reading = done.twin.bench.devices.tracker.measure_pose(window_s=1.0)
    trs_from_cam, covariance = done.record.trs_from_cam(reading)
    error = pose_difference(trs_from_cam, done.twin.world.truth.trs_from_cam)
    assert nees(error, covariance) < chi2.ppf(0.999, 6)
    assert np.sqrt(np.trace(covariance[3:, 3:])) < 0.15e-3
    assert np.degrees(np.sqrt(np.trace(covariance[:3, :3]))) < 0.015


def test_a_planned_pose_is_met_once_the_robot_is_calibrated(done: Done) -> None:
    twin, world = done.twin, done.twin.world
    mounting = done.record.mounting(twin.bench.laboratory.mounting)
    nominal = twin.bench.mounting
    wanted = nominal.trs_from_cam(world.robot_at)
    twin.bench.devices.robot.move(mounting.robot_target(wanted), timeout_s=60.0)
    error = pose_difference(wanted, world.truth.trs_from_cam)
    assert np.linalg.norm(error[3:]) < 1e-3


def test_the_reflectors_are_averaged(done: Done) -> None:
    """Eight independent readings know the frame nearly three times as well as one."""
    once = measure_frame(make_small_twin(Settings(n_reflector_readings=1)).bench)
    assert done.record.inputs.frame is not None
    for name, point in done.record.inputs.frame.points.items():
        ratio = np.trace(once.points[name].covariance_m2) / np.trace(point.covariance_m2)
        assert ratio == pytest.approx(8.0)


def test_everything_was_kept_along_the_way(done: Done) -> None:
    drafts = done.journal.drafts
    assert drafts[0].inputs.frame is not None
    assert drafts[0].inputs.lamp is None
    assert drafts[-1].inputs == done.record.inputs
    counts = [len(stations_of(d).stations) for d in drafts if d.inputs.hand_eye is not None]
    assert sorted(set(counts)) == list(range(1, 13))


def test_a_session_interrupted_early_is_solved_as_far_as_it_goes(done: Done) -> None:
    drafts = done.journal.drafts
    (kept, *_) = [d for d in drafts if d.inputs.hand_eye and len(stations_of(d).stations) == 2]
    again = rerun(kept, {})
    assert set(again.new_parts) == {"frame", "lamp", "robot"}
    assert again.record.inputs.hand_eye is None
    assert "2 " in again.unsolved["hand_eye"]
    only = replace(kept, inputs=Inputs(hand_eye=kept.inputs.hand_eye))
    with pytest.raises(CalibrationError, match=re.escape(again.unsolved["hand_eye"])):
        rerun(only, {})


def test_what_was_kept_can_be_solved_later(done: Done) -> None:
    kept = CalibrationRecord.from_json(done.journal.drafts[-1].to_json())
    again = rerun(kept, {})
    assert not again.differences
    assert set(again.new_parts) == {"frame", "camera", "hand_eye", "lamp", "robot"}
    record = CalibrationRecord.from_json(done.record.to_json())
    assert rerun(record, {}).differences == ()


def test_one_part_measured_anew_leaves_the_others(done: Done) -> None:
    twin = make_small_twin(FEW)
    draft = replace(done.record, results=Results())
    record = calibrate(["frame"], twin.bench, draft)
    assert record.inputs.frame != done.record.inputs.frame
    assert record.inputs.hand_eye == done.record.inputs.hand_eye
    before, after = done.record.results.hand_eye, record.results.hand_eye
    assert before is not None
    assert after is not None
    np.testing.assert_allclose(
        before.tmac_from_cam.as_matrix(), after.tmac_from_cam.as_matrix(), atol=1e-12
    )


def test_the_person_is_told_what_is_seen_and_what_is_missing(done: Done) -> None:
    lines, questions = done.twin.dialogue.lines, done.twin.dialogue.questions
    assert any("of 63 corners found, in the" in line for line in lines)
    assert any(". . ." in line or "x x ." in line for line in lines)
    assert "least determined: " in lines[-2]
    assert any("station 12 of 12: 0." in question for question in questions)
    assert "first 6 stations are fixed" in questions[-12]
    assert re.search(r"known to 0\.\d+ mm instead of 0\.\d+ mm", questions[-1])
    assert ("station", 12, 12) in done.twin.dialogue.steps


def test_the_board_is_taken_away_afterwards(done: Done) -> None:
    assert done.twin.world.truth.trs_from_board is None


def test_the_person_may_skip_and_stop() -> None:
    twin = make_small_twin(FEW, answers=["skip", "go", "go", "stop"])
    measured = measure_stations(twin.bench)
    assert len(measured.stations) == 2
    assert twin.world.truth.trs_from_board is None


def test_ctrl_c_loses_nothing_and_the_board_is_taken_away() -> None:
    twin, journal = make_small_twin(FEW, answers=["go", "go", "interrupt"]), Journal()
    with pytest.raises(KeyboardInterrupt):
        calibrate(["frame", "hand_eye"], twin.bench, DRAFT, keep=journal)
    assert len(stations_of(journal.drafts[-1]).stations) == 2
    assert isinstance(journal.drafts[-1].inputs.frame, FrameInput)
    assert twin.world.truth.trs_from_board is None


def test_intrinsics_need_no_tracker() -> None:
    twin = make_small_twin(FEW)
    twin.bench.devices.tracker.close()
    measured = measure_intrinsics(twin.bench)
    assert len(measured.views) == 7
    assert devices_needed(["intrinsics"]) == {"robot", "camera", "room", "operator"}


def test_the_lamp_is_measured_with_the_reflectors_of_its_own_set_up() -> None:
    measured = measure_lamp(make_small_twin(FEW).bench)
    assert set(measured.points) == {"top_left", "bottom_left", "top_right"}


def test_swapped_reflectors_show_before_anything_moves() -> None:
    twin = make_small_twin(FEW)
    targets = dict(twin.world.laboratory.p_targets_trs_m)
    targets["top_left"], targets["top_right"] = targets["top_right"], targets["top_left"]
    object.__setattr__(twin.world.laboratory, "p_targets_trs_m", targets)
    parked = twin.world.state.read().robot_encoders
    with pytest.raises(CalibrationError, match="top_left, top_right are swapped"):
        calibrate(ALL_PARTS, twin.bench, DRAFT)
    assert twin.world.state.read().robot_encoders == parked


def lost_at(n: int, *, times: int) -> dict[str, object]:
    return {
        "device": "tracker",
        "call": "measure_pose",
        "at": n,
        "times": times,
        "error": "tracking_lost",
    }


def test_a_beam_lost_once_costs_nothing_and_for_long_one_station() -> None:
    # Four calls a station: two looks, the measurement, and a look after the image.
    faults = [lost_at(5, times=1), lost_at(10, times=3)]
    twin = make_small_twin(replace(FEW, n_stations=3), faults=faults)
    measured = measure_stations(twin.bench)
    assert len(measured.stations) == 3
    assert [line.split(":")[0] for line in measured.skipped] == ["pose 2"]


def test_a_robot_stopped_too_early_is_refused_before_the_board_is_placed() -> None:
    twin, journal = make_small_twin(FEW, answers=["go"] * 2 + ["stop"]), Journal()
    with pytest.raises(CalibrationError, match="robot: 2 stations, at least 6 needed"):
        calibrate(ALL_PARTS, twin.bench, DRAFT, keep=journal)
    kept = journal.drafts[-1].inputs
    assert kept.robot is not None
    assert len(kept.robot.stations) == 2
    assert kept.hand_eye is None


def test_the_person_is_told_what_robot_places_are_worth() -> None:
    twin = make_small_twin(FEW, answers=["go"] * 9 + ["stop"])
    assert len(measure_robot(twin.bench).stations) == 9
    assert "  5 measured, solved from 6 on" in twin.dialogue.lines
    assert re.match(r"  9 measured; places held out are met to 0\.\d+ mm", twin.dialogue.lines[-1])
    assert ("robot station", 20, 20) not in twin.dialogue.steps


def test_a_robot_place_out_of_view_is_left_out() -> None:
    answers, faults = ["go"] * 8 + ["stop"], [lost_at(4, times=3)]
    measured = measure_robot(make_small_twin(FEW, answers=answers, faults=faults).bench)
    assert [line.split(":")[0] for line in measured.skipped] == ["place 1"]
    assert len(measured.stations) == 7


def test_the_board_is_taken_away_when_a_device_fails() -> None:
    fault = {"device": "camera", "call": "grab", "at": 3, "times": 9, "error": "timeout"}
    twin = make_small_twin(FEW, faults=[fault])
    with pytest.raises(DeviceTimeoutError):
        measure_stations(twin.bench)
    assert twin.world.truth.trs_from_board is None


def test_a_board_that_is_not_there_is_noticed() -> None:
    twin = make_small_twin(FEW)
    board = twin.bench.laboratory.board.model_copy(update={"dictionary": "DICT_4X4_250"})
    twin = twin.with_laboratory(twin.bench.laboratory.model_copy(update={"board": board}))
    with pytest.raises(CalibrationError, match=r"not found in 3 images.*DICT_4X4_250"):
        measure_stations(twin.bench)


def test_a_board_in_millimetres_is_out_of_reach() -> None:
    twin = make_small_twin(FEW)
    board = twin.bench.laboratory.board.model_copy(update={"square_m": 50.0, "marker_m": 35.0})
    twin = twin.with_laboratory(twin.bench.laboratory.model_copy(update={"board": board}))
    with pytest.raises(
        CalibrationError, match=r"none of the planned poses(.|\n)*lengths are metre"
    ):
        measure_stations(twin.bench)


def test_poses_out_of_reach_are_listed_and_others_taken() -> None:
    twin = make_small_twin(replace(FEW, n_stations=3))
    mounting = twin.bench.laboratory.mounting.model_copy(update={"rail_range_m": (0.0, 3.7)})
    twin.world.spec = twin.bench.laboratory.model_copy(update={"mounting": mounting})
    measured = measure_stations(twin.bench)
    assert len(measured.stations) == 3
    assert any("rail position" in line for line in measured.skipped)


def test_without_light_no_exposure_is_found() -> None:
    twin = make_small_twin(FEW)
    twin.bench.devices.room.switch_lamp = lambda *, on: None  # type: ignore[method-assign]
    twin.world.state.change(lamp_level=0.0)
    with pytest.raises(CalibrationError, match=r"no exposure found(.|\n)*is the lamp on"):
        measure_stations(twin.bench)


def test_an_image_of_another_size_is_refused() -> None:
    twin = make_small_twin(FEW)
    camera = twin.bench.laboratory.camera.model_copy(update={"height_px": 400})
    twin = twin.with_laboratory(twin.bench.laboratory.model_copy(update={"camera": camera}))
    with pytest.raises(CalibrationError, match=r"shape \(512, 512\).*says \(400, 512\)"):
        measure_stations(twin.bench)


def test_a_draft_goes_on_from_what_it_has() -> None:
    """Nothing measured and nothing known: a record without parts."""
    assert calibrate([], make_small_twin(FEW).bench, DRAFT).inputs == Inputs()
