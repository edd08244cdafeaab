"""Structures on the wire: dataclasses whose fields, in their order, are the layout.

emScon is little-endian, its integers and enumerations have 4 bytes and its structures no gaps
(emScon 3.6 header: packing 4), so a field's type says all there is to know.
"""

import struct
from collections.abc import Iterator
from dataclasses import fields
from functools import cache
from itertools import islice
from typing import Annotated, Any, TypeAlias, TypeVar, get_type_hints

I32: TypeAlias = Annotated[int, "i"]
U32: TypeAlias = Annotated[int, "I"]
F64: TypeAlias = Annotated[float, "d"]
Triple: TypeAlias = Annotated[tuple[float, float, float], "3d"]
Quadruple: TypeAlias = Annotated[tuple[float, float, float, float], "4d"]
Text32: TypeAlias = Annotated[str, "64s"]
"""32 units of UTF-16, padded with NUL."""
Text128: TypeAlias = Annotated[str, "256s"]

T = TypeVar("T")


@cache
def size_of(layout: type) -> int:
    """Give the bytes a structure takes."""
    return _struct(layout).size


def decode(layout: type[T], data: bytes) -> T:
    """Read a structure.

    Raises:
        ValueError: There are more or fewer bytes than it takes, or a text is none.
    """
    if len(data) != size_of(layout):
        raise ValueError(f"{layout.__name__} takes {size_of(layout)} bytes, got {len(data)}")
    values = iter(_struct(layout).unpack(data))
    return layout(*(_field(code, values) for code in _formats(layout)))


def _field(code: str, values: Iterator[Any]) -> Any:
    """Take what one field consists of."""
    if code.endswith("s"):
        return next(values).decode("utf-16-le").partition("\0")[0]
    if len(code) == 1:
        return next(values)
    return tuple(islice(values, int(code[:-1])))


@cache
def _struct(layout: type) -> struct.Struct:
    return struct.Struct("<" + "".join(_formats(layout)))


@cache
def _formats(layout: type) -> tuple[str, ...]:
    hints = get_type_hints(layout, include_extras=True)
    return tuple(hints[field.name].__metadata__[0] for field in fields(layout))
