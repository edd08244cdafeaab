"""One structure of the emScon TPI: fields at offsets (little-endian, packed without gaps).

Offsets count from the start of the structure. A field is an offset and a ``struct`` code: a code
with a count, such as ``3d``, is a sequence; ``64s`` is text of 16-bit units.
"""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

Values: TypeAlias = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Layout:
    """The fields of one structure."""

    size: int
    fields: Mapping[str, tuple[int, str]]

    def pack(self, values: Values) -> bytearray:
        """Write all fields; ``values`` must have each, and no others.

        Raises:
            ValueError: It has not.
        """
        if values.keys() != self.fields.keys():
            raise ValueError(f"fields {sorted(values)}, expected {sorted(self.fields)}")
        data = bytearray(self.size)
        for name, (offset, code) in self.fields.items():
            struct.pack_into(f"<{code}", data, offset, *_plain(code, values[name]))
        return data

    def unpack(self, data: bytes) -> dict[str, Any]:
        """Read all fields; a field with a count gives a tuple."""
        values: dict[str, Any] = {}
        for name, (offset, code) in self.fields.items():
            read = struct.unpack_from(f"<{code}", data, offset)
            values[name] = read if len(code) > 1 else read[0]
        return values


def _plain(code: str, value: Any) -> Sequence[Any]:
    if code.endswith("s"):
        return (str(value).encode("utf-16-le")[: int(code[:-1]) - 2],)
    return value if len(code) > 1 else (value,)
