"""Scoring recorded datasets against navigation cores: only what is not known yet is computed."""

import os
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

import pandas as pd

from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import Truth
from tronlab.errors import ConfigError, ScoreError, TronlabError
from tronlab.nav.core import NavigationResult
from tronlab.nav.cores import BUILT_IN_CORES
from tronlab.nav.specs import parse_cores
from tronlab.score.diagnosis import convention_hint
from tronlab.score.info import score_info
from tronlab.score.rescoring.cache import AnswerCache
from tronlab.score.rescoring.job import Announce, ScoreJob, Scoring
from tronlab.score.rescoring.prior import PriorSettings
from tronlab.score.rescoring.shot import LIMIT_S, CoreScore
from tronlab.score.rescoring.unit import Unit
from tronlab.score.rescoring.workers import Executor, ProcessExecutor
from tronlab.score.results import (
    SCORES,
    ScoreResults,
    earlier_results,
    kept_cores,
    save_partial,
    save_results,
)
from tronlab.yaml_variants import recorded_values

Progress = Callable[[int, int], None]
"""Told how many answers have been computed, and how many there are to compute."""


def score_jobs(
    jobs: Sequence[ScoreJob],
    *,
    executor: Executor,
    progress: Progress | None = None,
    announce: Announce | None = None,
) -> list[pd.DataFrame]:
    """Score jobs; write table, summary and matches of each as soon as it is done.

    Answers that are kept from earlier scorings are taken; new ones are kept as they come, so that a
    scoring that was cut short goes on where it stopped. Results in a folder stay for cores that are
    not scored anew; its files are replaced when the job is complete, never before.

    Args:
        jobs: What to score; no two into the same folder.
        executor: Who does it.
        progress: Told how far it is, over all jobs.
        announce: Told what a person should know.

    Returns:
        The table of each job, ordered by core (those already there, then as asked for), seed and
        shot.

    Raises:
        DatasetError: A dataset or a file of landmarks cannot be read.
        ScoreError: A core that is not known or cannot be made, nothing to score, a folder with
            results of another dataset, results that cannot be written, or a scoring that was cut
            short: its text then says where the rows scored so far are.
        KeyboardInterrupt: Its text says where the rows scored so far are.
    """
    say = announce or _keep_quiet
    _check_folders(jobs)
    scorings = [Scoring(job, number, announce=say) for number, job in enumerate(jobs)]
    for scoring in scorings:
        _earlier(scoring, say)
    with ExitStack() as stack:
        for scoring in scorings:
            stack.enter_context(closing(scoring))
        folders = {job.cache_dir for job in jobs if job.cache_dir is not None}
        caches = {f: stack.enter_context(AnswerCache(f, say=say)) for f in sorted(folders)}
        return _Session(scorings, caches, progress or _no_progress, say).run(executor)


def score_dataset(
    dataset_path: Path,
    *,
    cores: Sequence[str] | None = None,
    out_dir: Path | None = None,
    workers: int | None = None,
    prior: PriorSettings | None = None,
    time_limit_s: float = LIMIT_S,
    cache_dir: Path | None = None,
    progress: Progress | None = None,
    announce: Announce | None = None,
) -> pd.DataFrame:
    """Score every shot of one dataset with every core; see ``score_jobs``.

    Args:
        dataset_path: The dataset.
        cores: As ``--core`` takes them; by default those the dataset's campaign names, else all
            built-in ones.
        out_dir: Folder of the results; by default that of the dataset.
        workers: Number of processes; by default as many as there are processors.
        prior: What cores are offered with each image.
        time_limit_s: For a core and an image.
        cache_dir: Where answers are kept from one scoring to the next; None: nowhere.
        progress: Told how far it is.
        announce: Told what a person should know.

    Returns:
        The table of scores.

    Raises:
        DatasetError: The dataset cannot be read.
        ScoreError: See ``score_jobs``.
        KeyboardInterrupt: Its text says where the rows scored so far are.
    """
    executor = ProcessExecutor(n_processors() if workers is None else workers)
    job = ScoreJob(
        dataset_path,
        parse_cores(cores or cores_of_dataset(dataset_path)),
        dataset_path.parent if out_dir is None else out_dir,
        prior=prior,
        time_limit_s=time_limit_s,
        cache_dir=cache_dir,
    )
    (table,) = score_jobs([job], executor=executor, progress=progress, announce=announce)
    return table


