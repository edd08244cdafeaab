"""What of a study is done: the file ``study.json`` in its folder."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, TypeAlias

from tronlab.dataset.skeleton import utc_now
from tronlab.errors import ConfigError
from tronlab.study.steps import Step
from tronlab.study.writing import replace_text

LEDGER_NAME = "study.json"

State: TypeAlias = Literal["begun", "done"]


@dataclass(frozen=True, slots=True)
class Entry:
    """A step that was begun or done."""

    key: str
    state: State
    seconds: float = 0.0
    """It took; of one that was begun several times all of them."""
    peak_memory_mb: float | None = None
    """The most that this process and its children held at a time; None if it is not known."""
    ended_utc: str = ""
    """ISO 8601; empty while it is not done."""


@dataclass(slots=True)
class Ledger:
    """Says what is done; it is written anew after each change."""

    path: Path
    head: Mapping[str, Any]
    """What was studied, and with which versions."""
    entries: dict[str, Entry] = field(default_factory=dict[str, Entry])
    """By name of the step."""

    def is_done(self, step: Step) -> bool:
        """Tell whether a step is done, and its results are still there."""
        entry = self.entries.get(step.name)
        return (
            entry is not None
            and (entry.key, entry.state) == (step.key, "done")
            and all((self.path.parent / result).exists() for result in step.results)
        )

    def is_begun(self, step: Step) -> bool:
        """Tell whether a step was begun with the same key."""
        entry = self.entries.get(step.name)
        return entry is not None and entry.key == step.key

    @property
    def took_s(self) -> dict[str, float]:
        """Get how long steps took that were done, by name; they may have changed since."""
        return {
            name: entry.seconds for name, entry in self.entries.items() if entry.state == "done"
        }

    @property
    def peak_memory_mb(self) -> float | None:
        """Get the most that any step held; None if it is not known."""
        return _most([entry.peak_memory_mb for entry in self.entries.values()])

    def begin(self, step: Step) -> None:
        """Note that a step begins; results of another key go away first.

        Else a step that is stopped before it clears up would go on with them.
        """
        if not self.is_begun(step):
            for result in step.results:
                (self.path.parent / result).unlink(missing_ok=True)
        before = self.entries.get(step.name)
        goes_on = before is not None and (before.key, before.state) == (step.key, "begun")
        self.entries[step.name] = before if goes_on and before else Entry(step.key, "begun")
        self.save()

    def add(
        self, step: Step, *, seconds: float, peak_memory_mb: float | None, is_done: bool
    ) -> None:
        """Note how long a step took, and whether it was finished."""
        entry = self.entries[step.name]
        self.entries[step.name] = replace(
            entry,
            state="done" if is_done else "begun",
            seconds=entry.seconds + seconds,
            peak_memory_mb=_most([entry.peak_memory_mb, peak_memory_mb]),
            ended_utc=utc_now() if is_done else "",
        )
        self.save()

    def keep_only(self, names: frozenset[str]) -> None:
        """Forget steps that the study does not have any more."""
        gone = self.entries.keys() - names
        for name in gone:
            del self.entries[name]
        if gone:
            self.save()

    def save(self) -> None:
        """Write the file.

        Raises:
            ConfigError: It cannot be written.
        """
        steps = [{"name": name, **asdict(entry)} for name, entry in self.entries.items()]
        replace_text(self.path, json.dumps({**self.head, "steps": steps}, indent=2) + "\n")


def open_ledger(out: Path, head: Mapping[str, Any]) -> Ledger:
    """Read what is done in a folder; one without the file must be new or empty.

    Args:
        out: Folder of the study.
        head: What the file says besides: title, versions.

    Raises:
        ConfigError: There is something else in the folder, or the file is damaged.
    """
    path = out / LEDGER_NAME
    if not path.exists():
        return Ledger(path, head)
    try:
        steps = json.loads(path.read_text(encoding="utf-8"))["steps"]
        entries = {step.pop("name"): Entry(**step) for step in steps}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ConfigError(
            "is damaged, so nobody knows what is done; remove it to begin anew, or name another"
            " folder with --out",
            path=path,
        ) from error
    return Ledger(path, head, entries)


def _most(values: Iterable[float | None]) -> float | None:
    return max((value for value in values if value is not None), default=None)
