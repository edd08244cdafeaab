"""Cores to be scored: asked beforehand what they are, opened in the process that scores.

What a kind of core needs is imported when there is one: OpenCV and SciPy take longest to start.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tronlab.errors import ScoreError, TronlabError
from tronlab.nav.core import CoreContext, NavigationCore
from tronlab.nav.specs import CoreSpec
from tronlab.nav.stages import stage_key
from tronlab.score.rescoring.keys import core_key


@dataclass(frozen=True, slots=True)
class ScoredCore:
    """A core as the scoring knows it."""

    spec: CoreSpec
    key: str
    """See ``keys.core_key``."""
    version: str = ""
    """Of a core of others, as it says."""
    is_built_in: bool = True
    """It runs in the process that scores; others have one of their own, and keep time limits."""
    is_sequential: bool = False
    """It keeps state along a trajectory, and sees whole datasets in order."""
    wants_references: bool = True

    @property
    def database(self) -> Path | None:
        """Get the file of landmarks it looks into; None for those of the dataset."""
        database = self.spec.settings.get("database") if self.is_built_in else None
        return None if database is None else Path(str(database))

    @property
    def is_shared(self) -> bool:
        """Tell whether there is only one of it, for whoever asks: it listens on a socket."""
        return self.spec.kind == "tcp"

    def open(self, context: CoreContext, *, limit_s: float) -> NavigationCore:
        """Make the core, or connect to it.

        Args:
            context: What it may know.
            limit_s: How long it may take for one image.

        Raises:
            ScoreError: It cannot be made or connected to.
        """
        if not self.is_built_in:
            from tronlab.nav.foreign import open_core

            return open_core(self.spec, context, limit_s=limit_s)
        from tronlab.nav.cores import make_core

        try:
            return make_core(self.spec, context)
        except TronlabError:
            raise
        except Exception as error:
            raise ScoreError(
                f"navigation core '{self.spec.name}' cannot be built:"
                f" {type(error).__name__}: {error}"
            ) from error


def describe_cores(specs: Sequence[CoreSpec]) -> tuple[ScoredCore, ...]:
    """Find out what cores are; those of others are started for that, once for their settings.

    Raises:
        ScoreError: One is not known, or cannot be started or connected to.
    """
    known: dict[str, ScoredCore] = {}
    cores: list[ScoredCore] = []
    for spec in specs:
        same = stage_key(kind=spec.kind, target=spec.target, settings=dict(spec.settings))
        if same not in known:
            known[same] = _described(spec)
        seen = known[same]
        cores.append(replace(seen, spec=spec, key=core_key(spec, seen.key)))
    return tuple(cores)


def check_databases(cores: Iterable[ScoredCore], *, uuid: str | None) -> tuple[Path, ...]:
    """Verify the files of landmarks that cores look into.

    Args:
        cores: The cores.
        uuid: Of the dataset they are to be scored on.

    Returns:
        The files whose landmarks were chosen by scores of this dataset.

    Raises:
        DatasetError: One cannot be read, or is damaged.
    """
    paths = dict.fromkeys(core.database for core in cores if core.database is not None)
    if not paths:
        return ()
    from tronlab.nav.database_file import open_database, verify_database

    for path in paths:
        verify_database(path)
    return tuple(path for path in paths if uuid in open_database(path).pruned_by)


def _described(spec: CoreSpec) -> ScoredCore:
    """Give a core with its identity for a key."""
    from tronlab.nav.cores import built_in_identity, is_built_in
    from tronlab.nav.foreign import describe_core

    if is_built_in(spec):
        core = ScoredCore(spec, built_in_identity(spec))
        return replace(core, wants_references=core.database is None)
    told = describe_core(spec)
    return ScoredCore(
        spec,
        told.identity,
        version=told.version,
        is_built_in=False,
        is_sequential=told.is_sequential,
        wants_references=told.wants_references,
    )
