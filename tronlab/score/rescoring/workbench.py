"""What a process that scores has at hand: open datasets, and the cores that were made for them."""

from collections import OrderedDict
from contextlib import ExitStack
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self, runtime_checkable

from tronlab.dataset import schema
from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import ReferenceView
from tronlab.nav.core import CoreContext, Frame, NavigationCore, PosePrior
from tronlab.nav.stages import NOTHING_KEPT
from tronlab.score.rescoring.keys import calibration_key, frame_keys
from tronlab.score.rescoring.opening import ScoredCore
from tronlab.score.rescoring.stage_files import StageFiles

MOST_DATASETS = 2
"""Open at once."""
MOST_FOREIGN = 4
"""Cores of others open at once for a dataset: each is a process, or a connection."""


@runtime_checkable
class Closing(Protocol):
    """A core that has something to let go of."""

    def close(self) -> None:
        """End it."""
        ...


class OpenDataset:
    """A dataset, and the cores that look at it."""

    def __init__(self, path: Path, cache_dir: Path | None) -> None:
        """Open it.

        Raises:
            DatasetError: It cannot be read.
        """
        with ExitStack() as stack:
            self.dataset = stack.enter_context(Dataset(path))
            self._keys = frame_keys(self.dataset)
            self._times_s: list[float] = self.dataset.rows(f"{schema.CAMERA}/time_s").tolist()
            self._context = CoreContext(
                self.dataset.camera,
                (),
                shared={},
                stages=NOTHING_KEPT if cache_dir is None else StageFiles(cache_dir),
                references_key=calibration_key(self.dataset),
            )
            stack.pop_all()
        self._cores: OrderedDict[str, tuple[NavigationCore, bool]] = OrderedDict()
        self._last: Frame | None = None

    def core(self, core: ScoredCore, *, limit_s: float) -> NavigationCore:
        """Give a core, made if it was not yet.

        Raises:
            ScoreError: It cannot be made.
            IntegrityError: The reference views cannot be read.
        """
        name = f"{core.key} {core.spec.name} {limit_s}"
        if name not in self._cores:
            self._cores[name] = self._made(core, limit_s), core.is_built_in
            self._close_oldest()
        self._cores.move_to_end(name)
        return self._cores[name][0]

    def frame(self, i: int, prior: PosePrior | None) -> Frame:
        """Give what a core is shown of shot ``i``.

        Raises:
            IntegrityError: Image or mask is damaged.
        """
        if self._last is None or self._last.number != i:
            self._last = Frame(
                self.dataset.image(i),
                self.dataset.mask(i),
                number=i,
                time_s=self._times_s[i],
                key=self._keys[i],
            )
        return replace(self._last, prior=prior)

    def close(self) -> None:
        """Close the cores and the dataset."""
        while self._cores:
            _close(self._cores.popitem()[1][0])
        self.dataset.close()

    @cached_property
    def _references(self) -> tuple[ReferenceView, ...]:
        return self.dataset.references()

    def _made(self, core: ScoredCore, limit_s: float) -> NavigationCore:
        context = replace(
            self._context,
            references=self._references if core.wants_references else (),
            settings=core.spec.settings,
            seed=core.spec.seed,
        )
        return core.open(context, limit_s=limit_s)

    def _close_oldest(self) -> None:
        foreign = [name for name, (_, is_built_in) in self._cores.items() if not is_built_in]
        for name in foreign[:-MOST_FOREIGN]:
            _close(self._cores.pop(name)[0])


class Workbench:
    """The datasets used last, open."""

    def __init__(self) -> None:
        self._opened: OrderedDict[object, OpenDataset] = OrderedDict()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def opened(self, path: Path, dataset_key: str, cache_dir: Path | None) -> OpenDataset:
        """Give a dataset, opened if it was not yet, or if it was another one then.

        Raises:
            DatasetError: It cannot be read.
        """
        key = path, dataset_key, cache_dir
        if key not in self._opened:
            self._opened[key] = OpenDataset(path, cache_dir)
            while len(self._opened) > MOST_DATASETS:
                self._opened.popitem(last=False)[1].close()
        self._opened.move_to_end(key)
        return self._opened[key]

    def close(self) -> None:
        """Close everything."""
        while self._opened:
            self._opened.popitem()[1].close()


def _close(core: NavigationCore) -> None:
    if isinstance(core, Closing):
        core.close()
