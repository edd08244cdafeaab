"""Scoring one shot: images in, rows out."""

import signal
import threading
from collections.abc import Generator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self, get_args

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.dataset.reader import Dataset
from tronlab.errors import IntegrityError, ScoreError, TronlabError
from tronlab.nav.core import CoreContext, NavigationCore, NavigationResult, Status
from tronlab.nav.cores import make_core
from tronlab.score.table import Row, score_row

LIMIT_S = 60.0
"""How long a core may take for one image."""


@dataclass(frozen=True, slots=True)
class CoreScore:
    """What one core made of one shot."""

    core: str
    shot_id: int
    row: Row
    result: NavigationResult


class ShotScorer:
    """A dataset and the cores to score against it; each worker process has one of its own."""

    def __init__(self, dataset_path: Path, core_names: tuple[str, ...]) -> None:
        """Open the dataset and build every core.

        Raises:
            DatasetError: The dataset cannot be read.
            ScoreError: A core is not known or cannot be built.
        """
        with ExitStack() as stack:
            self._dataset = stack.enter_context(Dataset(dataset_path))
            context = CoreContext(self._dataset.camera, self._dataset.references())
            self._cores = {name: build_core(name, context) for name in core_names}
            stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the dataset."""
        self._dataset.close()

    def score(self, i: int) -> list[CoreScore]:
        """Score shot ``i`` with every core, in their order.

        Raises:
            IntegrityError: The shot cannot be read.
        """
        return score_shot(self._dataset, i, cores=self._cores)


def score_shot(dataset: Dataset, i: int, *, cores: Mapping[str, NavigationCore]) -> list[CoreScore]:
    """Score one shot. What comes out depends on nothing but what goes in.

    A shot whose image is damaged is an error of every core, and the other shots are still scored.
    """
    truth, shot_id = dataset.truth(i), int(dataset.shot_ids[i])
    truth_state = dataset.truth_states[i]
    try:
        image, mask = dataset.image(i), dataset.mask(i)
    except IntegrityError as error:
        damaged = NavigationResult("error", reason=str(error))
        results = dict.fromkeys(cores, damaged)
    else:
        results = {name: locate(core, image, mask) for name, core in cores.items()}
    return [
        CoreScore(
            name,
            shot_id,
            score_row(name, shot_id, truth=truth, truth_state=truth_state, result=result),
            result,
        )
        for name, result in results.items()
    ]


def build_core(name: str, context: CoreContext) -> NavigationCore:
    """Make one core.

    Raises:
        ScoreError: The core is not known, or its factory failed.
    """
    try:
        return make_core(name, context)
    except TronlabError:
        raise
    except Exception as error:
        raise ScoreError(
            f"navigation core '{name}' cannot be built: {type(error).__name__}: {error}"
        ) from error


def locate(
    core: NavigationCore, image: Any, mask: Any, *, limit_s: float = LIMIT_S
) -> NavigationResult:
    """Ask a core for a pose; whatever goes wrong inside it is a result with a reason."""
    try:
        with _time_limit(limit_s):
            return _checked(core.locate(image, mask))
    except _TimeUp:
        return NavigationResult("timeout", reason=f"no answer within {limit_s:g} s")
    except Exception as error:
        return NavigationResult("error", reason=f"{type(error).__name__}: {error}")


class _TimeUp(BaseException):
    """The time of a core is up; not an Exception, so that the core does not catch it by chance."""


@contextmanager
def _time_limit(limit_s: float) -> Generator[None]:
    """Interrupt what runs longer, as far as a signal can: between two steps of Python code."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def ring(_signal: int, _frame: object) -> None:
        raise _TimeUp

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, limit_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def _checked(result: object) -> NavigationResult:
    if not isinstance(result, NavigationResult):
        raise TypeError(f"the core answered a {type(result).__name__}, not a NavigationResult")
    if result.status not in get_args(Status):
        raise ValueError(f"the core answered the unknown status '{result.status}'")
    if result.status == "ok":
        if not isinstance(result.trs_from_cam, RigidTransform):
            raise ValueError("the core answered 'ok' without a pose")
        if not np.isfinite(result.trs_from_cam.as_matrix()).all():
            raise ValueError("the core answered 'ok' with a pose that is not finite")
    for name in ("n_features", "n_matches", "n_inliers"):
        if not (isinstance(getattr(result, name), int | np.integer) and getattr(result, name) >= 0):
            raise ValueError(f"{name} is {getattr(result, name)!r}, must be a whole number from 0")
    for name in ("time_detect_s", "time_match_s", "time_pose_s"):
        if not np.isfinite(getattr(result, name)):
            raise ValueError(f"{name} is {getattr(result, name)!r}, must be finite")
    if result.covariance is not None and not _is_covariance(result.covariance):
        raise ValueError("the covariance is not finite or not of shape (6, 6)")
    if np.shape(result.uv_inliers)[1:] != (2,):
        raise ValueError(f"uv_inliers have shape {np.shape(result.uv_inliers)}, expected (n, 2)")
    return result


def _is_covariance(covariance: object) -> bool:
    array = np.asarray(covariance, dtype=np.float64)
    return array.shape == (6, 6) and bool(np.isfinite(array).all())
