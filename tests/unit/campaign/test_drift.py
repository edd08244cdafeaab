from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tronlab.calib.record import CalibrationRecord
from tronlab.campaign.acceptance import Acceptance
from tronlab.campaign.config import DriftConfig
from tronlab.campaign.drift import DriftWatch, begin_vigil, n_checks, open_watch
from tronlab.campaign.stop import StopRequest
from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import Provenance
from tronlab.dataset.writer import DatasetWriter
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
    with pytest.raises(CalibrationError, match=r"(?s)at the start: .*anew\nor use it all the same"):
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
    ("on_drift", "n_shots_before", "is_asked", "is_raised"),
    [
        ("stop", 2, False, True),
        ("continue", 2, False, False),
        ("stop", 4, False, False),
        ("stop", 2, True, False),
    ],
)
def test_drift_ends_a_run_that_is_not_over(
    watch: DriftWatch,
    laboratory: Any,
    tmp_path: Path,
    make_provenance: Callable[..., Provenance],
    on_drift: str,
    n_shots_before: int,
    is_asked: bool,
    is_raised: bool,
) -> None:
    config = watch.config.model_copy(update={"on_drift": on_drift})
    watch = replace(watch, config=config)
    stop = StopRequest()
    if is_asked:
        stop.ask()
    announced: list[str] = []
    with DatasetWriter(tmp_path / "a.h5", make_provenance(4)) as writer:
        checks = begin(watch).checks(writer, n_shots=4, stop=stop, announce=announced.append)
        laboratory.drift_m = 0.001
        check = watch.check(n_shots_before)
        if is_raised:
            with pytest.raises(CalibrationError, match=r"suspect;\nmeasure anew$"):
                checks.commit(check)
        else:
            checks.commit(check)
        assert any("suspect" in text for text in announced) is not is_raised
        writer.finish("aborted")
    with Dataset(tmp_path / "a.h5") as dataset:
        assert [check.is_within for check in dataset.drift_checks] == [True, False]


def test_drift_accepted_at_the_start_does_not_end_the_run_later(
    watch: DriftWatch,
    laboratory: Any,
    tmp_path: Path,
    make_provenance: Callable[..., Provenance],
) -> None:
    laboratory.drift_m = 0.001
    vigil = begin(watch, is_accepted=True)
    announced: list[str] = []
    with DatasetWriter(tmp_path / "a.h5", make_provenance(4)) as writer:
        checks = vigil.checks(writer, n_shots=4, stop=StopRequest(), announce=announced.append)
        checks.commit(watch.check(2))
        writer.finish("aborted")
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
