"""Scoring on a Dask cluster that somebody started elsewhere.

Only this module imports ``distributed``: the extra ``cluster`` brings it.
"""

import logging
import platform
import re
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any, TypeAlias, cast

from tronlab.dataset.reader import Dataset
from tronlab.errors import ScoreError, TronlabError
from tronlab.nav.sources import digest_of_stage
from tronlab.score.rescoring.unit import Unit, UnitDone, failed_unit, score_unit

if TYPE_CHECKING:
    from distributed import Client, Future

Software: TypeAlias = Mapping[str, str]

N_AHEAD = 4
"""Units on the way to each worker, so that none waits for us and little is lost with one."""

_ADDRESS = re.compile(r"(tcp|tls)://\S+:\d{1,5}")
_one_at_a_time = Lock()
"""Units share open datasets and cores in a process, whatever number of threads a worker has."""


@dataclass(frozen=True, slots=True)
class Place:
    """What a process that scores works with."""

    software: Software
    problems: tuple[str, ...]
    """Why it cannot read the files that were asked for."""


class DaskExecutor:
    """Works units off on the workers of a Dask scheduler; see ``Executor``.

    A unit whose worker is lost is given to another one by Dask, as often as the scheduler's
    ``distributed.scheduler.allowed-failures`` says. Dask blames every unit that was on its way to
    the lost worker; those it gives up are tried again core by core, each alone on the cluster, and
    the one that still loses its workers gets the result "error".

    A built-in core that takes too long is interrupted between two steps of Python code; unlike on
    this computer, nobody ends one that hangs within a step.
    """

    def __init__(self, address: str, *, timeout_s: float = 10.0) -> None:
        self.address = address
        self._timeout_s = timeout_s

    def run(self, units: Sequence[Unit]) -> Generator[UnitDone]:
        """Score units; give each as it is done, in any order. Closing it cancels the others.

        Raises:
            ScoreError: There is no scheduler or no worker, a worker has other software or cannot
                read a dataset, the scheduler was lost, or a unit cannot be scored at all.
        """
        with _connected(self.address, self._timeout_s) as client:
            software = software_here()
            _wait_for_a_worker(client, self.address, self._timeout_s)
            n_workers = _check_workers(client, units, software)
            suspects: list[Unit] = []
            n_ahead = N_AHEAD * n_workers
            with closing(_worked_off(client, units, software, n_ahead=n_ahead)) as working:
                for unit, future in working:
                    if _has_lost_workers(future):
                        suspects.append(unit)
                    else:
                        yield _answer(future, self.address)
            alone = [replace(unit, cores=(core,)) for unit in suspects for core in unit.cores]
            with closing(_worked_off(client, alone, software, n_ahead=1)) as working:
                for unit, future in working:
                    if _has_lost_workers(future):
                        yield failed_unit(unit, _WORKERS_LOST)
                    else:
                        yield _answer(future, self.address)


_WORKERS_LOST = (
    "every worker of the cluster that was given this image died of it: out of memory, or a core"
    " that crashed"
)


@cache
def software_here() -> Software:
    """Give the versions that shape the numbers, and a digest of the cores' source."""
    import cv2

    return {
        "Python": platform.python_version(),
        "tronlab": version("tronlab"),
        "the cores' source": digest_of_stage("core")[:12],
        "numpy": version("numpy"),
        "scipy": version("scipy"),
        "OpenCV": cv2.__version__,
    }


def look_around(datasets: Mapping[Path, str], landmarks: Mapping[Path, str]) -> Place:
    """Tell what this process works with; runs on each worker.

    Args:
        datasets: Where they are, and how ``_identity`` tells them from others.
        landmarks: The same of databases, told by ``_digest``.
    """
    problems = [
        *(_problem_with(path, _identity, told, "dataset") for path, told in datasets.items()),
        *(_problem_with(path, _digest, told, "database") for path, told in landmarks.items()),
    ]
    return Place(software_here(), tuple(filter(None, problems)))


def score_there(unit: Unit, expected: Software) -> UnitDone:
    """Score a unit on a worker, one that joined later perhaps.

    Raises:
        ScoreError: The unit cannot be scored. Other errors of ours become this one, which arrives
            whole.
    """
    from distributed import get_worker

    _refuse_other_software(f"worker {get_worker().address}", software_here(), expected)
    try:
        with _one_at_a_time:
            return score_unit(unit)
    except TronlabError as error:
        raise ScoreError(str(error)) from None


