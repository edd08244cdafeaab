"""Two calibration records held against each other: what moved, in units and in sigmas."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal, TypeAlias

import numpy as np
from scipy.stats import chi2

from tronlab.calib.differences import (
    Difference,
    camera_difference,
    frame_difference,
    hand_eye_difference,
    lamp_difference,
    photometry_difference,
    robot_difference,
)
from tronlab.calib.inputs import Inputs, StationsInput
from tronlab.calib.record import CalibrationRecord

MIN_P_VALUE = 1e-3
"""Differences less probable than this, if nothing had changed, count as changes."""

Readings: TypeAlias = Literal["same", "partly the same", "others", "unknown"]
"""Whether two results follow from the same measurements; ``unknown`` if one has none with it."""

_SAME_RESULT = 1e-3
"""In sigmas: what solving the same readings on another computer may differ by."""
_WHAT_CHANGED: Mapping[str, str] = MappingProxyType(
    {
        "frame": "the tracker stands elsewhere, or the model",
        "camera": "the camera sees differently: lens, focus, aperture or region of interest",
        "hand-eye": "camera or T-MAC moved on their plate",
        "lamp": "the lamp moved",
        "robot": "rail, robot or T-MAC moved",
        "photometry": "the paint reflects differently",
    }
)


@dataclass(frozen=True, slots=True)
class Quantity:
    """One number of two records."""

    name: str
    unit: str
    difference: float
    """Second minus first."""
    sigma: float
    """One sigma of the difference, if the two were measured independently; 0 if both are fixed."""

    @property
    def n_sigmas(self) -> float:
        """Get the difference in sigmas; of a fixed number that changed it is infinite."""
        if self.sigma > 0:
            return self.difference / self.sigma
        return 0.0 if self.difference == 0 else float(np.copysign(np.inf, self.difference))


@dataclass(frozen=True, slots=True)
class PartComparison:
    """One part that both records have."""

    name: str
    quantities: tuple[Quantity, ...]
    chi_square: float
    """Square of the Mahalanobis distance between the two."""
    dof: int
    readings: Readings
    size: str
    """How large the difference is, for people."""

    @property
    def p_value(self) -> float:
        """Get how probable so large a difference is if nothing changed between the two."""
        return float(chi2.sf(self.chi_square, self.dof)) if self.dof else float(not self.chi_square)

    @property
    def is_changed(self) -> bool:
        """Tell whether the part changed between the two measurements."""
        return self.readings != "same" and self.p_value < MIN_P_VALUE

    @property
    def is_solved_differently(self) -> bool:
        """Tell whether the same readings led to another result."""
        return self.readings == "same" and self.chi_square > _SAME_RESULT**2

    @property
    def judgement(self) -> str:
        """Get the part's verdict in a few words."""
        if self.readings == "same":
            return "same readings, " + (
                f"ANOTHER RESULT by {self.size}" if self.is_solved_differently else "same result"
            )
        return f"CHANGED by {self.size}" if self.is_changed else "agrees within the uncertainty"


@dataclass(frozen=True, slots=True)
class Comparison:
    """What differs between two records; differences are second minus first."""

    sources: tuple[str, str]
    created_utc: tuple[str, str]
    parts: tuple[PartComparison, ...]
    measured_utc: Mapping[str, tuple[str, str]]
    """When each input was measured in the two records; empty where it was not."""
    only_in_first: tuple[str, ...]
    only_in_second: tuple[str, ...]
    notes: tuple[str, ...]
    """Rig, devices, software and camera model, as far as they differ."""

    @property
    def verdict(self) -> str:
        """Get what moved, as one or more lines."""
        if not self.parts:
            return "the two records have no part in common"
        changed = [part for part in self.parts if part.is_changed]
        lines = [
            f"{part.name} changed: {_WHAT_CHANGED[part.name]}: {part.size}" for part in changed
        ]
        lines += [
            f"{part.name}: solved differently from the same readings, by {part.size}"
            for part in self.parts
            if part.is_solved_differently
        ]
        anew = [part for part in self.parts if part.readings != "same"]
        agreeing = [part.name for part in anew if not part.is_changed]
        if agreeing:
            nothing = "nothing else moved" if changed else "nothing moved"
            agree = "agree" if len(agreeing) > 1 else "agrees"
            lines.append(f"{nothing}: {_list(agreeing)} {agree} within the uncertainty")
        if same := [part.name for part in self.parts if part.readings == "same"]:
            lines.append(f"not measured again: {_list(same)}")
        return "\n".join(lines)

    def table(self) -> str:
        """Give everything as text for a terminal."""
        return "\n".join(self._lines())

    def _lines(self) -> Iterator[str]:
        for which, source, created in zip(
            ("first", "second"), self.sources, self.created_utc, strict=True
        ):
            yield f"{which:<8}{source}, made {created}"
        yield from self.notes
        for name, dates in self.measured_utc.items():
            first, second = (date or "not measured" for date in dates)
            yield f"{name} measured: {first}" + ("" if first == second else f" -> {second}")
        for part in self.parts:
            yield from _part_lines(part)
        if self.only_in_first or self.only_in_second:
            yield ""
        for names, which in ((self.only_in_first, "first"), (self.only_in_second, "second")):
            if names:
                yield f"only in the {which}: {_list(names)}"
        yield ""
        yield self.verdict


