"""A job of scoring: which cores against which dataset; what of it is done, and what is left."""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO

from tronlab.dataset.drift import doubts
from tronlab.dataset.reader import Dataset
from tronlab.errors import IntegrityError, ScoreError
from tronlab.nav.core import NavigationResult, PosePrior
from tronlab.nav.specs import CoreSpec
from tronlab.nav.stages import stage_key
from tronlab.score.rescoring.keys import calibration_key, frame_keys, result_keys
from tronlab.score.rescoring.opening import ScoredCore, check_databases, describe_cores
from tronlab.score.rescoring.packing import unpack_result
from tronlab.score.rescoring.prior import PriorSettings, drawn_prior, prior_after
from tronlab.score.rescoring.shot import LIMIT_S, CoreScore
from tronlab.score.rescoring.unit import Answer, Unit, packed_prior
from tronlab.score.table import ShotFacts, score_row, shot_facts

Announce = Callable[[str], None]
Find = Callable[[Sequence[str]], Mapping[str, bytes]]
"""Gives the packed answers that are kept, by key."""
CoreId = tuple[str, int]
"""Name and seed."""

_KEPT_STATUSES = ("ok", "no_pose")
"""What a core answers of itself; an error or a timeout may not come again."""


@dataclass(frozen=True, slots=True)
class ScoreJob:
    """Cores to be scored against a dataset."""

    dataset_path: Path
    cores: tuple[CoreSpec, ...]
    """The same name may be there with several seeds."""
    out_dir: Path
    """Folder of the results."""
    prior: PriorSettings | None = None
    """What cores are offered with each image; None: nothing."""
    time_limit_s: float = LIMIT_S
    """For a core and an image."""
    cache_dir: Path | None = None
    """Where answers and stages are kept from one scoring to the next; None: nowhere."""

    @property
    def names(self) -> tuple[str, ...]:
        """Get the names the scores carry, in their order."""
        return tuple(dict.fromkeys(spec.name for spec in self.cores))


