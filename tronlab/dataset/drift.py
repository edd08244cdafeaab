"""Drift checks of a dataset, and what they say of its shots."""

from collections.abc import Mapping, Sequence
from typing import Any

from numpy.typing import NDArray

from tronlab.dataset import schema
from tronlab.dataset.records import DriftRecord
from tronlab.devices.readings import PointReading
from tronlab.errors import IntegrityError

_REASONS: Mapping[schema.TruthState, str] = {
    "suspect": "a drift check before or after them found that something had moved",
    "unchecked": "there was no drift check after them",
}


def truth_states(n_shots: int, checks: Sequence[DriftRecord]) -> tuple[schema.TruthState, ...]:
    """Tell for each shot, in the order they were committed, what the drift checks say of its truth.

    A shot between two good checks is good. Beside a bad one it is suspect: nobody knows when it
    was that something moved. A shot without a check on either side is unchecked.
    """
    return tuple(_state(_beside(i, checks)) for i in range(n_shots))


def _beside(i: int, checks: Sequence[DriftRecord]) -> tuple[DriftRecord | None, DriftRecord | None]:
    """Give the last check before the shot of row ``i``, and the first one after it."""
    before = [check for check in checks if check.n_shots_before <= i]
    after = [check for check in checks if check.n_shots_before > i]
    return (before[-1] if before else None), (after[0] if after else None)


def _state(beside: tuple[DriftRecord | None, DriftRecord | None]) -> schema.TruthState:
    if any(check is not None and not check.is_within for check in beside):
        return "suspect"
    return "unchecked" if None in beside else "good"


def doubts(shot_ids: Sequence[int], states: Sequence[schema.TruthState]) -> tuple[str, ...]:
    """Say which shots the drift checks do not vouch for, one line for each reason."""
    lines: list[str] = []
    for state, reason in _REASONS.items():
        doubted = [
            shot_id for shot_id, other in zip(shot_ids, states, strict=True) if other == state
        ]
        if doubted:
            lines.append(f"truth of shots {_spans(doubted)} is {state}: {reason}")
    return tuple(lines)


def _spans(shot_ids: Sequence[int]) -> str:
    """Write ids as spans, such as ``1-20, 41``."""
    spans: list[list[int]] = []
    for shot_id in shot_ids:
        if spans and shot_id == spans[-1][-1] + 1:
            spans[-1][1:] = [shot_id]
        else:
            spans.append([shot_id])
    return ", ".join("-".join(map(str, span)) for span in spans)


def drift_records(
    rows: Mapping[str, NDArray[Any]], reflectors: Sequence[str]
) -> tuple[DriftRecord, ...]:
    """Make drift checks from their rows.

    Args:
        rows: Values and checksums by the path of their column.
        reflectors: Names in the order of the rows' values.

    Raises:
        IntegrityError: A checksum does not match.
    """
    values = {column.path: rows[column.path] for column in schema.DRIFT_COLUMNS}
    for k, crc32 in enumerate(rows[schema.DRIFT_CRC32]):
        if schema.checksum(column[k : k + 1] for column in values.values()) != crc32:
            raise IntegrityError(
                f"drift check {k + 1} is damaged: its checksum does not match; fetch the file"
                " again from its source"
            )
    named = {path.removeprefix(f"{schema.DRIFT}/"): column for path, column in values.items()}
    return tuple(
        _record({name: column[k] for name, column in named.items()}, reflectors)
        for k in range(len(rows[schema.DRIFT_CRC32]))
    )


def _record(value: Mapping[str, Any], reflectors: Sequence[str]) -> DriftRecord:
    return DriftRecord(
        n_shots_before=int(value["n_shots_before"]),
        time_s=float(value["time_s"]),
        readings={
            name: PointReading(
                target=name,
                p_trk_m=value["p_trk_m"][k],
                covariance_m2=value["p_trk_covariance_m2"][k],
                time_s=float(value["p_trk_time_s"][k]),
            )
            for k, name in enumerate(reflectors)
        },
        shift=value["shift"],
        max_shift_m=float(value["max_shift_m"]),
        limit_m=float(value["limit_m"]),
        is_within=bool(value["is_within"]),
    )
