"""Who scores units: this process, or several that each have datasets and cores open.

Every worker process has a pipe of its own. A pool of the standard library shares one between all,
and hangs if a worker is ended while it writes into that: a Ctrl-C would not end the scoring.

A worker says which core it is about to ask. So if it dies, or does not come back, the answer of
that core to that shot is an error or a timeout, and another worker goes on with the rest.
"""

import multiprocessing
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Generator, Iterable, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Literal, Protocol, TypeAlias

from tronlab.errors import ScoreError, TronlabError
from tronlab.nav.core import NavigationResult
from tronlab.nav.foreign.launch import START_LIMIT_S
from tronlab.score.rescoring.unit import (
    Answer,
    Asked,
    Unit,
    UnitDone,
    answer_of,
    failed_unit,
    one_opencv_thread,
    rest_of,
    worked_off,
)
from tronlab.score.rescoring.workbench import Workbench

MARGIN_S = 5.0
"""How much longer than its limit a core in a worker may take before the worker is ended."""
FOREIGN_MARGIN_S = 30.0 + 2 * START_LIMIT_S
"""The same for a core of others, which keeps the limit itself and may have to be started anew."""
MOST_DEATHS = 3
"""So many workers in a row may die before any answer has come."""
MOST_TRIES = 2
"""So often a unit is begun whose worker dies before any core is asked."""

Failure: TypeAlias = Literal["error", "timeout"]

_END_S = 5.0
"""For a worker to close its cores when the work is done."""


class Executor(Protocol):
    """Works units off, somewhere."""

    def run(self, units: Sequence[Unit]) -> Generator[UnitDone]:
        """Score units; give what is done, all of a unit or a part of it, in any order.

        Closing the generator ends the work.

        Raises:
            TronlabError: A dataset cannot be read, a core cannot be built, or nobody can work.
        """
        ...


class ProcessExecutor:
    """Works units off in worker processes; with only one, in this process.

    In this process nobody ends a core that hangs where no signal interrupts it, or outlives one
    that crashes.
    """

    def __init__(self, n_workers: int) -> None:
        """Take the number of processes.

        Raises:
            ScoreError: It is not 1 or more.
        """
        if n_workers < 1:
            raise ScoreError(f"workers is {n_workers}, must be 1 or more")
        self.n_workers = n_workers

    def run(self, units: Sequence[Unit]) -> Generator[UnitDone]:
        """Score units; see ``Executor``.

        Raises:
            TronlabError: A dataset cannot be read, or a core cannot be built.
            ScoreError: Worker processes die one after the other.
        """
        if self.n_workers == 1:
            return _score_here(units)
        return _Crew(units, self.n_workers).work()


def _score_here(units: Sequence[Unit]) -> Generator[UnitDone]:
    with one_opencv_thread(), Workbench() as workbench:
        for unit in units:
            for message in worked_off(unit, workbench):
                if isinstance(message, Answer):
                    yield UnitDone(unit.job, (message,))


@dataclass(slots=True)
class _Work:
    """A unit, and how often its worker died before any core was asked."""

    unit: Unit
    n_tries: int = 0


@dataclass(slots=True, eq=False)
class _Worker:
    """A process that scores one unit at a time."""

    process: SpawnProcess
    connection: Connection
    work: _Work | None = None
    asked: Asked | None = None
    """What it is at; None while it opens datasets and cores."""
    end_s: float = float("inf")
    """When it is to be ended, monotonic time."""
    answers: list[Answer] = field(default_factory=list[Answer])
    """Those of this unit."""

    def begin(self, work: _Work) -> None:
        """Give it a unit."""
        self.work, self.asked, self.end_s, self.answers = work, None, float("inf"), []
        with suppress(OSError):  # if it is dead, its pipe says so in a moment
            self.connection.send(work.unit)