def _problem_with(
    path: Path, identify: Callable[[Path], str], identity: str, what: str
) -> str | None:
    try:
        is_same = identify(path) == identity
    except TronlabError as error:
        return str(error)
    return None if is_same else f"{path}: is another {what} there"


def _identity(dataset_path: Path) -> str:
    with Dataset(dataset_path) as dataset:
        return f"{dataset.uuid} with {dataset.n_shots} shots"


def _digest(database_path: Path) -> str:
    from tronlab.nav.database_file import open_database

    return open_database(database_path).digest


@contextmanager
def _connected(address: str, timeout_s: float) -> Generator["Client"]:
    try:
        from distributed import Client
    except ImportError:
        raise ScoreError(
            "scoring on a cluster needs Dask; install it with: pip install 'tronlab[cluster]'"
        ) from None
    if not _ADDRESS.fullmatch(address):
        raise ScoreError(
            f"{address!r}: not the address of a Dask scheduler; write tcp://HOST:PORT, as"
            " dask scheduler prints it when it starts"
        )
    try:
        client = Client(address, timeout=timeout_s, set_as_default=False)
    except OSError as error:
        raise ScoreError(
            f"no Dask scheduler answers at {address}: {error};"
            f" start one with: dask scheduler; and on each computer: dask worker {address}"
        ) from error
    with _distributed_quiet(), client:
        yield client


@contextmanager
def _distributed_quiet() -> Generator[None]:
    """Keep the client's own log away from people: what matters of it becomes an error of ours."""
    logger = logging.getLogger("distributed.client")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)


def _wait_for_a_worker(client: "Client", address: str, timeout_s: float) -> None:
    try:
        client.wait_for_workers(1, timeout=timeout_s)
    except TimeoutError:
        raise ScoreError(
            f"the Dask scheduler at {address} has no workers;"
            f" start some with: dask worker {address}"
        ) from None


def _check_workers(client: "Client", units: Sequence[Unit], software: Software) -> int:
    """See that every worker can do the work; give how many there are."""
    datasets = {path: _identity(path) for path in {unit.dataset_path for unit in units}}
    databases = {core.database for unit in units for core in unit.cores}
    landmarks = {path: _digest(path) for path in databases if path is not None}
    found = client.run(look_around, datasets, landmarks, on_error="return")
    places = cast("Mapping[str, Any]", found)
    for worker, place in places.items():
        if isinstance(place, OSError):
            continue  # it was lost meanwhile; the one in its place is seen to by score_there
        if not isinstance(place, Place):
            raise ScoreError(f"worker {worker}: cannot score: {type(place).__name__}: {place}")
        _refuse_other_software(f"worker {worker}", place.software, software)
        if place.problems:
            raise ScoreError(
                f"worker {worker}: cannot read what it shall: {place.problems[0]};"
                " datasets and databases must be under the same path on every worker"
            )
    return max(1, len(places))


def _refuse_other_software(who: str, theirs: Software, ours: Software) -> None:
    differences = [
        f"{name} {theirs.get(name, 'none')}, here {ours[name]}"
        for name in ours
        if theirs.get(name) != ours[name]
    ]
    if differences:
        raise ScoreError(
            f"{who}: has other software: {'; '.join(differences)};"
            " install the same everywhere, or the numbers differ"
        )


def _worked_off(
    client: "Client", units: Iterable[Unit], software: Software, *, n_ahead: int
) -> Generator[tuple[Unit, "Future[UnitDone]"]]:
    """Keep so many units on the way; give each with its future when that is done."""
    from distributed import as_completed

    todo = iter(units)
    flying: dict[Future[UnitDone], Unit] = {}
    done = as_completed(loop=client.loop)

    def launch(n: int) -> None:
        for unit in islice(todo, n):
            future = client.submit(score_there, unit, software, pure=False)
            flying[future] = unit
            done.add(future)

    launch(n_ahead)
    try:
        for future in done:
            unit = flying.pop(future)
            launch(1)
            yield unit, future
    finally:
        client.cancel(list(flying))


def _has_lost_workers(future: "Future[UnitDone]") -> bool:
    from distributed import KilledWorker

    return future.status == "error" and isinstance(future.exception(), KilledWorker)


def _answer(future: "Future[UnitDone]", address: str) -> UnitDone:
    if future.status not in {"finished", "error"}:
        raise ScoreError(f"the Dask scheduler at {address} was lost: {future.status}")
    error = cast("BaseException | None", future.exception())
    if error is None or isinstance(error, TronlabError):
        return future.result()
    raise ScoreError(f"the Dask cluster at {address}: {type(error).__name__}: {error}") from error