def compare_records(first: CalibrationRecord, second: CalibrationRecord) -> Comparison:
    """Hold two records against each other, part by part.

    A part differs by the difference of its values; its covariance is the sum of both, for readings
    taken anew are independent. Turns and shifts are along the axes of the parent frame.

    Args:
        first: The record to start from, mostly the older one.
        second: The other; differences are this one minus ``first``.
    """
    names = [name for name in _PARTS if _has(first, name) and _has(second, name)]
    dates = first.inputs.measured_utc, second.inputs.measured_utc
    measured = [name for name in Inputs.model_fields if name in dates[0] or name in dates[1]]
    return Comparison(
        sources=(first.source, second.source),
        created_utc=(first.created_utc, second.created_utc),
        parts=tuple(_compare_part(name, first, second) for name in names),
        measured_utc={
            name.replace("_", "-"): (dates[0].get(name, ""), dates[1].get(name, ""))
            for name in measured
        },
        only_in_first=tuple(
            name for name in _PARTS if _has(first, name) and not _has(second, name)
        ),
        only_in_second=tuple(
            name for name in _PARTS if _has(second, name) and not _has(first, name)
        ),
        notes=tuple(_notes(first, second)),
    )


def _compare_part(name: str, first: CalibrationRecord, second: CalibrationRecord) -> PartComparison:
    part = _PARTS[name]
    difference = part.difference(_result(first, name), _result(second, name))
    sigmas = np.sqrt(np.diag(difference.covariance))
    chi_square, dof = difference.chi_square()
    return PartComparison(
        name=name,
        quantities=tuple(
            Quantity(axis, unit, factor * float(value), factor * float(sigma))
            for (axis, unit, factor), value, sigma in zip(
                difference.axes, difference.values, sigmas, strict=True
            )
        ),
        chi_square=chi_square,
        dof=dof,
        readings=_readings(part.inputs, first.inputs, second.inputs),
        size=difference.size,
    )


@dataclass(frozen=True, slots=True)
class _Part:
    result: str
    """Its name in ``Results``."""
    inputs: tuple[str, ...]
    """What it follows from; camera and hand-eye are solved together."""
    difference: Callable[[Any, Any], Difference]


_PARTS: Mapping[str, _Part] = MappingProxyType(
    {
        "frame": _Part("frame", ("frame",), frame_difference),
        "camera": _Part("camera", ("intrinsics", "hand_eye"), camera_difference),
        "hand-eye": _Part("hand_eye", ("intrinsics", "hand_eye"), hand_eye_difference),
        "lamp": _Part("lamp", ("lamp",), lamp_difference),
        "robot": _Part("robot", ("robot",), robot_difference),
        "photometry": _Part("photometry", ("photometry",), photometry_difference),
    }
)


def _result(record: CalibrationRecord, name: str) -> Any:
    return getattr(record.results, _PARTS[name].result)


def _has(record: CalibrationRecord, name: str) -> bool:
    return _result(record, name) is not None


def _readings(names: Sequence[str], first: Inputs, second: Inputs) -> Readings:
    pairs = [(getattr(first, name), getattr(second, name)) for name in names]
    present = [(a, b) for a, b in pairs if a is not None or b is not None]
    if all(a is None for a, _ in pairs) or all(b is None for _, b in pairs):
        return "unknown"
    if all(a == b for a, b in present):
        return "same"
    return "partly the same" if any(_overlap(a, b) for a, b in present) else "others"


def _overlap(a: object, b: object) -> bool:
    if isinstance(a, StationsInput) and isinstance(b, StationsInput):
        return any(station in b.stations for station in a.stations)
    return a == b


def _notes(first: CalibrationRecord, second: CalibrationRecord) -> Iterator[str]:
    if first.rig_name != second.rig_name:
        yield f"rig: '{first.rig_name}' -> '{second.rig_name}'"
    for name in sorted(set(first.devices) & set(second.devices)):
        before, after = first.devices[name], second.devices[name]
        if not before.is_same_device(after):
            yield f"{name} exchanged: '{before}' -> '{after}'"
    for name in sorted(set(first.software) | set(second.software)):
        before, after = first.software.get(name, "none"), second.software.get(name, "none")
        if before != after:
            yield f"software: {name} {before} -> {after}"
    a, b = first.results.camera, second.results.camera
    if a is not None and b is not None:
        if a.model != b.model:
            yield f"distortion model: {a.model} -> {b.model}"
        if a.camera.shape != b.camera.shape:
            sizes = (f"{c.camera.width_px} x {c.camera.height_px}" for c in (a, b))
            yield f"image size, px: {' -> '.join(sizes)}"


def _part_lines(part: PartComparison) -> Iterator[str]:
    if part.readings == "same" and not part.is_solved_differently:
        yield f"{part.name}: {part.judgement}"
        return
    yield ""
    yield f"{part.name:<30}{'difference':>14}{'sigma':>12}{'sigmas':>10}"
    for quantity in part.quantities:
        if quantity.difference or quantity.sigma:
            digits = _decimals(quantity.sigma)
            yield (
                f"  {f'{quantity.name} [{quantity.unit}]':<28}{quantity.difference:>14.{digits}f}"
                f"{quantity.sigma:>12.{digits}f}{quantity.n_sigmas:>10.1f}"
            )
    if part.readings != "same":
        p_value = f"= {part.p_value:.2g}" if part.p_value else "below 1e-300"
        yield (
            f"  Mahalanobis distance {np.sqrt(part.chi_square):.1f} in {part.dof} directions,"
            f" p {p_value}"
        )
    if part.readings == "partly the same":
        yield "  part of the readings is the same: the sigmas are too large"
    yield f"  {part.judgement}"


def _decimals(sigma: float) -> int:
    """Give how many decimals show two digits of a sigma."""
    return int(np.clip(1 - np.floor(np.log10(sigma)), 0, 9)) if sigma > 0 else 9


def _list(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
