"""What is scored in one go, by whichever process, and what comes out of it.

Answers travel as bytes (``score.packing``): pickle would change the last bits of a pose.
"""

import threading
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from tronlab.errors import IntegrityError, ScoreError
from tronlab.nav.core import NavigationCore, NavigationResult, PosePrior
from tronlab.score.rescoring.opening import ScoredCore
from tronlab.score.rescoring.packing import pack_result, unpack_result
from tronlab.score.rescoring.prior import PriorSettings, drawn_prior, prior_after
from tronlab.score.rescoring.shot import LIMIT_S, locate
from tronlab.score.rescoring.workbench import OpenDataset, Workbench


@dataclass(frozen=True, slots=True)
class Unit:
    """Some shots of a dataset, and the cores that are asked for their poses; may be pickled."""

    dataset_path: Path
    cores: tuple[ScoredCore, ...]
    shots: tuple[int, ...]
    """Indices in the dataset, in the order each core sees them."""
    dataset_key: str = ""
    """Tells whether a dataset that is still open from earlier units is the same."""
    job: int = 0
    """Which job it is a part of."""
    prior: PriorSettings | None = None
    last: bytes = b""
    """Packed result with the pose and covariance known before the first shot, for the prior
    ``previous``; empty if nothing is known."""
    time_limit_s: float = LIMIT_S
    """For one core and image."""
    cache_dir: Path | None = None
    """Where stages are kept; None: nowhere."""

    @property
    def n_answers(self) -> int:
        """Get how many answers come out of it."""
        return len(self.cores) * len(self.shots)


@dataclass(frozen=True, slots=True)
class Asked:
    """A core begins to look at a shot; the answer follows."""

    core: int
    """Index in the unit."""
    shot: int


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer of a core to one shot."""

    core: str
    seed: int
    shot: int
    """Index in the dataset."""
    packed: bytes

    @property
    def result(self) -> NavigationResult:
        """Get the answer itself."""
        return unpack_result(self.packed)


@dataclass(frozen=True, slots=True)
class UnitDone:
    """Answers of a unit: all of them, or those that have come since the last."""

    job: int
    answers: tuple[Answer, ...]


def score_unit(unit: Unit) -> UnitDone:
    """Score a unit. Datasets and cores stay open for the next unit of this thread.

    Raises:
        TronlabError: The dataset cannot be read, or a built-in core cannot be built.
    """
    with one_opencv_thread():
        messages = worked_off(unit, _own.workbench)
        return UnitDone(unit.job, tuple(each for each in messages if isinstance(each, Answer)))


def failed_unit(
    unit: Unit, reason: str, *, status: Literal["error", "timeout"] = "error"
) -> UnitDone:
    """Give what comes out of a unit that could not be scored."""
    result = NavigationResult(status, reason=reason)
    return UnitDone(
        unit.job,
        tuple(answer_of(core, shot, result) for core in unit.cores for shot in unit.shots),
    )


def worked_off(unit: Unit, workbench: Workbench) -> Iterator[Asked | Answer]:
    """Ask every core for every shot; tell before each, and give each answer as it comes.

    Raises:
        TronlabError: The dataset cannot be read, or a built-in core cannot be built.
    """
    opened = workbench.opened(unit.dataset_path, unit.dataset_key, unit.cache_dir)
    for k, core in enumerate(unit.cores):
        try:
            navigation = opened.core(core, limit_s=unit.time_limit_s)
        except ScoreError as error:
            if core.is_built_in:
                raise
            yield from failed_unit(replace(unit, cores=(core,)), str(error)).answers
        else:
            yield from _sequence(unit, k, navigation, opened)


def rest_of(unit: Unit, asked: Asked, answers: Sequence[Answer]) -> tuple[Unit, ...]:
    """Give what is left of a unit after the answer to ``asked``; ``answers`` has those so far."""
    core, position = unit.cores[asked.core], unit.shots.index(asked.shot)
    name = core.spec.name, core.spec.seed
    known = _known_before(unit)
    for answer in answers:
        if (answer.core, answer.seed) == name:
            known = _known_after(unit.prior, known, answer.result)
    rest = (
        replace(unit, cores=(core,), shots=unit.shots[position + 1 :], last=packed_prior(known)),
        replace(unit, cores=unit.cores[asked.core + 1 :]),
    )
    return tuple(each for each in rest if each.n_answers)


def answer_of(core: ScoredCore, shot: int, result: NavigationResult) -> Answer:
    """Give an answer as it travels."""
    return Answer(core.spec.name, core.spec.seed, shot, pack_result(result))


def packed_prior(prior: PosePrior | None) -> bytes:
    """Give ``Unit.last``."""
    if prior is None:
        return b""
    return pack_result(
        NavigationResult("ok", trs_from_cam=prior.trs_from_cam, covariance=prior.covariance)
    )


@contextmanager
def one_opencv_thread() -> Generator[None]:
    """Work as every process that scores does, so that the numbers and the times are the same."""
    import cv2

    n_threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(n_threads)


def _sequence(
    unit: Unit, k: int, navigation: NavigationCore, opened: OpenDataset
) -> Iterator[Asked | Answer]:
    core = unit.cores[k]
    limit_s = unit.time_limit_s if core.is_built_in else None
    known = _known_before(unit)
    for shot in unit.shots:
        offered = _offered(unit.prior, known, opened, shot)
        try:
            frame = opened.frame(shot, offered)
        except IntegrityError as error:
            result = NavigationResult("error", reason=str(error))
        else:
            yield Asked(k, shot)
            is_first = core.is_sequential and shot == unit.shots[0]
            result = locate(navigation, frame, limit_s=limit_s, is_first=is_first)
        yield answer_of(core, shot, result)
        known = _known_after(unit.prior, known, result)


def _offered(
    prior: PriorSettings | None, known: PosePrior | None, opened: OpenDataset, shot: int
) -> PosePrior | None:
    if prior is None or prior.source == "previous":
        return known
    dataset = opened.dataset
    return drawn_prior(prior, int(dataset.shot_ids[shot]), dataset.truth(shot).trs_from_cam)


def _known_after(
    prior: PriorSettings | None, known: PosePrior | None, result: NavigationResult
) -> PosePrior | None:
    if prior is None or prior.source != "previous":
        return known
    return prior_after(prior, known, result)


def _known_before(unit: Unit) -> PosePrior | None:
    if not unit.last:
        return None
    result = unpack_result(unit.last)
    assert result.trs_from_cam is not None  # noqa: S101
    assert result.covariance is not None  # noqa: S101
    return PosePrior(result.trs_from_cam, result.covariance)


class _Own(threading.local):
    """Of each thread: neither HDF5 files nor cores are made for several."""

    def __init__(self) -> None:
        self.workbench = Workbench()


_own = _Own()