def cores_of_dataset(dataset_path: Path) -> tuple[str, ...]:
    """Give the cores that the campaign of a dataset names, else all built-in ones.

    Raises:
        DatasetError: The dataset cannot be read.
    """
    with Dataset(dataset_path) as dataset:
        return campaign_cores(dataset.provenance.campaign_yaml)


def campaign_cores(campaign_yaml: str) -> tuple[str, ...]:
    """Give the cores a campaign names under ``score: cores``, else all built-in ones."""
    try:
        section = recorded_values(campaign_yaml).get("score")
    except ConfigError:
        return BUILT_IN_CORES
    named = section.get("cores") if isinstance(section, Mapping) else None
    return tuple(str(name) for name in named) if isinstance(named, list) else BUILT_IN_CORES


def n_processors() -> int:
    """Give how many processors this process may use: a container often has fewer than it sees."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class _Session:
    """Jobs being scored together."""

    def __init__(
        self,
        scorings: Sequence[Scoring],
        caches: dict[Path, AnswerCache],
        progress: Progress,
        say: Announce,
    ) -> None:
        self._scorings = scorings
        self._caches = caches
        self._progress = progress
        self._say = say
        self._tables: dict[int, pd.DataFrame] = {}

    def run(self, executor: Executor) -> list[pd.DataFrame]:
        """Take what is kept, compute the rest, and write the results."""
        self._take_kept()
        with self._rows_kept_if_cut_short():
            for number in range(len(self._scorings)):
                self._save_if_complete(number)
            self._compute(executor)
        return [self._tables[number] for number in range(len(self._scorings))]

    def _take_kept(self) -> None:
        for scoring in self._scorings:
            if (cache := self._cache_of(scoring)) is not None:
                scoring.take_kept(cache.find)
        n_answers = sum(scoring.n_answers for scoring in self._scorings)
        n_kept = n_answers - self._n_missing()
        if n_kept:
            self._say(f"{n_kept} of {n_answers} answers are known from earlier scorings")

    def _compute(self, executor: Executor) -> None:
        n_todo = n_left = self._n_missing()
        if not n_todo:
            return
        for scoring in self._scorings:
            if scoring.n_missing:
                scoring.check_images()
        self._progress(0, n_todo)
        units = [unit for scoring in self._scorings for unit in scoring.units()]
        for phase in _phases(units):
            with closing(executor.run(phase)) as working:
                for done in working:
                    scoring, cache = self._scorings[done.job], self._cache_of_job(done.job)
                    kept = [scoring.take(answer) for answer in done.answers]
                    if cache is not None:
                        cache.keep({key: packed for each in kept for key, packed in each.items()})
                    n_left -= len(done.answers)
                    self._save_if_complete(done.job)
                    self._progress(n_todo - n_left, n_todo)
        if n_left:
            raise ScoreError(f"{n_left} of {n_todo} answers did not come; try again")

    def _save_if_complete(self, number: int) -> None:
        scoring = self._scorings[number]
        if scoring.n_missing or number in self._tables:
            return
        # Read again: another core may have been scored into the same folder meanwhile.
        earlier = _earlier(scoring, _keep_quiet)
        hints = _Hints(scoring)
        scores = hints.noted(scoring.scores())
        self._tables[number] = save_results(
            scoring.job.out_dir, scores, score_info(scoring), earlier=earlier
        )
        _say_what_stays(scoring.job, earlier, self._say)
        hints.say(self._say)

    def _n_missing(self) -> int:
        return sum(scoring.n_missing for scoring in self._scorings)

    def _cache_of(self, scoring: Scoring) -> AnswerCache | None:
        folder = scoring.job.cache_dir
        return None if folder is None else self._caches[folder]

    def _cache_of_job(self, number: int) -> AnswerCache | None:
        return self._cache_of(self._scorings[number])

    @contextmanager
    def _rows_kept_if_cut_short(self) -> Generator[None]:
        try:
            yield
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"interrupted: {self._keep_what_is_done()}") from None
        except TronlabError as error:
            if not any(scoring.n_missing < scoring.n_answers for scoring in self._scorings):
                raise
            raise ScoreError(f"{error}\n{self._keep_what_is_done()}") from error

    def _keep_what_is_done(self) -> str:
        unfinished = [s for i, s in enumerate(self._scorings) if i not in self._tables]
        texts = [_rows_kept(scoring) for scoring in unfinished]
        if self._caches:
            texts.append("the same command goes on from there")
        return "\n".join(texts)


def _phases(units: Sequence[Unit]) -> list[list[Unit]]:
    """Put units one after the other that share a core: a socket serves one at a time."""
    phases: list[list[Unit]] = []
    n_of_core: Counter[str] = Counter()
    for unit in units:
        shared = [core.spec.target for core in unit.cores if core.is_shared]
        number = max((n_of_core[target] for target in shared), default=0)
        n_of_core.update(shared)
        if number == len(phases):
            phases.append([])
        phases[number].append(unit)
    return phases


def _check_folders(jobs: Sequence[ScoreJob]) -> None:
    jobs_of: dict[Path, ScoreJob] = {}
    for job in jobs:
        folder = job.out_dir.resolve()
        if folder in jobs_of:
            raise ScoreError(
                f"{job.out_dir}: the results of {jobs_of[folder].dataset_path} and of"
                f" {job.dataset_path} cannot go into the same folder; name others with --out"
            )
        jobs_of[folder] = job


def _earlier(scoring: Scoring, say: Announce) -> ScoreResults | None:
    return earlier_results(
        scoring.job.out_dir,
        dataset_path=scoring.job.dataset_path,
        cores=scoring.job.names,
        range_los_m=scoring.range_los_m,
        say=say,
    )


def _rows_kept(scoring: Scoring) -> str:
    job, n_done = scoring.job, scoring.n_answers - scoring.n_missing
    text = f"{n_done} of {scoring.n_answers} answers for {job.dataset_path} are there"
    if not n_done:
        return f"{text}; nothing was written"
    try:
        return f"{text}; their rows are in {save_partial(job.out_dir, scoring.scores())}"
    except OSError as error:
        return f"{text}; their rows cannot be written: {error}"


def _say_what_stays(job: ScoreJob, earlier: ScoreResults | None, say: Announce) -> None:
    if earlier is None:
        return
    kept = kept_cores(earlier, job.names)
    replaced = [name for name in job.names if name in earlier.summary]
    parts = (("kept", kept), ("replaced", replaced))
    text = "; ".join(f"{verb} {', '.join(names)}" for verb, names in parts if names)
    say(f"{job.out_dir / SCORES}: of the earlier scoring: {text}")


class _Hints:
    """Finds cores that look as if they answered in another convention, while scores go by."""

    def __init__(self, scoring: Scoring) -> None:
        self._truths = {shot.shot_id: shot.truth for shot in scoring.shots}
        self._answers: dict[str, list[tuple[Truth, NavigationResult]]] = {}

    def noted(self, scores: Iterable[CoreScore]) -> Iterator[CoreScore]:
        """Pass scores on."""
        for score in scores:
            pose = NavigationResult(score.result.status, score.result.trs_from_cam)
            answers = self._answers.setdefault(score.core, [])
            answers.append((self._truths[score.shot_id], pose))
            yield score

    def say(self, say: Announce) -> None:
        """Say what was found."""
        for core, answers in self._answers.items():
            if hint := convention_hint(*zip(*answers, strict=True)):
                say(f"{core}: {hint}")


def _keep_quiet(_text: str) -> None:
    pass


def _no_progress(_n_done: int, _n_all: int) -> None:
    pass
