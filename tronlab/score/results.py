"""The files of a scoring: written whole, read back for the report."""

import hashlib
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd

from tronlab.errors import ScoreError
from tronlab.geometry.poses import FloatArray
from tronlab.score.evaluation.statistics import Summary, summarise
from tronlab.score.matches import (
    StoredAnswer,
    copy_matches,
    read_answers,
    read_reasons,
    read_uv_inliers,
    write_matches,
)
from tronlab.score.rescoring.shot import CoreScore
from tronlab.score.rescoring.workers import interrupts_held
from tronlab.score.table import COLUMNS, Row, score_table, with_all_columns

SCORES = "scores.csv"
SUMMARY = "summary.json"
MATCHES = "matches.h5"
INFO = "score.json"
PARTIAL_SCORES = "scores.partial.csv"
"""Rows of a scoring that was cut short; the next one that ends removes it."""
_HASHED = (SCORES, SUMMARY, MATCHES)


@dataclass(frozen=True, slots=True)
class ScoreResults:
    """A scoring as ``tronlab score`` left it in a folder."""

    directory: Path
    scores: pd.DataFrame
    """One row a shot, core and seed; see ``tronlab.score.table.COLUMNS``."""
    summary: Summary
    """Core name to its statistics."""
    dataset_path: Path
    """The dataset that was scored; it may have moved since."""
    cores: tuple[str, ...]
    software: Mapping[str, str]
    """Versions of what shaped the numbers."""
    scored_utc: str
    """When, ISO 8601."""
    reasons: Mapping[tuple[str, int, int], str]
    """Why a core gave no pose, by core, seed and shot id."""
    kept: Mapping[str, Mapping[str, Any]]
    """``scored_utc`` and ``software`` of each core that an earlier scoring left here."""
    definitions: Mapping[str, Mapping[str, Any]] = field(default_factory=dict[str, Any])
    """What each name stands for: ``kind``, ``target``, ``settings``, ``seeds``, ``prior``,
    ``time_limit_s``, and ``version`` of a core of others. Those of older scorings are missing."""

    def uv_inliers(self, core: str, shot_id: int, seed: int = 0) -> FloatArray:
        """Read the image positions a pose rests on, shape (n, 2), pixels; empty without a pose."""
        return read_uv_inliers(self.directory / MATCHES, core, shot_id, seed)

    def answers(self) -> Iterator[StoredAnswer]:
        """Read what every core answered to every shot, one after the other."""
        return read_answers(self.directory / MATCHES)


def save_results(
    directory: Path,
    scores: Iterable[CoreScore],
    info: Mapping[str, Any],
    *,
    earlier: ScoreResults | None = None,
) -> pd.DataFrame:
    """Write the files of a scoring beside the old ones, then put them in place.

    Args:
        directory: Where to; it exists.
        scores: In the order of the table.
        info: What ``score.json`` shall say, with the ``cores`` of ``scores``.
        earlier: Results in ``directory`` whose cores stay, but for those in ``scores``.

    Returns:
        The table: cores of ``earlier`` in their places, then the new ones.

    Raises:
        ScoreError: They cannot be written; the old files are as they were.
    """
    kept = kept_cores(earlier, info["cores"])
    rows: list[Row] = []
    try:
        with TemporaryDirectory(prefix=".score-", dir=directory) as staging:
            folder = Path(staging)
            write_matches(folder / MATCHES, _noted(scores, rows))
            if kept:
                copy_matches(directory / MATCHES, folder / MATCHES, kept)
            table = _merged(score_table(rows), earlier)
            table.to_csv(folder / SCORES, index=False)
            _write_json(folder / SUMMARY, summarise(table))
            _write_json(folder / INFO, _info(folder, info, table, earlier=earlier, kept=kept))
            with interrupts_held():
                for name in (*_HASHED, INFO):
                    os.replace(folder / name, directory / name)
        (directory / PARTIAL_SCORES).unlink(missing_ok=True)
    except OSError as error:
        raise ScoreError(f"{directory}: the scores cannot be written: {error}") from error
    return table


