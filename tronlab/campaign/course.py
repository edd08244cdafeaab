"""The course of one run: what is done, what is due, and who is told; the engine drives it."""

from collections.abc import Callable, Collection, Mapping
from typing import Any

from tronlab.campaign.console import Pause
from tronlab.campaign.drift import DriftChecks
from tronlab.campaign.listener import RunListener
from tronlab.campaign.policy import (
    OF_THE_DEVICE,
    Again,
    DiskNearlyFullError,
    LampDriftError,
    Reaction,
    Setbacks,
    class_of,
)
from tronlab.campaign.schedule import Schedule
from tronlab.campaign.shot import ShotTaker
from tronlab.campaign.steps import Attempt, Numbers
from tronlab.campaign.stop import StopRequest
from tronlab.dataset.records import DriftRecord, ShotRecord
from tronlab.errors import DatasetError, DeviceError
from tronlab.planning.shots import Plan

_NAP_S = 0.2
"""Nobody who pauses a run waits longer for a pause between two attempts to end."""


class Course:
    """What the tasks of one run share."""

    def __init__(
        self,
        plan: Plan,
        taker: ShotTaker,
        *,
        commit: Callable[[ShotRecord, bool], None],
        drift: DriftChecks | None,
        stop: StopRequest,
        listener: RunListener,
        free_bytes: Callable[[], int] | None,
        n_spare_rows: int | None,
    ) -> None:
        self.schedule = Schedule(plan)
        self.taker = taker
        self.stop = stop
        self.listener = listener
        self.lost_device: str | None = None
        """To connect again before the next attempt."""
        self.is_ending = False
        """A person has ended the run: no shot follows."""
        self._commit = commit
        self._drift = drift
        self._free_bytes = free_bytes
        self._n_spare_rows = n_spare_rows
        self._shots: dict[tuple[int, int], ShotRecord] = {}
        """The mailbox: by id and attempt."""
        self._checks: dict[int, DriftRecord] = {}
        """The mailbox of drift checks: by the number of shots before."""
        self._n_at_last_check = 0
        """A check before the first shot is made before the engine starts."""

    @property
    def has_unchecked_shots(self) -> bool:
        """Get whether shots were stored since the last drift check, if there are such checks."""
        return self._drift is not None and self.schedule.n_commits > self._n_at_last_check

    @property
    def is_check_due(self) -> bool:
        """Get whether it is time for a drift check: after so many shots, and after the last one."""
        if self._drift is None or not self.has_unchecked_shots:
            return False
        every = self._drift.every_n_shots
        n_unchecked = self.schedule.n_commits - self._n_at_last_check
        return not self.schedule.has_next or (every is not None and n_unchecked >= every)

    def can_skip(self, error: BaseException | None) -> bool:
        """Tell whether the shot in hand may be left out after an error: the next may do better."""
        retry = self.taker.config.retry
        return (
            retry.on_failure == "skip"
            and class_of(error) not in OF_THE_DEVICE
            and self.schedule.n_skipped_in_row < retry.max_skipped_in_row
        )

    def begin(self, attempt: Attempt) -> None:
        """Forget what was before an attempt at a shot."""
        self.taker.begin(attempt.shot, attempt.number, n_failures=attempt.n_failures)

    def check_before_shot(self) -> None:
        """Look whether a shot may begin: the room is safe, and the disk has room.

        Raises:
            SafetyError: The room is not safe.
            DiskNearlyFullError: There is less than ``suspend.min_free_mb``.
            DatasetError: Nobody knows.
        """
        self.taker.check_room()
        if self._free_bytes is None:
            return
        try:
            free_mb = self._free_bytes() / 1e6
        except OSError as error:
            raise DatasetError(f"the room left on the disk cannot be read: {error}") from error
        wanted_mb = self.taker.config.suspend.min_free_mb
        if free_mb < wanted_mb:
            raise DiskNearlyFullError(
                f"only {free_mb:.0f} MB are free on the disk of the dataset,"
                f" suspend.min_free_mb is {wanted_mb:g}; make room"
            )

    def judge(self) -> Numbers:
        """See whether the shot is good enough, and whether the lamp is as it was.

        Raises:
            QualityError: The gate wants the shot taken again.
            LampDriftError: The light has changed, and the campaign waits for it.
        """
        numbers = self.taker.judge()
        objection = self.taker.objections.get("brightness")
        if objection is not None and self.taker.config.suspend.on_lamp_drift:
            raise LampDriftError(
                f"the light has changed: {objection}; look after the lamp, or press Ctrl-C and"
                " resume to go on with the light there is",
                device=self.taker.devices.room.name,
            )
        return numbers

    def post_shot(self) -> Numbers:
        """Put the record of the shot into the mailbox."""
        record = self.taker.assemble()
        self._shots[record.shot_id, record.attempt] = record
        return {
            "shot_id": record.shot_id,
            "attempt": record.attempt,
            "range_los_m": record.truth.range_los_m,
            "usable_fraction": record.truth.usable_fraction,
        }

    def post_check(self) -> Numbers:
        """Check for drift, and put the result into the mailbox."""
        check = self.taker.check_drift(self.schedule.n_commits)
        self._checks[check.n_shots_before] = check
        return {"n_shots_before": check.n_shots_before, "max_shift_m": check.max_shift_m}

    def take_document(self, name: str, document: Mapping[str, Any]) -> None:
        """Commit what an event speaks of."""
        if name != "event":
            return
        data = document["data"]
        if "shot_id" in data:
            self._take_shot(self._shots.pop((data["shot_id"], data["attempt"])))
        else:
            self._take_check(self._checks.pop(data["n_shots_before"]))

    def _take_shot(self, record: ShotRecord) -> None:
        """Commit a shot; a replayed event finds it committed."""
        if not self.schedule.is_in_hand(record.shot_id):
            return
        self._commit(record, record.shot_id in self.schedule.stored)
        self.schedule.note_stored()
        self.listener.on_shot(record)

    def _take_check(self, check: DriftRecord) -> None:
        """Commit a drift check; a replayed event finds it committed."""
        if self._drift is None or check.n_shots_before == self._n_at_last_check:
            return
        self._n_at_last_check = check.n_shots_before
        self._drift.commit(check, self.is_ending or not self.schedule.has_next)

    def react(self, setbacks: Setbacks, error: BaseException | None) -> Reaction:
        """Note a setback, say what to do about it, and tell whoever listens."""
        attempt, before = setbacks.attempt, setbacks.suspension
        reaction = setbacks.react(
            error, now_s=self.taker.clock.monotonic_s, is_in_place=self.taker.is_in_place
        )
        if before is not None and setbacks.suspension is not before:
            self.listener.on_resume(before)
        if setbacks.suspension is not None and setbacks.suspension is not before:
            self.listener.on_suspend(setbacks.suspension)
        if isinstance(reaction, Again) and isinstance(error, Exception):
            self.listener.on_retry(setbacks.task, attempt, error)
        if isinstance(error, DeviceError) and class_of(error) == "lost_connection":
            self.lost_device = error.device
        return reaction

    def tell_resumed(self, setbacks: Setbacks) -> None:
        """Say that what the task waited for is over."""
        if setbacks.suspension is not None:
            self.listener.on_resume(setbacks.suspension)

    def skip(self, setbacks: Setbacks, error: BaseException | None) -> None:
        """Leave the shot in hand out."""
        why = f"{error} ({setbacks.n_failures.total()} attempts)"
        shot_id = self.schedule.skip(why)
        self.listener.on_skip(shot_id, why)

    def nap(self, duration_s: float) -> None:
        """Let time pass, until somebody wants the run to pause or stop."""
        clock = self.taker.clock
        wake_up_s = clock.monotonic_s + duration_s
        while not self.stop.is_asked and (left_s := wake_up_s - clock.monotonic_s) > 0.0:
            clock.advance(min(left_s, _NAP_S))

    def pause(self, setbacks: Setbacks | None) -> Pause:
        """Say how the run stands, for a person to decide."""
        return Pause(
            committed=self.schedule.stored,
            skipped=dict(self.schedule.skipped),
            n_left=self.schedule.n_left,
            n_retakes_left=self._n_retakes_left,
            suspension=setbacks.suspension if setbacks is not None else None,
        )

    def retake(self, shot_ids: Collection[int]) -> None:
        """Take shots again before those to come, as far as they have been taken."""
        pause = self.pause(None)
        refusal = pause.refusal_to_retake(shot_ids)
        if refusal is None:
            self.schedule.retake(shot_ids)
        else:
            self.taker.warn(f"nothing is taken again: {refusal}")

    def accept_light(self, setbacks: Setbacks | None) -> None:
        """Go on with the light there is, if the run waited for it."""
        if setbacks is not None and setbacks.waits_for("lamp"):
            self.taker.gate.renew_light()

    def renew_patience(self, setbacks: Setbacks | None) -> None:
        """Wait as long again for what the run waited for when a person paused it."""
        if setbacks is not None and setbacks.suspension is not None:
            setbacks.renew_patience(self.taker.clock.monotonic_s)
            self.listener.on_suspend(setbacks.suspension)

    @property
    def _n_retakes_left(self) -> int | None:
        if self._n_spare_rows is None:
            return None
        return self._n_spare_rows - self.schedule.n_retakes
