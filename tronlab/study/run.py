"""Do a study: all its steps in their order, and only those that are not done yet."""

import time
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from tronlab.dataset.lock import lock_holder, run_lock
from tronlab.dataset.skeleton import utc_now
from tronlab.errors import ConfigError, TronlabError
from tronlab.study.keys import key_of
from tronlab.study.ledger import LEDGER_NAME, Ledger, open_ledger
from tronlab.study.memory import release_memory, watched_memory
from tronlab.study.steps import Desk, Step
from tronlab.study.study import Study
from tronlab.study.view import View

__all__ = ["StepError", "StudyRun", "run_steps", "steps_of"]


class StepError(TronlabError):
    """A step of a study failed; the text says which, and why."""


def steps_of(study: Study) -> list[Step]:
    """Give all steps of a study, in their order.

    Raises:
        ConfigError: A file says something that cannot be.
    """
    from tronlab.study.ablation import ablation_steps
    from tronlab.study.calibration import calibration_steps
    from tronlab.study.datasets import dataset_steps
    from tronlab.study.limits import limits_steps
    from tronlab.study.load import load_steps
    from tronlab.study.page import report_steps
    from tronlab.study.perturbation import perturbation_steps
    from tronlab.study.selection import selection_steps
    from tronlab.study.worst import worst_steps

    steps = [
        *calibration_steps(study),
        *dataset_steps(study),
        *dataset_steps(study, larger=True),
        *ablation_steps(study),
        *limits_steps(study),
        *selection_steps(study),
        *load_steps(study),
        *perturbation_steps(study),
        *worst_steps(study),
    ]
    return [*steps, *_after(steps, report_steps(study))]


def _after(before: Sequence[Step], steps: Sequence[Step]) -> list[Step]:
    """Let the keys of steps that use all results depend on all the steps before."""
    return [replace(step, key=key_of(after=[*before, step])) for step in steps]


@dataclass(frozen=True, slots=True)
class StudyRun:
    """What became of a study."""

    out: Path
    n_done_before: int
    n_done: int
    """Now."""
    seconds: float
    peak_memory_mb: float | None
    """Most of all steps, those done earlier too; None if it is not known."""


def run_steps(
    study: Study,
    steps: Sequence[Step],
    out: Path,
    *,
    n_workers: int,
    view: View,
    check: Callable[[], None],
) -> StudyRun:
    """Do the steps of a study that are not done yet.

    Whatever ends it, be it a power cut: what was done stays, and the same call goes on.

    Args:
        study: The study.
        steps: All its steps.
        out: Its folder.
        n_workers: Number of processes that may work at a time.
        view: Shows it.
        check: Called before the first step, if there is any to do: finds mistakes in the files.

    Raises:
        ConfigError: The folder is in use by something else, or by another study that is going on.
        StepError: A step failed; its text says which.
        KeyboardInterrupt: Somebody pressed Ctrl-C; its text says how to go on.
    """
    _check_names(steps)
    check_folder(out)
    started_s = time.monotonic()
    with _locked(out):
        ledger = ledger_of(study, out)
        ledger.keep_only(frozenset(step.name for step in steps))
        todo = [step for step in steps if not ledger.is_done(step)]
        n_done_before = len(steps) - len(todo)
        if todo:
            check()
            release_memory()
        view.begin(todo, ledger.took_s, n_done=n_done_before)
        for step in todo:
            _do(step, ledger, Desk(out, n_workers, view, is_begun=ledger.is_begun(step)), view)
    return StudyRun(
        out, n_done_before, len(todo), time.monotonic() - started_s, ledger.peak_memory_mb
    )


def ledger_of(study: Study, out: Path) -> Ledger:
    """Read what of a study is done in a folder.

    Raises:
        ConfigError: The file that says so is damaged.
    """
    from tronlab.campaign.provenance import software_versions

    head = {
        "study": str(study.path.resolve()),
        "name": study.config.name,
        "title": study.config.title,
        "quick": study.quick,
        "begun_utc": utc_now(),
        "software": software_versions(),
    }
    return open_ledger(out, head)


def check_folder(out: Path) -> None:
    """Refuse a folder that holds something else than a study.

    Raises:
        ConfigError: It does, or is a file.
    """
    if out.exists() and not out.is_dir():
        raise ConfigError(f"--out {out}: is a file, expected a folder; name another with --out")
    if out.is_dir() and not (out / LEDGER_NAME).exists():
        others = [path.name for path in out.iterdir() if not path.name.startswith(".")]
        if others:
            raise ConfigError(
                f"--out {out}: is in use and holds no study ({', '.join(sorted(others)[:3])}...);"
                " nothing is overwritten; name another folder with --out"
            )


@contextmanager
def _locked(out: Path) -> Generator[None]:
    """Keep other studies out of the folder.

    Raises:
        ConfigError: The folder cannot be made, or another process does a study in it.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"--out {out}: cannot be made: {error.strerror}") from error
    ledger = out / LEDGER_NAME
    if (holder := lock_holder(ledger)) is not None:
        raise ConfigError(
            f"{out}: a study is going on in it ({holder}); wait until it has ended, stop it, or"
            " name another folder with --out"
        )
    with run_lock(ledger):
        yield


def _do(step: Step, ledger: Ledger, desk: Desk, view: View) -> None:
    """Do a step and note it, however it ends."""
    ledger.begin(step)
    view.begin_step(step)
    started_s, is_done = time.monotonic(), False
    with watched_memory() as peak:
        try:
            step.run(desk)
            is_done = True
        except KeyboardInterrupt as interrupt:
            raise KeyboardInterrupt(_where_it_stopped(step, str(interrupt))) from None
        except TronlabError as error:
            raise StepError(f"{step.name}: {error}") from error
        finally:
            seconds = time.monotonic() - started_s
            peak.look()
            ledger.add(step, seconds=seconds, peak_memory_mb=peak.mb, is_done=is_done)
    view.end_step(step, seconds=seconds, peak_memory_mb=peak.mb)
    release_memory()


def _where_it_stopped(step: Step, reason: str) -> str:
    return "\n".join(
        part
        for part in (f"{step.name}: {reason or 'interrupted'}", "the same command goes on")
        if part
    )


def _check_names(steps: Sequence[Step]) -> None:
    """Refuse two steps of one name: the ledger would take one for the other."""
    names = [step.name for step in steps]
    if len(set(names)) < len(names):
        twice = sorted({name for name in names if names.count(name) > 1})
        raise StepError(f"two steps are called {', '.join(twice)}")