def kept_cores(earlier: ScoreResults | None, scored: Sequence[str]) -> tuple[str, ...]:
    """Give the cores of an earlier scoring that are not scored anew, in their order."""
    names = () if earlier is None else _core_names(earlier.scores)
    return tuple(name for name in names if name not in scored)


def save_partial(directory: Path, scores: Iterable[CoreScore]) -> Path:
    """Write the rows of a scoring that was cut short to a file of their own.

    Raises:
        OSError: They cannot be written.
    """
    path = directory / PARTIAL_SCORES
    with TemporaryDirectory(prefix=".score-", dir=directory) as staging:
        written = Path(staging) / PARTIAL_SCORES
        score_table(score.row for score in scores).to_csv(written, index=False)
        os.replace(written, path)
    return path


def load_results(directory: Path) -> ScoreResults:
    """Read the files of a scoring.

    Raises:
        ScoreError: There are none, they are damaged, or they are not of one scoring.
    """
    if not (directory / SCORES).is_file():
        partial = f", only {PARTIAL_SCORES} of a scoring that was cut short"
        only = partial if (directory / PARTIAL_SCORES).is_file() else ""
        raise ScoreError(
            f"{directory}: no {SCORES} there{only}; make it with: tronlab score DATASET.h5 --out"
            f" {directory}"
        )
    info = _read_json(directory / INFO)
    for name, digest in info.get("sha256", {}).items():
        if not (directory / name).is_file() or _sha256(directory / name) != digest:
            raise ScoreError(
                f"{directory / name}: missing, changed or of another scoring than {INFO};"
                " run tronlab score again"
            )
    try:
        return ScoreResults(
            directory=directory,
            scores=_read_scores(directory / SCORES),
            summary=_read_json(directory / SUMMARY),
            dataset_path=(directory / info["dataset"]).resolve(),
            cores=tuple(info["cores"]),
            software=info["software"],
            scored_utc=info["scored_utc"],
            reasons=read_reasons(directory / MATCHES),
            kept=info.get("kept", {}),
            definitions=info.get("definitions", {}),
        )
    except KeyError as error:
        raise ScoreError(
            f"{directory / INFO}: {error} is missing; run tronlab score again"
        ) from error


def earlier_results(
    directory: Path,
    *,
    dataset_path: Path,
    cores: Sequence[str],
    range_los_m: Mapping[int, float],
    say: Callable[[str], None],
) -> ScoreResults | None:
    """Read what an earlier scoring of the same dataset left in a folder.

    Args:
        directory: The folder.
        dataset_path: The dataset that is scored now.
        cores: Those it is scored with.
        range_los_m: Line of sight of each of its shots, by shot id.
        say: Told if the results are damaged, which this scoring then mends.

    Returns:
        The results; None if there are none, or damaged ones of no other cores.

    Raises:
        ScoreError: They are of another dataset, or those of other cores would be lost.
    """
    if not any((directory / name).exists() for name in (SCORES, INFO)):
        return None
    info = _info_of_dataset(directory, dataset_path)
    try:
        results = load_results(directory)
    except ScoreError as error:
        _check_none_lost(directory, info, cores=cores, damage=error)
        say(f"{directory}: the scores there are damaged and will be replaced ({error})")
        return None
    if not _is_of_shots(results.scores, range_los_m):
        raise ScoreError(
            f"{directory}: holds scores of {dataset_path} when it had other shots; name another"
            " folder with --out, or remove them"
        )
    return results


def _info_of_dataset(directory: Path, dataset_path: Path) -> dict[str, Any]:
    try:
        info = _read_json(directory / INFO)
        named = (directory / str(info["dataset"])).resolve()
    except (ScoreError, KeyError) as error:
        raise ScoreError(
            f"{directory}: holds scores, but {INFO} does not say of which dataset; name another"
            " folder with --out, or remove them"
        ) from error
    if named != dataset_path.resolve():
        raise ScoreError(
            f"{directory}: holds the scores of another dataset, {named}; name another folder for"
            f" those of {dataset_path} with --out"
        )
    return info


