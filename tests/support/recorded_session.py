"""A run that notes what happens, and a person who answers from a list."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from tronlab.campaign.config import CampaignConfig
from tronlab.campaign.console import Abort, Decision, Pause
from tronlab.campaign.engine import RunOutcome, run_shots
from tronlab.campaign.listener import RunListener
from tronlab.campaign.shot import ShotTaker
from tronlab.dataset.records import ShotRecord
from tronlab.planning.shots import Plan


@dataclass
class RecordedSession:
    """A run of a plan, and all that is told of it."""

    taker: ShotTaker
    plan: Plan
    records: list[ShotRecord] = field(default_factory=list[ShotRecord])
    """In the order they were committed."""
    replaced: list[int] = field(default_factory=list[int])
    """Ids of records that were to replace an earlier one."""
    told: list[str] = field(default_factory=list[str])

    @property
    def ids(self) -> list[int]:
        """Get the ids of the records, in their order."""
        return [record.shot_id for record in self.records]

    @property
    def attempts(self) -> list[int]:
        """Get the attempts of the records, in their order."""
        return [record.attempt for record in self.records]

    def configure(self, **sections: dict[str, Any]) -> None:
        """Change keys of the campaign, section by section."""
        values = self.taker.config.model_dump()
        for name, changes in sections.items():
            values[name] |= changes
        self.taker.config = CampaignConfig.model_validate(values)

    def commit(self, record: ShotRecord, replaces: bool) -> None:
        """Keep a record."""
        self.records.append(record)
        if replaces:
            self.replaced.append(record.shot_id)

    def run(self, **options: Any) -> RunOutcome:
        """Take the shots."""
        listener = RunListener(
            on_retry=lambda task, attempt, error: self.told.append(
                f"retry {task}, attempt {attempt}: {type(error).__name__}"
            ),
            on_skip=lambda shot_id, why: self.told.append(f"skip {shot_id}: {why}"),
            on_suspend=lambda suspension: self.told.append(f"suspend: {suspension}"),
            on_resume=lambda suspension: self.told.append(f"resume {suspension.condition}"),
            on_pause=lambda pause: self.told.append(f"pause: {pause}"),
            on_decision=lambda decision: self.told.append(repr(decision)),
        )
        return run_shots(
            self.plan, self.taker, **{"commit": self.commit, "listener": listener} | options
        )


@dataclass
class ScriptedPerson:
    """Answers from a list; does not know what to say after it."""

    answers: list[Decision]
    before_answer: Callable[[], None] = lambda: None
    asked: list[Pause] = field(default_factory=list[Pause])
    is_dismissed: bool = False

    def ask(self, pause: Pause) -> Decision:
        """Give the next answer."""
        self.asked.append(pause)
        self.before_answer()
        return self.answers.pop(0) if self.answers else Abort()

    def dismiss(self) -> None:
        """Note it."""
        self.is_dismissed = True