class _Crew:
    """Worker processes, and the units they have not yet done."""

    def __init__(self, units: Sequence[Unit], n_workers: int) -> None:
        self._todo = deque(_Work(unit) for unit in units)
        self._n_workers = min(n_workers, len(units))
        self._workers: list[_Worker] = []
        self._n_deaths = 0
        """Since the last answer."""

    def work(self) -> Generator[UnitDone]:
        """Work everything off."""
        try:
            while self._todo or self._busy():
                self._hand_out()
                for worker in self._worth_a_look():
                    yield from self._look_after(worker)
            self._send_home()
        finally:
            self._end_all()

    def _busy(self) -> list[_Worker]:
        return [worker for worker in self._workers if worker.work is not None]

    def _hand_out(self) -> None:
        idle = [worker for worker in self._workers if worker.work is None]
        while self._todo and (idle or len(self._workers) < self._n_workers):
            worker = idle.pop() if idle else self._hire()
            worker.begin(self._todo.popleft())

    def _worth_a_look(self) -> list[_Worker]:
        """Wait until a worker has said something, died, or taken too long."""
        busy = self._busy()
        first_s = min(worker.end_s for worker in busy)
        timeout_s = None if first_s == float("inf") else max(0.0, first_s - time.monotonic())
        ready = wait([worker.connection for worker in busy], timeout_s)
        now_s = time.monotonic()
        return [worker for worker in busy if worker.connection in ready or worker.end_s <= now_s]

    def _look_after(self, worker: _Worker) -> Generator[UnitDone]:
        try:
            if not worker.connection.poll():  # what it said counts, however late we listen
                yield from self._dismiss(worker)
                return
            message = worker.connection.recv()
        except (EOFError, OSError):
            yield from self._bury(worker)
            return
        if isinstance(message, Asked):
            worker.asked = message
            worker.end_s = time.monotonic() + _longest_s(_unit(worker), message)
        elif isinstance(message, Answer):
            self._n_deaths = 0
            worker.answers.append(message)
            worker.end_s = float("inf")
            yield UnitDone(_unit(worker).job, (message,))
        elif isinstance(message, TronlabError):
            raise message
        else:
            worker.work = None

    def _bury(self, worker: _Worker) -> Generator[UnitDone]:
        """Go on after the death of a worker."""
        worker.process.join(_END_S)
        death = f"the process that ran it {_how_it_ended(worker.process.exitcode)}"
        self._n_deaths += 1
        if self._n_deaths >= MOST_DEATHS:
            raise ScoreError(
                f"{MOST_DEATHS} worker processes died one after the other, the last one"
                f" {_how_it_ended(worker.process.exitcode)}: out of memory, or a core that crashes;"
                " try again with fewer workers, or one core at a time"
            )
        yield from self._replace(worker, "error", death)

    def _dismiss(self, worker: _Worker) -> Generator[UnitDone]:
        """End a worker that does not come back from a core."""
        limit_s = _unit(worker).time_limit_s
        reason = f"no answer within {limit_s:g} s, and its process had to be ended"
        yield from self._replace(worker, "timeout", reason)

    def _replace(self, worker: _Worker, status: Failure, reason: str) -> Generator[UnitDone]:
        """End a worker, say what became of the core it was at, and leave the rest to others."""
        work, asked = worker.work, worker.asked
        self._workers.remove(worker)
        _end([worker])
        if work is None:
            return
        unit = work.unit
        if asked is None:
            work.n_tries += 1
            if work.n_tries < MOST_TRIES:
                self._todo.appendleft(work)
            else:
                yield failed_unit(unit, reason, status=status)
            return
        core = unit.cores[asked.core]
        is_answered = bool(worker.answers) and _is_to(worker.answers[-1], unit, asked)
        if not is_answered:
            answer = answer_of(core, asked.shot, NavigationResult(status, reason=reason))
            worker.answers.append(answer)
            yield UnitDone(unit.job, (answer,))
        rest = rest_of(unit, asked, worker.answers)
        self._todo.extendleft(_Work(each) for each in reversed(rest))

    def _hire(self) -> _Worker:
        with interrupts_held():
            worker = _start_worker()
            self._workers.append(worker)
        return worker

    def _send_home(self) -> None:
        """Let idle workers close their cores."""
        for worker in self._workers:
            with suppress(OSError):
                worker.connection.send(None)
        end_s = time.monotonic() + _END_S
        for worker in self._workers:
            worker.process.join(max(0.0, end_s - time.monotonic()))

    def _end_all(self) -> None:
        _end(self._workers)


def _unit(worker: _Worker) -> Unit:
    assert worker.work is not None  # noqa: S101
    return worker.work.unit


def _is_to(answer: Answer, unit: Unit, asked: Asked) -> bool:
    spec = unit.cores[asked.core].spec
    return (answer.core, answer.seed, answer.shot) == (spec.name, spec.seed, asked.shot)


def _longest_s(unit: Unit, asked: Asked) -> float:
    is_built_in = unit.cores[asked.core].is_built_in
    if is_built_in:
        return unit.time_limit_s + MARGIN_S
    return 2 * unit.time_limit_s + FOREIGN_MARGIN_S


def _how_it_ended(exit_code: int | None) -> str:
    if exit_code is None:
        return "closed its pipe"
    if exit_code >= 0:
        return f"ended with exit code {exit_code}"
    try:
        return f"was ended by {signal.Signals(-exit_code).name}"
    except ValueError:
        return f"was ended by signal {-exit_code}"


def _start_worker() -> _Worker:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_work, args=(theirs,))
    try:
        process.start()
    except OSError as error:
        raise ScoreError(f"a worker process cannot be started: {error}") from error
    theirs.close()  # so that a worker that dies is seen as the end of its pipe
    return _Worker(process, ours)


def _end(workers: Iterable[_Worker]) -> None:
    """End processes at once."""
    with interrupts_held():  # a second Ctrl-C must not leave one behind
        for worker in workers:
            worker.process.terminate()
        for worker in workers:
            worker.process.join(_END_S)
            worker.process.kill()  # one that is stopped, or deaf
            worker.process.join()
            worker.connection.close()


def _work(connection: Connection) -> None:
    """Score the units sent; an error goes back as an answer, so that it arrives whole."""
    # The end of the pipe is the end of the work.
    threading.Thread(target=_end_with_the_parent, daemon=True).start()
    with one_opencv_thread(), Workbench() as workbench, suppress(EOFError, ConnectionError):
        while (unit := connection.recv()) is not None:
            try:
                for message in worked_off(unit, workbench):
                    connection.send(message)
                connection.send("done")
            except TronlabError as error:
                connection.send(ScoreError(str(error)))


def _end_with_the_parent() -> None:
    """End this process once the one that scores is killed, whatever is being waited for here."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)  # at once: the cores it started end with it


@contextmanager
def interrupts_held() -> Generator[None]:
    """Hold Ctrl-C back for a while; processes started meanwhile inherit that and never see it."""
    held = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, held)
