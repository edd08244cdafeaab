from dataclasses import replace
from typing import Any

import pytest

from tronlab.calib.record import CalibrationRecord
from tronlab.campaign.acceptance import Acceptance
from tronlab.campaign.config import DriftConfig
from tronlab.campaign.drift import DriftWatch, begin_vigil, n_checks, open_watch
from tronlab.dataset.records import DriftRecord
from tronlab.devices.registry import Devices
from tronlab.errors import CalibrationError, DeviceFaultError, TrackingLostError


@pytest.fixture
def watch(devices: Devices, calibration: CalibrationRecord) -> DriftWatch:
    watch = open_watch(devices.tracker, calibration, DriftConfig(), advice="measure anew")
    assert watch is not None
    return watch


def silent(is_given: bool) -> Acceptance:
    return Acceptance(is_given, warn=lambda text: None)


def begin(watch: DriftWatch, *, is_accepted: bool = False) -> Any:
    return begin_vigil(
        watch,
        silent(is_accepted),
        on_retry=lambda attempt, error: None,
        sleep=lambda duration_s: None,
    )


def test_a_check_sees_how_far_the_tracker_moved(watch: DriftWatch, laboratory: Any) -> None:
    assert watch.check(0).max_shift_m == pytest.approx(0.0, abs=1e-12)
    laboratory.drift_m = 0.001
    check = watch.check(3)
    assert not check.is_within
    assert check.max_shift_m == pytest.approx(0.001 * 3**0.5)
    assert check.shift[3:] == pytest.approx([0.001] * 3)
    assert check.n_shots_before == 3
    assert watch.describe(check).startswith("drift check after 3 shots: the tracker moved")


def test_nothing_begins_when_the_tracker_moved_unless_accepted(
    watch: DriftWatch, laboratory: Any
) -> None:
    laboratory.drift_m = 0.001
    with pytest.raises(CalibrationError, match=r"(?s)at the start: .*anew\nor go on all the same"):
        begin(watch)
    assert not begin(watch, is_accepted=True).first.is_within


def test_the_first_check_is_tried_again_like_a_shot(watch: DriftWatch, laboratory: Any) -> None:
    lost = TrackingLostError("measure_point: beam broken", device="tracker")
    told: list[int] = []
    slept: list[float] = []
    laboratory.failures = {("point", 1): lost, ("point", 4): lost}
    vigil = begin_vigil(
        watch,
        silent(False),
        on_retry=lambda attempt, error: told.append(attempt),
        sleep=slept.append,
    )
    assert vigil.first.is_within
    assert (told, slept) == ([1, 2], [1.0, 5.0])
    laboratory.failures = {("point", k): lost for k in range(1, 20)}
    with pytest.raises(TrackingLostError):
        begin(watch)
    laboratory.failures = {("point", k): DeviceFaultError("laser off", device="tracker", code=1)
                           for k in range(1, 20)}  # fmt: skip
    laboratory.log.clear()
    with pytest.raises(DeviceFaultError):
        begin(watch)
    assert laboratory.log == ["point"]


@pytest.mark.parametrize(
    ("on_drift", "is_last", "is_raised"),
    [("stop", False, True), ("continue", False, False), ("stop", True, False)],
)
def test_drift_ends_a_run_that_is_not_over(
    watch: DriftWatch, laboratory: Any, on_drift: str, is_last: bool, is_raised: bool
) -> None:
    config = watch.config.model_copy(update={"on_drift": on_drift})
    watch = replace(watch, config=config)
    announced: list[str] = []
    stored: list[DriftRecord] = []
    checks = begin(watch).checks(stored.append, announce=announced.append)
    laboratory.drift_m = 0.001
    check = watch.check(2)
    if is_raised:
        with pytest.raises(CalibrationError, match=r"suspect;\nmeasure anew$"):
            checks.commit(check, is_last)
    else:
        checks.commit(check, is_last)
    assert any("suspect" in text for text in announced) is not is_raised
    assert [check.is_within for check in stored] == [True, False]


def test_drift_accepted_at_the_start_does_not_end_the_run_later(
    watch: DriftWatch, laboratory: Any
) -> None:
    laboratory.drift_m = 0.001
    vigil = begin(watch, is_accepted=True)
    announced: list[str] = []
    checks = vigil.checks(lambda _check: None, announce=announced.append)
    checks.commit(watch.check(2), False)
    assert "suspect" in announced[0]


def test_there_is_no_watch_without_reflectors_or_wish(
    devices: Devices, calibration: CalibrationRecord
) -> None:
    assert open_watch(devices.tracker, calibration, None, advice="") is None
    without = replace(calibration, inputs=calibration.inputs.with_parts(frame=None))
    assert open_watch(devices.tracker, without, DriftConfig(), advice="") is None


@pytest.mark.parametrize(
    ("n_shots", "every", "expected"),
    [(61, 20, 5), (60, 20, 4), (1, 20, 2), (1, 1, 2), (5, None, 2), (5, 1, 6)],
)
def test_room_is_made_for_every_check(n_shots: int, every: int | None, expected: int) -> None:
    assert n_checks(n_shots, DriftConfig(every_n_shots=every)) == expected
