from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from tronlab.campaign.shot import ShotTaker
from tronlab.devices.readings import PoseReading
from tronlab.errors import DeviceError, NotSettledError
from tronlab.planning.shots import Plan


def take(taker: ShotTaker, plan: Plan) -> Any:
    taker.begin(plan.shots[0], 1)
    taker.move()
    taker.settle()
    taker.measure()
    taker.grab()
    taker.confirm()
    taker.read()
    return taker.assemble()


def test_record_holds_what_was_read(taker: ShotTaker, plan: Plan) -> None:
    record = take(taker, plan)
    assert (record.shot_id, record.attempt) == (1, 1)
    assert record.trs_from_cam_nominal is plan.shots[0].trs_from_cam_nominal
    assert record.robot.rail_m == 10.0
    assert (record.frame.image == 10).all()
    np.testing.assert_allclose(record.tracker.trk_from_tmac.translation, [0, 0, 10])


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
        taker.assemble()
