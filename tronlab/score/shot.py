"""Scoring one shot: images in, rows out."""

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self, get_args

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.dataset.reader import Dataset
from tronlab.errors import ScoreError, TronlabError
from tronlab.nav.core import CoreContext, NavigationCore, NavigationResult, Status
from tronlab.nav.cores import make_core
from tronlab.score.table import Row, score_row


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
    """Score one shot. What comes out depends on nothing but what goes in."""
    image, mask, truth = dataset.image(i), dataset.mask(i), dataset.truth(i)
    shot_id = int(dataset.shot_ids[i])
    scores: list[CoreScore] = []
    for name, core in cores.items():
        result = locate(core, image, mask)
        row = score_row(name, shot_id, truth=truth, result=result)
        scores.append(CoreScore(name, shot_id, row, result))
    return scores


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


def locate(core: NavigationCore, image: Any, mask: Any) -> NavigationResult:
    """Ask a core for a pose; whatever goes wrong inside it is a result with a reason."""
    try:
        return _checked(core.locate(image, mask))
    except Exception as error:
        return NavigationResult("error", reason=f"{type(error).__name__}: {error}")


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
    if np.shape(result.uv_inliers)[1:] != (2,):
        raise ValueError(f"uv_inliers have shape {np.shape(result.uv_inliers)}, expected (n, 2)")
    return result
