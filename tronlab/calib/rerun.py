"""Solving a record again: the same inputs must give the same results."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from tronlab.calib.inputs import Inputs
from tronlab.calib.record import CalibrationRecord
from tronlab.calib.results import Results
from tronlab.calib.results_json import results_to_json
from tronlab.calib.solve import solve
from tronlab.errors import CalibrationError
from tronlab.geometry.poses import FloatArray

TOLERANCE = 1e-9
"""Relative to the largest number of an array: what another processor's rounding may change."""


@dataclass(frozen=True, slots=True)
class Rerun:
    """What came of solving a record again."""

    record: CalibrationRecord
    """With the results found now."""
    differences: tuple[str, ...]
    """What is not as it was, one line each."""
    old_parts: tuple[str, ...]
    """Results the record had."""
    new_parts: tuple[str, ...]
    """Results it did not have, as one of an interrupted session."""
    unsolved: Mapping[str, str]
    """Parts of an interrupted session that determine no answer yet, and why; the new record is
    without them."""


def rerun(record: CalibrationRecord, software: Mapping[str, str]) -> Rerun:
    """Solve a record's inputs again.

    Args:
        record: The record.
        software: Versions, for the new one.

    A record without results is that of an interrupted session: its last part may determine no
    answer yet, then the others are solved without it.

    Raises:
        CalibrationError: It has no inputs, or they determine no answer.
    """
    if not record.inputs.measured_utc:
        raise CalibrationError(
            f"calibration record {record.source}: inputs: nothing was measured: nothing to solve"
        )
    inputs, unsolved = record.inputs, dict[str, str]()
    if record.results == Results():
        inputs, unsolved = _solvable(record.inputs)
    again = replace(record, inputs=inputs, results=solve(inputs), software=dict(software))
    # Compared as the file has them: it is the file that must be reproducible.
    before, now = results_to_json(record.results), results_to_json(again.results)
    again_found = {name: part for name, part in now.items() if name in before}
    return Rerun(
        record=again,
        differences=tuple(_differences(before, again_found, "")),
        old_parts=tuple(before),
        new_parts=tuple(name for name in now if name not in before),
        unsolved=unsolved,
    )


def _solvable(inputs: Inputs) -> tuple[Inputs, dict[str, str]]:
    """Give the parts that determine an answer, and why the others do not.

    Raises:
        CalibrationError: None does.
    """
    found, unsolved = Inputs(), dict[str, str]()
    for name in inputs.measured_utc:
        part = {name: getattr(inputs, name)}
        try:
            solve(Inputs().with_parts(**part))
        except CalibrationError as error:
            unsolved[name] = str(error)
        else:
            found = found.with_parts(**part)
    if not found.measured_utc:
        raise CalibrationError("\n".join(unsolved.values()))
    return found, unsolved


def _differences(before: Any, now: Any, key: str) -> Iterator[str]:
    if isinstance(before, Mapping) and isinstance(now, Mapping):
        yield from _of_mappings(
            cast("Mapping[str, Any]", before), cast("Mapping[str, Any]", now), key
        )
        return
    first, second = _numbers(before), _numbers(now)
    if first is not None and second is not None and first.shape == second.shape:
        yield from _of_numbers(first, second, key)
    elif _is_list(before) and _is_list(now) and len(before) == len(now):
        for i, pair in enumerate(zip(before, now, strict=True)):
            yield from _differences(*pair, f"{key}[{i}]")
    elif before != now:
        yield f"{key}: was {before}, is now {now}"


def _of_mappings(before: Mapping[str, Any], now: Mapping[str, Any], key: str) -> Iterator[str]:
    for name in sorted({*before, *now}):
        inner = f"{key}.{name}" if key else name
        if name in before and name in now:
            yield from _differences(before[name], now[name], inner)
        else:
            yield f"{inner}: {'is gone' if name in before else 'is new'}"


def _of_numbers(before: FloatArray, now: FloatArray, key: str) -> Iterator[str]:
    largest = max(np.abs(before).max(initial=0.0), np.abs(now).max(initial=0.0))
    difference = float(np.abs(now - before).max(initial=0.0))
    if difference > TOLERANCE * largest:
        yield f"{key}: differs by {difference:.3g}, {difference / largest:.1g} of the largest value"


def _is_list(value: Any) -> bool:
    return isinstance(value, (list, tuple))


def _numbers(value: Any) -> FloatArray | None:
    """Give a number or (nested) list of numbers as an array; None for anything else."""
    try:
        array = np.array(value)
    except ValueError:  # lists of different length
        return None
    return array.astype(np.float64) if array.dtype.kind in "if" else None
