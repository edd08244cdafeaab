"""Drift checks of a dataset, and what they say of its shots."""

from bisect import bisect_right
from collections.abc import Hashable, Mapping, Sequence
from typing import Any

from numpy.typing import NDArray

from tronlab.dataset import columns, schema
from tronlab.dataset.records import DriftRecord
from tronlab.devices.readings import PointReading
from tronlab.errors import IntegrityError

_REASONS: Mapping[schema.TruthState, str] = {
    "suspect": "a drift check before or after them found that something had moved",
    "unchecked": "there was no drift check after them",
}


def truth_states(
    rows: Sequence[int],
    sessions: Sequence[int],
    checks: Sequence[DriftRecord],
    frames: Mapping[int, Hashable],
) -> tuple[schema.TruthState, ...]:
    """Tell for each shot what the drift checks say of its truth.

    A shot between two good checks is good. Beside a bad one it is suspect: nobody knows when it
    was that something moved. A shot without a check on either side is unchecked.

    Args:
        rows: Of the shots: how many rows came before each.
        sessions: Which session took each shot.
        checks: In their order.
        frames: What truth follows from, by session. Checks against one calibration record say
            nothing of the shots of another one.
    """
    checks_of: dict[Hashable, list[DriftRecord]] = {}
    for check in checks:
        checks_of.setdefault(frames[check.session], []).append(check)
    states: list[schema.TruthState] = []
    for row, session in zip(rows, sessions, strict=True):
        beside = checks_of.get(frames[session], [])
        k = bisect_right(beside, row, key=lambda check: check.n_shots_before)
        states.append(_state(beside[k - 1] if k else None, beside[k] if k < len(beside) else None))
    return tuple(states)


def _state(before: DriftRecord | None, after: DriftRecord | None) -> schema.TruthState:
    if any(check is not None and not check.is_within for check in (before, after)):
        return "suspect"
    return "unchecked" if before is None or after is None else "good"


def doubts(shot_ids: Sequence[int], states: Sequence[schema.TruthState]) -> tuple[str, ...]:
    """Say which shots the drift checks do not vouch for, one line for each reason."""
    lines: list[str] = []
    for state, reason in _REASONS.items():
        doubted = [
            shot_id for shot_id, other in zip(shot_ids, states, strict=True) if other == state
        ]
        if doubted:
            lines.append(f"truth of shots {spans(doubted)} is {state}: {reason}")
    return tuple(lines)


def spans(shot_ids: Sequence[int]) -> str:
    """Write ids in any order as spans, such as ``1-20, 41``."""
    spans: list[list[int]] = []
    for shot_id in sorted(shot_ids):
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
        rows: Checksums and values by the path of their column, the values in the order that the
            checksums take them.
        reflectors: Names in the order of the rows' values.

    Raises:
        IntegrityError: A checksum does not match.
    """
    values = {path: column for path, column in rows.items() if path != schema.DRIFT_CRC32}
    for k, crc32 in enumerate(rows[schema.DRIFT_CRC32]):
        if columns.checksum(column[k : k + 1] for column in values.values()) != crc32:
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
        session=int(value.get("session", 1)),
    )
