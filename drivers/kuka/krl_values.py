"""Values of KRL variables as text: ``{E6AXIS: A1 0.0, A2 -90.0, ...}``, ``TRUE``, ``#T1``, ``35``.

Controllers write up to nine significant digits, exponents, blanks and either case, and leave out
members that were never set.
"""

import math
import re
from typing import Final

from scipy.spatial.transform import RigidTransform

from drivers.kuka.position import Axes, pose_from_xyz_mm_abc_deg, xyz_mm_abc_deg
from tronlab.kinematics.kr16 import AXIS_NAMES

_POSITION_NAMES: Final = ("X", "Y", "Z", "A", "B", "C")
_EXTERNAL_NAMES: Final = tuple(f"E{i}" for i in range(1, 7))
_STRUCTURE = re.compile(r"\s*\{\s*(?:(?P<type>\w+)\s*:)?(?P<members>[^{}]*)\}\s*")
_MEMBER = re.compile(r"\s*(?P<name>[A-Za-z_]\w*)\s+(?P<value>\S+)\s*")


def parse_structure(text: str) -> dict[str, float]:
    """Read a structure of numbers; the names of its members become upper-case.

    Raises:
        ValueError: It is no such structure.
    """
    structure = _STRUCTURE.fullmatch(text)
    if structure is None:
        raise ValueError(f"'{text}' is no structure, expected {{TYPE: NAME value, ...}}")
    members: dict[str, float] = {}
    for part in filter(str.strip, structure["members"].split(",")):
        member = _MEMBER.fullmatch(part)
        if member is None:
            raise ValueError(f"'{part.strip()}' is no member, expected NAME value")
        members[member["name"].upper()] = parse_real(member["value"])
    return members


def parse_axes(text: str) -> Axes:
    """Read an E6AXIS.

    Raises:
        ValueError: A1 to A6 or E1 is missing or no number.
    """
    members = parse_structure(text)
    *arm_deg, e1_mm = _all_of(members, (*AXIS_NAMES, "E1"))
    return Axes.from_controller(arm_deg, e1_mm)


def parse_position(text: str) -> RigidTransform:
    """Read the pose of a FRAME, POS or E6POS.

    Raises:
        ValueError: One of X, Y, Z, A, B, C is missing or no number.
    """
    return pose_from_xyz_mm_abc_deg(_all_of(parse_structure(text), _POSITION_NAMES))


def parse_real(text: str) -> float:
    """Read a REAL.

    Raises:
        ValueError: It is no finite number.
    """
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"'{text}' is not finite")
    return value


def parse_bool(text: str) -> bool:
    """Read a BOOL.

    Raises:
        ValueError: It is neither TRUE nor FALSE.
    """
    values = {"TRUE": True, "FALSE": False}
    if text.strip().upper() not in values:
        raise ValueError(f"'{text}' is no BOOL, expected TRUE or FALSE")
    return values[text.strip().upper()]


def parse_enum(text: str) -> str:
    """Read an enumeration value, ``#P_ACTIVE``, without its sign and in upper case.

    Raises:
        ValueError: It does not begin with #.
    """
    if not text.strip().startswith("#"):
        raise ValueError(f"'{text}' is no enumeration value, expected #NAME")
    return text.strip()[1:].upper()


def parse_text(text: str) -> str:
    """Read a CHAR array: some servers put it in quotation marks."""
    return text.strip().strip('"').strip()


def format_axes(axes: Axes) -> str:
    """Write an E6AXIS with all its members."""
    values = (*axes.arm_deg, axes.e1_mm, *(0.0,) * 5)
    return _structure("E6AXIS", (*AXIS_NAMES, *_EXTERNAL_NAMES), values)


def format_position(base_from_flange: RigidTransform, axes: Axes, *, status: int, turn: int) -> str:
    """Write an E6POS with all its members; E1 is that of the axes."""
    pose = _members(_POSITION_NAMES, xyz_mm_abc_deg(base_from_flange))
    external = _members(_EXTERNAL_NAMES, (axes.e1_mm, *(0.0,) * 5))
    return f"{{E6POS: {pose}, S {status}, T {turn}, {external}}}"


def _structure(name: str, names: tuple[str, ...], values: tuple[float, ...]) -> str:
    return f"{{{name}: {_members(names, values)}}}"


def _members(names: tuple[str, ...], values: tuple[float, ...]) -> str:
    pairs = zip(names, values, strict=True)
    return ", ".join(f"{name} {round(value, 6) + 0.0:.6f}" for name, value in pairs)


def _all_of(members: dict[str, float], names: tuple[str, ...]) -> list[float]:
    missing = [name for name in names if name not in members]
    if missing:
        raise ValueError(f"lacks {', '.join(missing)}; it has {', '.join(members) or 'nothing'}")
    return [members[name] for name in names]