def _check_none_lost(
    directory: Path, info: Mapping[str, Any], *, cores: Sequence[str], damage: ScoreError
) -> None:
    lost = [str(name) for name in info.get("cores", []) if name not in cores]
    if lost:
        raise ScoreError(
            f"{directory}: the scores there are damaged, those of {', '.join(lost)} would be lost:"
            f" score these cores too, or name another folder with --out ({damage})"
        ) from damage


def _is_of_shots(scores: pd.DataFrame, range_los_m: Mapping[int, float]) -> bool:
    expected = sorted(range_los_m)
    if any(sorted(of_one["shot_id"]) != expected for _, of_one in scores.groupby(["core", "seed"])):
        return False
    expected_m = [range_los_m[shot_id] for shot_id in scores["shot_id"]]
    return np.allclose(scores["range_los_m"], expected_m, rtol=1e-9, atol=0.0, equal_nan=True)


def _core_names(scores: pd.DataFrame) -> list[str]:
    return [str(name) for name in scores["core"].unique()]


def _merged(scores: pd.DataFrame, earlier: ScoreResults | None) -> pd.DataFrame:
    """Put rows of cores that stay between those of cores scored anew."""
    if earlier is None:
        return scores
    old, new = _core_names(earlier.scores), _core_names(scores)
    sources = {name: scores if name in new else earlier.scores for name in (*old, *new)}
    rows = [source[source["core"] == name] for name, source in sources.items()]
    return pd.concat(rows, ignore_index=True)


def _origins(earlier: ScoreResults | None, kept: Sequence[str]) -> dict[str, Mapping[str, Any]]:
    """Tell when and with what the cores that stay were scored."""
    if earlier is None:
        return {}
    last = {"scored_utc": earlier.scored_utc, "software": earlier.software}
    return {name: earlier.kept.get(name, last) for name in kept}


def _noted(scores: Iterable[CoreScore], rows: list[Row]) -> Iterator[CoreScore]:
    """Pass scores on, and put their rows down: the results are too many to keep."""
    for score in scores:
        rows.append(score.row)
        yield score


def _info(
    folder: Path,
    info: Mapping[str, Any],
    table: pd.DataFrame,
    *,
    earlier: ScoreResults | None,
    kept: Sequence[str],
) -> dict[str, Any]:
    return {
        **info,
        "cores": _core_names(table),
        "definitions": _definitions(earlier, kept) | info.get("definitions", {}),
        "kept": _origins(earlier, kept),
        "sha256": {name: _sha256(folder / name) for name in _HASHED},
    }


def _definitions(earlier: ScoreResults | None, kept: Sequence[str]) -> dict[str, Mapping[str, Any]]:
    """Tell what the names of the cores that stay stand for."""
    if earlier is None:
        return {}
    return {name: earlier.definitions[name] for name in kept if name in earlier.definitions}


def _read_scores(path: Path) -> pd.DataFrame:
    try:
        # As text first: pandas 2 reads floats of its own making, which may be off in the last
        # digit, and rows that stay are written again.
        table = pd.read_csv(path, dtype="str", keep_default_na=False, na_values=[""])
        table = with_all_columns(table)
        missing = [name for name in COLUMNS if name not in table.columns]
        if missing:
            raise ScoreError(f"{path}: columns are missing: {', '.join(missing)}")
        return table.reindex(columns=list(COLUMNS)).astype(COLUMNS)
    except (ValueError, TypeError, OSError) as error:
        raise ScoreError(f"{path}: is not a table of scores: {error}") from error


def _write_json(path: Path, value: Mapping[str, Any]) -> None:
    text = json.dumps(value, indent=2, allow_nan=False, ensure_ascii=False)
    path.write_text(text + "\n", encoding="utf-8")


def _read_json(path: Path) -> Any:
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ScoreError(f"{path}: cannot be read: {error}; run tronlab score again") from error
    if not isinstance(value, dict):
        raise ScoreError(f"{path}: is not a JSON object; run tronlab score again")
    return value


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
