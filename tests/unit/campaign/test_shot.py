from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from tronlab.campaign.shot import ShotTaker
from tronlab.devices.readings import PoseReading
from tronlab.errors import DeviceError, NotSettledError, QualityError
from tronlab.planning.shots import Plan
from tronlab.terrain.config import Registration


def take(taker: ShotTaker, plan: Plan, **begin: Any) -> Any:
    taker.begin(plan.shots[0], begin.pop("attempt", 1), **begin)
    for step in (
        taker.move,
        taker.settle,
        taker.measure,
        taker.grab,
        taker.confirm,
        taker.read,
        taker.judge,
    ):
        step()
    return taker.assemble()


def test_record_holds_what_was_read(taker: ShotTaker, plan: Plan) -> None:
    record = take(taker, plan)
    assert (record.shot_id, record.attempt) == (1, 1)
    assert record.trs_from_cam_nominal is plan.shots[0].trs_from_cam_nominal
    assert record.robot.rail_m == 10.0
    assert (record.frame.image == 10).all()
    np.testing.assert_allclose(record.tracker.trk_from_tmac.translation, [0, 0, 10])


def test_truth_is_as_unsure_as_the_terrain_models_place(taker: ShotTaker) -> None:
    reading = PoseReading(RigidTransform.from_translation([0.1, 0.2, 3.0]), np.zeros((6, 6)), 0.0)
    exact = taker.truth_source
    before, _ = exact.derive(reading)
    stated = replace(exact, registration=Registration(sigma_m=2e-4, sigma_deg=0.01))
    after, _ = stated.derive(reading)
    lever_m = before.trs_from_cam.translation  # the model's middle is the origin
    grown_m2 = np.trace((after.covariance - before.covariance)[3:, 3:])
    assert grown_m2 == pytest.approx(3 * 2e-4**2 + 2.0 * np.radians(0.01) ** 2 * np.sum(lever_m**2))


