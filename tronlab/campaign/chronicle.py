"""What becomes of everything that happens in a session: stored, written down, shown, told."""

from collections.abc import Collection, Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from time import perf_counter

from tronlab.campaign.config import NotifyEvent
from tronlab.campaign.console import Abort, Decision, Note, Pause, Resume, Retake
from tronlab.campaign.listener import RunListener
from tronlab.campaign.live import RUNNING, SHOTS, Live
from tronlab.campaign.notify import Notifier
from tronlab.campaign.shot import ShotTaker
from tronlab.campaign.stop import RunStoppedError
from tronlab.campaign.suspension import Suspension
from tronlab.dataset.journal import Journal
from tronlab.dataset.records import Session, ShotRecord
from tronlab.dataset.writer import DatasetWriter
from tronlab.errors import DatasetError


class CampaignInterrupted(KeyboardInterrupt):  # it is no error that a person stops
    """The run was stopped by a person; the dataset is closed and readable."""


@dataclass(frozen=True, slots=True)
class Scope:
    """What a session is about: shots by id."""

    planned: frozenset[int]
    """All that the dataset shall have."""
    to_take: frozenset[int]
    """Those of this session."""
    for_later: frozenset[int] = frozenset()
    """Those that are missing, but nobody wants to be taken now."""


class Chronicle:
    """Keeps the dataset, its journal, the live view and the notify command in step."""

    def __init__(
        self,
        writer: DatasetWriter,
        journal: Journal,
        live: Live,
        notifier: Notifier,
        *,
        scope: Scope,
    ) -> None:
        self._writer = writer
        self._journal = journal
        self._live = live
        self._notifier = notifier
        self._scope = scope
        self._taken: set[int] = set()
        """Ids of the shots stored in this session."""
        self._write_s = 0.0
        """How long the last shot took to write."""
        self._skipped: frozenset[int] = frozenset()

    @property
    def listener(self) -> RunListener:
        """Get who listens to the engine."""
        return RunListener(
            on_shot=self._on_shot,
            on_retry=self._on_retry,
            on_skip=self._on_skip,
            on_suspend=self._on_suspend,
            on_resume=self._on_resume,
            on_pause=self._on_pause,
            on_decision=self._on_decision,
        )

    def commit(self, record: ShotRecord, replaces: bool) -> None:  # the engine's
        """Store a shot; one that is in the dataset from an earlier session is replaced as well."""
        begin_s = perf_counter()
        self._writer.commit(
            record, replaces=replaces or record.shot_id in self._writer.committed_ids
        )
        self._write_s = perf_counter() - begin_s

    def note_skipped(self, shot_ids: Collection[int]) -> None:
        """Take note of the shots of which nothing is stored after all."""
        self._skipped = frozenset(shot_ids)

    @contextmanager
    def of_session(self, session: Session, taker: ShotTaker) -> Generator[None]:
        """Write down how a session begins and ends; however it ends, the dataset says how."""
        self._write(
            "session",
            f"session {session.number} ({session.kind}) begins",
            session=session.number,
            session_kind=session.kind,
            accepted=list(session.accepted),
            n_shots=len(self._scope.to_take),
            **({"shot_ids": sorted(self._scope.to_take)} if session.kind == "retake" else {}),
        )
        self._tell("begun", f"session {session.number} begins")
        self._advance()
        try:
            yield
            self._finish()
        except (RunStoppedError, KeyboardInterrupt):
            with suppress(DatasetError):  # interrupted while the first or the last was written
                self._writer.finish("aborted", reason="stopped by the operator")
            self._end("aborted", f"stopped: {self._so_far()}")
            raise CampaignInterrupted(f"stopped: {self._so_far()}; {self._advice}") from None
        except Exception as error:
            with suppress(DatasetError):  # a full disk must not hide why the run failed
                self._writer.finish("failed", reason=f"{taker.in_hand}: {error}")
            self._end("failed", f"the run failed at {taker.in_hand}: {error}")
            self._live.announce(
                f"the run failed at {taker.in_hand}; {self._so_far()}; when the cause is mended,"
                f" {self._advice}"
            )
            raise

    def _finish(self) -> None:
        if self._writer.n_committed == 0:
            raise DatasetError(f"no shot was recorded, all were skipped: {_list(self._skipped)}")
        missing = self._scope.planned - self._writer.committed_ids
        self._writer.finish(
            "aborted" if self._scope.for_later else "complete",
            reason=f"not taken: {_list(missing)}" if missing else "",
        )
        self._end("done", self._so_far())
        self._live.announce(self._so_far())
        if self._scope.for_later:
            self._live.announce(f"not taken yet: {_list(self._scope.for_later)}; {self._advice}")
        if self._skipped:
            self._live.announce(
                f"skipped: {_list(self._skipped)}; take them later: tronlab run --retake"
                f" {self._writer.path.parent} --shots {_list(self._skipped, ',')}"
            )

    def _so_far(self) -> str:
        n_taken, n_planned = self._writer.n_committed, len(self._scope.planned)
        if n_taken == 0:
            return "no shot was recorded"
        return f"{n_taken} of {n_planned} shots are in {self._writer.path}"

    @property
    def _advice(self) -> str:
        if self._writer.n_committed == 0:
            return "begin anew: tronlab run CAMPAIGN.yaml"
        return f"go on: tronlab run --resume {self._writer.path.parent}"

    def _advance(self) -> None:
        self._live.advance(SHOTS, n_done=len(self._taken), n_all=len(self._scope.to_take))

    def _on_shot(self, record: ShotRecord) -> None:
        self._live.show_shot(record, write_s=self._write_s)
        self._taken.add(record.shot_id)
        self._advance()
        if record.quality is not None and record.quality.flags:
            flags = ", ".join(record.quality.flags)
            self._write("flagged", f"shot {record.shot_id}: {flags}", shot_id=record.shot_id)

    def _on_retry(self, task: str, attempt: int, error: Exception) -> None:
        text = f"{task}, attempt {attempt}: {error}"
        self._live.announce(text)
        self._write("retry", text, attempt=attempt, error=type(error).__name__)

    def _on_skip(self, shot_id: int, why: str) -> None:
        self._live.announce(f"shot {shot_id} is skipped: {why}")
        self._write("skipped", f"shot {shot_id}: {why}", shot_id=shot_id)

    def _on_suspend(self, suspension: Suspension) -> None:
        self._show(str(suspension), state=str(suspension))
        self._write("suspended", str(suspension), condition=suspension.condition)
        self._tell("suspended", str(suspension))

    def _on_resume(self, suspension: Suspension) -> None:
        text = f"{suspension.task} goes on"
        self._show(text)
        self._write("resumed", text, condition=suspension.condition)
        self._tell("resumed", text)

    def _on_pause(self, pause: Pause) -> None:
        self._write("paused", str(pause))

    def _on_decision(self, decision: Decision) -> None:
        match decision:
            case Note(text=text):
                self._write("note", text)
            case Retake(shot_ids=shot_ids):
                text = f"shots {', '.join(map(str, shot_ids))} are taken again"
                self._show(text)
                self._write("retaken", text, shot_ids=list(shot_ids))
            case Resume():
                text = "the operator lets the run go on"
                self._show(text)
                self._write("resumed", text)
            case Abort():
                self._write("note", "the operator ends the run")

    def _show(self, text: str, *, state: str = RUNNING) -> None:
        """Say what happens, and keep saying what the run does now."""
        self._live.announce(text)
        self._live.state(state)

    def _end(self, event: NotifyEvent, text: str) -> None:
        self._write("finished", text, status=event)
        self._tell(event, text)

    def _write(self, kind: str, text: str, **fields: object) -> None:
        """Append to the journal; what happens to the journal must not end the run."""
        try:
            self._journal.write(kind, text, **fields)
        except DatasetError as error:
            self._live.announce(f"not in the journal: {text} ({error})")

    def _tell(self, event: NotifyEvent, text: str) -> None:
        self._notifier.tell(
            event, text, n_taken=self._writer.n_committed, n_planned=len(self._scope.planned)
        )


def _list(shot_ids: Collection[int], separator: str = ", ") -> str:
    return separator.join(map(str, sorted(shot_ids)))
