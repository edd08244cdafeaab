"""Drift checks of a campaign: do the reflectors still lie where the calibration record has them?"""

import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from tronlab.calib.inputs import FrameInput
from tronlab.calib.record import CalibrationRecord
from tronlab.calib.reflectors.drift import compare_reflectors
from tronlab.calib.results import FrameResult
from tronlab.campaign.acceptance import Acceptance
from tronlab.campaign.config import DriftConfig, RetryConfig
from tronlab.campaign.policy import class_of, pause_before_next_s
from tronlab.dataset.records import DriftRecord
from tronlab.devices.protocols import PoseTracker
from tronlab.devices.readings import PointReading
from tronlab.errors import CalibrationError, DeviceError


@dataclass(frozen=True)
class DriftWatch:
    """Measures the reflectors of a calibration record, and tells whether something has moved."""

    tracker: PoseTracker
    frame_input: FrameInput
    frame: FrameResult
    config: DriftConfig
    advice: str
    """What to do if something has moved."""

    @property
    def reflectors(self) -> tuple[str, ...]:
        """Get the names of the reflectors."""
        return tuple(self.frame_input.points)

    def check(self, n_shots_before: int) -> DriftRecord:
        """Measure every reflector.

        Raises:
            TrackingLostError: The beam does not reach one of them.
        """
        readings = {
            name: self.tracker.measure_point(name, window_s=self.config.window_s)
            for name in self.reflectors
        }
        return judge(
            readings,
            n_shots_before=n_shots_before,
            frame_input=self.frame_input,
            frame=self.frame,
            limit_m=self.config.limit_m,
        )

    def describe(self, check: DriftRecord) -> str:
        """Say in one line when a check was and what seems to have moved."""
        found = compare_reflectors(
            check.readings, self.frame_input, self.frame, limit_m=check.limit_m
        )
        when = f"after {check.n_shots_before} shots" if check.n_shots_before else "at the start"
        return f"drift check {when}: {found.text}"


@dataclass(frozen=True)
class DriftChecks:
    """When the reflectors are measured anew in a run, and where the result goes."""

    every_n_shots: int | None
    """None: only after the last shot."""
    commit: Callable[[DriftRecord, bool], None]
    """Stores a check, given whether it is the last one; whatever it raises ends the run."""


@dataclass(frozen=True)
class Vigil:
    """The watch of a run, after its first check was passed."""

    watch: DriftWatch
    first: DriftRecord

    def checks(
        self,
        store: Callable[[DriftRecord], None],
        *,
        announce: Callable[[str], None],
    ) -> DriftChecks:
        """Give the checks of the run: all are stored, and drift ends it unless told otherwise.

        After the last check there is nothing to end. Drift that was accepted at the start does not
        end it later.

        Args:
            store: Puts a check into the dataset, the first one at once.
            announce: Told what each check found.
        """
        watch = self.watch
        goes_on = watch.config.on_drift == "continue" or not self.first.is_within

        def commit(check: DriftRecord, is_last: bool) -> None:
            store(check)
            found = watch.describe(check)
            if check.is_within:
                announce(found)
                return
            found += "; the shots since the last good check are suspect"
            if not (goes_on or is_last):
                raise CalibrationError(f"{found};\n{watch.advice}")
            announce(found)

        store(self.first)
        return DriftChecks(every_n_shots=watch.config.every_n_shots, commit=commit)


def open_watch(
    tracker: PoseTracker,
    calibration: CalibrationRecord,
    config: DriftConfig | None,
    *,
    advice: str,
) -> DriftWatch | None:
    """Give the watch of a campaign; None if it wants none or the record has no reflectors."""
    frame_input, frame = calibration.inputs.frame, calibration.results.frame
    if config is None or frame_input is None or frame is None:
        return None
    return DriftWatch(tracker, frame_input, frame, config, advice)


def begin_vigil(
    watch: DriftWatch,
    acceptance: Acceptance,
    *,
    on_retry: Callable[[int, DeviceError], None],
    retry: RetryConfig | None = None,
    sleep: Callable[[float], None] = time.sleep,
) -> Vigil:
    """Look, before anything moves, whether the calibration still holds.

    Args:
        watch: Measures.
        acceptance: Whether a person lets drift pass.
        on_retry: Told of an attempt that failed, if another follows.
        retry: How often it is tried; by default as often as a campaign that does not say.
        sleep: Waits between attempts.

    Raises:
        CalibrationError: Something has moved, and this was not accepted.
        DeviceError: The reflectors cannot be measured.
    """
    first = _patiently(
        lambda: watch.check(0), on_retry=on_retry, retry=retry or RetryConfig(), sleep=sleep
    )

    def refuse_drift() -> None:
        if not first.is_within:
            raise CalibrationError(f"{watch.describe(first)};\n{watch.advice}")

    acceptance.let_pass(refuse_drift)
    return Vigil(watch, first)


def n_checks(n_shots: int, config: DriftConfig) -> int:
    """Give how many drift checks a run of so many shots has, the one at the start included."""
    every = config.every_n_shots or n_shots
    return 2 + (n_shots - 1) // every


def judge(
    readings: Mapping[str, PointReading],
    *,
    n_shots_before: int,
    frame_input: FrameInput,
    frame: FrameResult,
    limit_m: float,
) -> DriftRecord:
    """Compare readings with those of a calibration record, for a dataset."""
    found = compare_reflectors(readings, frame_input, frame, limit_m=limit_m)
    return DriftRecord(
        n_shots_before=n_shots_before,
        time_s=found.time_s,
        readings=readings,
        shift=found.shift,
        max_shift_m=found.max_shift_m,
        limit_m=limit_m,
        is_within=found.is_within,
    )


def _patiently(
    measure: Callable[[], DriftRecord],
    *,
    on_retry: Callable[[int, DeviceError], None],
    retry: RetryConfig,
    sleep: Callable[[float], None],
) -> DriftRecord:
    """Measure, and try again where it may help: whoever stands in the beam may go on."""
    rules = {"tracking_lost": retry.tracking_lost, "not_ready": retry.not_ready}
    n_failures: Counter[str] = Counter()
    while True:
        try:
            return measure()
        except DeviceError as error:
            kind = class_of(error)
            if kind not in rules:
                raise
            n_failures[kind] += 1
            pause_s = pause_before_next_s(rules[kind], n_failures[kind])
            if pause_s is None:
                raise
            on_retry(n_failures.total(), error)
            sleep(pause_s)