class AnswerFile:
    """Packed answers in an unnamed file: those of a large sweep do not fit into memory."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._file: IO[bytes] | None = None
        self._n_bytes = 0

    def add(self, packed: bytes) -> slice:
        """Put an answer at the end; give where it is.

        Raises:
            ScoreError: There is no room for it.
        """
        try:
            self._file = file = self._file or TemporaryFile(dir=self._folder)  # noqa: SIM115
            file.seek(self._n_bytes)
            file.write(packed)
        except OSError as error:
            raise ScoreError(f"{self._folder}: answers cannot be put there: {error}") from error
        where = slice(self._n_bytes, self._n_bytes + len(packed))
        self._n_bytes = where.stop
        return where

    def close(self) -> None:
        """Forget everything."""
        if self._file is not None:
            self._file.close()

    def read(self, where: slice) -> NavigationResult:
        """Give an answer that was added."""
        assert self._file is not None  # noqa: S101
        self._file.seek(where.start)
        return unpack_result(self._file.read(where.stop - where.start))


class CoreAnswers:
    """The answers of one core to the shots of a dataset."""

    def __init__(
        self, core: ScoredCore, keys: Sequence[str], file: AnswerFile, *, is_chained: bool
    ) -> None:
        self.core = core
        self.is_chained = is_chained
        """Each answer depends on those before."""
        self._keys = keys
        self._file = file
        self._answers: dict[int, slice] = {}
        self._is_broken = False
        """An answer of the chain is not to be kept, and so are those after it."""

    @property
    def missing(self) -> tuple[int, ...]:
        """Get the shots without an answer."""
        return tuple(i for i in range(len(self._keys)) if i not in self._answers)

    def take_kept(self, find: Find) -> None:
        """Take what is kept of earlier scorings: of a chain, its beginning."""
        kept = find(self._keys)
        n_begun = next((i for i, key in enumerate(self._keys) if key not in kept), len(self._keys))
        if self.core.is_sequential and n_begun < len(self._keys):
            return  # its state cannot be had without all the shots before
        for i, key in enumerate(self._keys[:n_begun] if self.is_chained else self._keys):
            if key in kept:
                self._answers[i] = self._file.add(kept[key])

    def take(self, answer: Answer) -> dict[str, bytes]:
        """Take an answer; give it by key if it is to be kept."""
        self._answers[answer.shot] = self._file.add(answer.packed)
        is_kept = answer.result.status in _KEPT_STATUSES
        self._is_broken |= self.is_chained and not is_kept
        return {self._keys[answer.shot]: answer.packed} if is_kept and not self._is_broken else {}

    def known_after(self, settings: PriorSettings) -> PosePrior | None:
        """Give what the answers of the beginning of the chain leave known."""
        known = None
        for i in range(len(self._answers)):
            known = prior_after(settings, known, self._file.read(self._answers[i]))
        return known

    def scores(self, shots: Sequence[ShotFacts]) -> Iterator[CoreScore]:
        """Give rows and results of the shots that have an answer, in their order."""
        spec = self.core.spec
        for i in sorted(self._answers):
            result = self._file.read(self._answers[i])
            row = score_row(spec.name, spec.seed, shots[i], result)
            yield CoreScore(spec.name, shots[i].shot_id, row, result, spec.seed)


class Scoring:
    """A job on its way."""

    def __init__(self, job: ScoreJob, number: int, *, announce: Announce) -> None:
        """Read what is known of the shots, and ask the cores what they are.

        Raises:
            DatasetError: The dataset or a file of landmarks cannot be read.
            ScoreError: There is nothing to score, a core is not known or does not start, or the
                results cannot go where they shall.
        """
        _check_distinct(job.cores)
        self.job = job
        self._number = number
        with Dataset(job.dataset_path) as dataset:
            _check_shots(dataset, announce)
            self.uuid = dataset.uuid
            self.shots = tuple(shot_facts(dataset, i) for i in range(dataset.n_shots))
            frames, calibration = frame_keys(dataset), calibration_key(dataset)
        self._dataset_key = stage_key(frames=frames, calibration=calibration, uuid=self.uuid)
        self.cores = describe_cores(job.cores)
        for database in check_databases(self.cores, uuid=self.uuid):
            announce(
                f"{job.dataset_path}: its scores decided which landmarks stayed in {database}:"
                " with these, they say little about other images"
            )
        _make_folder(job.out_dir)
        self._file = AnswerFile(job.out_dir)
        self._answers: dict[CoreId, CoreAnswers] = {
            (core.spec.name, core.spec.seed): self._no_answers(core, frames, calibration)
            for core in self.cores
        }

    def close(self) -> None:
        """Forget the answers."""
        self._file.close()

    @property
    def range_los_m(self) -> dict[int, float]:
        """Get the line of sight of each shot, by shot id."""
        return {shot.shot_id: shot.truth.range_los_m for shot in self.shots}

    @property
    def n_answers(self) -> int:
        """Get how many answers it takes."""
        return len(self.cores) * len(self.shots)

    @property
    def n_missing(self) -> int:
        """Get how many of them are missing."""
        return sum(len(answers.missing) for answers in self._answers.values())

    def check_images(self) -> None:
        """See that there is anything to look at.

        Raises:
            ScoreError: No image can be read.
        """
        damages: list[str] = []
        with Dataset(self.job.dataset_path) as dataset:
            for i in range(dataset.n_shots):
                try:
                    dataset.image(i)
                    dataset.mask(i)
                except IntegrityError as damage:
                    damages.append(str(damage))
                else:
                    return
        raise ScoreError(
            f"{self.job.dataset_path}: none of its {len(damages)} images can be read: {damages[0]}"
        )

    def take_kept(self, find: Find) -> None:
        """Take answers of earlier scorings."""
        for answers in self._answers.values():
            answers.take_kept(find)

    def take(self, answer: Answer) -> dict[str, bytes]:
        """Take an answer; give it by key if it is to be kept."""
        return self._answers[answer.core, answer.seed].take(answer)

    def scores(self) -> Iterator[CoreScore]:
        """Give what is done: by core as asked for, by seed, by shot as they were taken."""
        place = {name: k for k, name in enumerate(self.job.names)}
        for _, answers in sorted(self._answers.items(), key=lambda item: place[item[0][0]]):
            yield from answers.scores(self.shots)

    def units(self) -> list[Unit]:
        """Give what is left to do: sequences first, they take longest."""
        sequences: list[Unit] = []
        singles: list[Unit] = []
        together: list[CoreAnswers] = []
        for answers in self._answers.values():
            core, missing = answers.core, answers.missing
            if not missing:
                continue
            if answers.is_chained or core.is_shared:
                sequences.append(self._unit((core,), missing, last=self._known(answers)))
            elif core.is_built_in:
                together.append(answers)
            else:
                singles.extend(self._unit((core,), (i,)) for i in missing)
        return [*sequences, *self._shared_shots(together), *singles]

    def _shared_shots(self, together: Sequence[CoreAnswers]) -> Iterator[Unit]:
        """Give a unit a shot: cores share what one image costs."""
        cores_of: dict[int, list[ScoredCore]] = {}
        for answers in together:
            for i in answers.missing:
                cores_of.setdefault(i, []).append(answers.core)
        for i in sorted(cores_of):
            yield self._unit(tuple(cores_of[i]), (i,))

    def _unit(
        self, cores: tuple[ScoredCore, ...], shots: tuple[int, ...], *, last: bytes = b""
    ) -> Unit:
        job = self.job
        return Unit(
            job.dataset_path.absolute(),
            cores,
            shots,
            dataset_key=self._dataset_key,
            job=self._number,
            prior=job.prior,
            last=last,
            time_limit_s=job.time_limit_s,
            cache_dir=None if job.cache_dir is None else job.cache_dir.absolute(),
        )

    def _known(self, answers: CoreAnswers) -> bytes:
        prior = self.job.prior
        if prior is None or prior.source != "previous":
            return b""
        return packed_prior(answers.known_after(prior))

    def _no_answers(self, core: ScoredCore, frames: Sequence[str], calibration: str) -> CoreAnswers:
        prior = self.job.prior
        is_chained = core.is_sequential or (prior is not None and prior.source == "previous")
        keys = result_keys(
            core.key,
            calibration,
            frames,
            prior=prior,
            priors=[_known_beforehand(prior, shot) for shot in self.shots],
            is_chained=is_chained,
        )
        return CoreAnswers(core, keys, self._file, is_chained=is_chained)


def _known_beforehand(prior: PriorSettings | None, shot: ShotFacts) -> PosePrior | None:
    if prior is None or prior.source != "truth":
        return None
    return drawn_prior(prior, shot.shot_id, shot.truth.trs_from_cam)


def _check_distinct(specs: Sequence[CoreSpec]) -> None:
    if not specs:
        raise ScoreError("no navigation core to score; name one with --core")
    seen: set[CoreId] = set()
    for spec in specs:
        if (spec.name, spec.seed) in seen:
            raise ScoreError(
                f"two navigation cores are called {spec.name!r} and have the seed {spec.seed};"
                " give one of them another name"
            )
        seen.add((spec.name, spec.seed))


def _check_shots(dataset: Dataset, announce: Announce) -> None:
    path = dataset.path
    if not dataset.n_shots:
        raise ScoreError(f"{path}: holds no shots: there is nothing to score")
    n_planned = dataset.provenance.n_shots_planned
    if dataset.n_shots < n_planned:
        announce(f"{path}: has {dataset.n_shots} of {n_planned} planned shots")
    if dataset.drift_checks:
        for doubt in doubts(dataset.shot_ids.tolist(), dataset.truth_states):
            announce(f"{path}: {doubt}; scored and flagged like that")


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ScoreError(f"{folder}: the results cannot go there: {error}") from error
    if not os.access(folder, os.W_OK):
        raise ScoreError(f"{folder}: cannot be written to; name another folder with --out")
