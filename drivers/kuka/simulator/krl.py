"""Values as the controller writes them: ``TRUE``, ``#T1``, ``{E6AXIS: A1 0.0, A2 -90.0, ...}``."""

import re
from collections.abc import Mapping, Sequence
from typing import Final

from drivers.kuka.simulator.command import CartesianPosition
from tronlab.geometry.poses import FloatArray

NAN: Final = float("nan")
"""An undefined value; KRL has those."""

_EXTERNAL = ("E1", "E2", "E3", "E4", "E5", "E6")
AXIS_MEMBERS: Final = ("A1", "A2", "A3", "A4", "A5", "A6", *_EXTERNAL)
POSITION_MEMBERS: Final = ("X", "Y", "Z", "A", "B", "C", "S", "T", *_EXTERNAL)

_STRUCTURE = re.compile(r"\s*\{\s*(?:(?P<type>\w+)\s*:)?(?P<members>[^{}]*)\}\s*", re.ASCII)


def real(value: float) -> str:
    """Write a REAL: up to nine digits, and always recognisable as one."""
    text = f"{value:.9g}"
    return text if any(sign in text for sign in ".en") else f"{text}.0"


def boolean(is_true: bool) -> str:
    """Write a BOOL."""
    return "TRUE" if is_true else "FALSE"


def e6axis(axes: FloatArray) -> str:
    """Write axes, shape (7,), degrees and mm; the external axes after E1 are 0."""
    values = [*(real(float(value)) for value in axes), *[real(0.0)] * 5]
    return _structure("E6AXIS", AXIS_MEMBERS, values)


def e6pos(position: CartesianPosition) -> str:
    """Write a position; the external axes after E1 are 0."""
    p = position
    place = [real(v) for v in (p.x_mm, p.y_mm, p.z_mm, p.a_deg, p.b_deg, p.c_deg)]
    branch = [str(p.status), str(p.turn)]
    external = [real(p.e1_mm), *[real(0.0)] * 5]
    return _structure("E6POS", POSITION_MEMBERS, [*place, *branch, *external])


def frame(values: Sequence[float]) -> str:
    """Write a FRAME of X, Y, Z in mm and A, B, C in degrees."""
    return _structure("FRAME", POSITION_MEMBERS[:6], [real(value) for value in values])


def read_structure(text: str, kind: str, members: Sequence[str]) -> dict[str, float]:
    """Read a structure; members that are not mentioned stay undefined and are left out.

    Raises:
        ValueError: Not such a structure.
    """
    match = _STRUCTURE.fullmatch(text.upper())
    if match is None or match["type"] not in (None, kind):
        raise ValueError(f"no {kind}: {text!r}")
    values: dict[str, float] = {}
    for item in filter(str.strip, match["members"].split(",")):
        name, *value = item.split()
        if name not in members or len(value) != 1:
            raise ValueError(f"no member of {kind}: {item.strip()!r}")
        values[name] = float(value[0])
    return values


def write_structure(kind: str, members: Mapping[str, float]) -> str:
    """Write a structure of the members that are defined."""
    texts = [str(int(v)) if name in ("S", "T") else real(v) for name, v in members.items()]
    return _structure(kind, list(members), texts)


def _structure(kind: str, members: Sequence[str], values: Sequence[str]) -> str:
    listed = ", ".join(f"{name} {value}" for name, value in zip(members, values, strict=True))
    return f"{{{kind}: {listed}}}"