def test_truth_follows_from_the_reading_by_the_calibration(taker: ShotTaker) -> None:
    reading = PoseReading(
        RigidTransform.from_translation([0.1, 0.2, 1.0]), np.diag([1e-8] * 3 + [1e-10] * 3), 0.0
    )
    truth, mask = taker.truth_source.derive(reading)
    np.testing.assert_allclose(truth.trs_from_cam.translation, [0.1, 0.2, 1.0])
    np.testing.assert_allclose(truth.trs_from_cam.rotation.apply([0, 0, 1]), [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(truth.covariance, reading.covariance, atol=1e-20)
    assert truth.range_los_m == pytest.approx(1.0)
    # The plane of 2 m x 2 m fills the image of 1.3 m x 1 m as seen from 1 m.
    assert truth.usable_fraction == mask.mean() == 1.0


def test_usable_fraction_falls_with_distance(taker: ShotTaker) -> None:
    reading = PoseReading(RigidTransform.from_translation([0, 0, 4.0]), 1e-12 * np.eye(6), 0.0)
    truth, mask = taker.truth_source.derive(reading)
    # 2 m at 4 m with a focal length of 12 px: 6 px x 6 px of 16 px x 12 px.
    assert mask.sum() == 36
    assert truth.usable_fraction == pytest.approx(36 / (16 * 12))


def test_settle_waits_until_two_looks_agree(taker: ShotTaker, plan: Plan, laboratory: Any) -> None:
    laboratory.shifts_m = [0.0, 0.01, 0.015, 0.0152]
    taker.begin(plan.shots[0], 1)
    numbers = taker.settle()
    assert laboratory.log == ["look"] * 4
    assert numbers["shift_m"] == pytest.approx(2e-4)


def test_settle_gives_up_in_time(taker: ShotTaker, plan: Plan, laboratory: Any) -> None:
    laboratory.shifts_m = [0.01 * (i % 2) for i in range(100)]
    taker.begin(plan.shots[0], 1)
    with pytest.raises(
        NotSettledError, match=r"tracker: the T-MAC still moves after 2 s: 10\.000 mm .*0\.5 mm"
    ):
        taker.settle()
    assert len(laboratory.log) == 10  # 2 s of 0.25 s each, and the looks at both ends


def test_motion_during_the_exposure_is_refused(
    taker: ShotTaker, plan: Plan, laboratory: Any
) -> None:
    laboratory.shifts_m = [0.0, 0.0, 0.0, 0.002]
    with pytest.raises(NotSettledError, match=r"during the exposure: 2\.000 mm"):
        take(taker, plan)


def test_image_of_another_size_is_refused(taker: ShotTaker, plan: Plan) -> None:
    grab = taker.devices.camera.grab

    def grab_half(*, timeout_s: float) -> Any:
        frame = grab(timeout_s=timeout_s)
        return type(frame)(frame.image[:6], "Mono8", 0.01, 0.0, 1, 0.0)

    taker.devices.camera.grab = grab_half  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises(DeviceError, match=r"camera: .*shape \(6, 16\), calibrated is \(12, 16\)"):
        take(taker, plan)


def test_nothing_of_the_last_shot_is_left(taker: ShotTaker, plan: Plan) -> None:
    take(taker, plan)
    taker.begin(plan.shots[1], 1)
    with pytest.raises(RuntimeError, match="no tracker yet"):
        taker.judge()
    with pytest.raises(RuntimeError, match="no judgement yet"):
        taker.assemble()


def let_calls_take(taker: ShotTaker, laboratory: Any, durations_s: Mapping[str, float]) -> None:
    def on_call(call: str) -> None:
        taker.clock.advance(durations_s.get(call, 0.0))

    laboratory.on_call = on_call


CALLS_S = {"move": 8.0, "look": 0.125, "measure": 1.0, "grab": 0.5, "read_room": 0.0625, "point": 3}


def test_every_part_is_timed_by_the_laboratory_s_clock(
    taker: ShotTaker, plan: Plan, laboratory: Any
) -> None:
    let_calls_take(taker, laboratory, CALLS_S)
    timing = take(taker, plan).timing
    assert (timing.move_s, timing.tracker_s, timing.camera_s) == (8.0, 1.0, 0.5)
    assert timing.settle_s == 0.125 + 0.25 + 0.125  # two looks, and the wait between them
    assert (timing.confirm_s, timing.read_s, timing.lost_s) == (0.125, 0.0625, 0.0)


def test_lost_is_all_since_the_last_shot_but_drift_checks(
    taker: ShotTaker, plan: Plan, laboratory: Any
) -> None:
    let_calls_take(taker, laboratory, CALLS_S)
    take(taker, plan)
    taker.clock.advance(0.5)  # the last shot is written
    assert take(taker, plan).timing.lost_s == 0.0
    taker.check_drift(2)  # three reflectors of 3 s
    assert take(taker, plan).timing.lost_s == 0.0
    taker.begin(plan.shots[0], 1)
    taker.move()
    taker.check_drift(3)
    taker.clock.advance(5.0)
    assert take(taker, plan, attempt=2).timing.lost_s == 8.0 + 5.0
    taker.clock.advance(600.0)  # a person has paused the run
    assert take(taker, plan).timing.lost_s == 600.0


def test_time_lost_before_the_first_shot_counts(taker: ShotTaker, plan: Plan) -> None:
    taker.clock.advance(30.0)  # references are rendered
    taker.begin(plan.shots[0], 1)
    taker.clock.advance(0.25)
    assert take(taker, plan, attempt=2).timing.lost_s == 0.25


def test_record_that_was_refused_is_lost_time(
    taker: ShotTaker, plan: Plan, laboratory: Any
) -> None:
    """As while the run waits for the lamp: the shot is taken again, though it was assembled."""
    let_calls_take(taker, laboratory, CALLS_S)
    take(taker, plan)
    refused = take(taker, plan).timing
    taker.clock.advance(60.0)
    found_s = take(taker, plan, attempt=2).timing.lost_s
    assert found_s == 60.0 + 8.0 + 0.5 + 1.0 + 0.5 + 0.125 + 0.0625
    assert refused.lost_s == 0.0


def test_failures_and_session_go_into_the_record(taker: ShotTaker, plan: Plan) -> None:
    taker.session = 3
    ledger: dict[Any, int] = {"tracking_lost": 2}
    taker.begin(plan.shots[0], 3, n_failures=ledger)
    record = take(taker, plan, attempt=3, n_failures=ledger)
    ledger["tracking_lost"] = 7  # of the next shot
    assert (record.n_failures, record.session, record.attempt) == ({"tracking_lost": 2}, 3, 3)


def test_rest_and_motion_during_the_exposure_are_stored(
    taker: ShotTaker, plan: Plan, laboratory: Any
) -> None:
    laboratory.shifts_m = [0.0, 3e-4, 1e-4, 2e-4]
    quality = take(taker, plan).quality
    assert quality.settle_shift_m == pytest.approx(3e-4)
    assert quality.exposure_shift_m == pytest.approx(1e-4)


def scatter(taker: ShotTaker, sigma_m: float) -> None:
    measure_pose = taker.devices.tracker.measure_pose

    def scattering(*, window_s: float) -> PoseReading:
        reading = measure_pose(window_s=window_s)
        covariance = np.diag([1e-12] * 5 + [sigma_m**2])
        return PoseReading(reading.trk_from_tmac, covariance, reading.time_s)

    taker.devices.tracker.measure_pose = scattering  # pyright: ignore[reportAttributeAccessIssue]


def test_poor_shot_is_taken_again_as_often_as_the_gate_says(taker: ShotTaker, plan: Plan) -> None:
    scatter(taker, 1e-3)
    with pytest.raises(QualityError, match=r"tracker: the T-MAC scatters by 1\.000 mm, allowed 0"):
        take(taker, plan, n_failures={"tracking_lost": 4})
    record = take(taker, plan, attempt=2, n_failures={"quality": 1})
    assert "tracker" in record.quality.flags
    assert record.quality.tracker_sigma_m == pytest.approx(1e-3)


def test_gate_without_retakes_only_flags(taker: ShotTaker, plan: Plan) -> None:
    scatter(taker, 1e-3)
    gate = taker.config.gate.model_copy(update={"max_retakes": 0})
    taker.config = taker.config.model_copy(update={"gate": gate})
    assert "tracker" in take(taker, plan).quality.flags


def test_lamp_is_watched_only_where_somebody_predicts_its_light(
    taker: ShotTaker, plan: Plan
) -> None:
    assert take(taker, plan).quality.brightness is None

    class Light:
        def mean_radiance(self, trs_from_cam: RigidTransform) -> float:
            return 0.5

    taker.light = Light()  # pyright: ignore[reportAttributeAccessIssue]
    # grey 10 in 10 ms
    assert take(taker, plan).quality.brightness == pytest.approx(10 / 0.01 / 0.5)
    gate = taker.config.gate.model_copy(update={"brightness": "off"})
    taker.config = taker.config.model_copy(update={"gate": gate})
    assert take(taker, plan).quality.brightness is None
