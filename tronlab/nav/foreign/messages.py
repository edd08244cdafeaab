"""Messages of the core protocol: a JSON header and arrays, as bytes and back.

docs/reference/core_protocol.md is the specification. Reading trusts nothing: whatever the bytes
are, the outcome is a message or a ``MessageError``, and no length is believed before it is checked.
"""

import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import prod
from typing import Any, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

MAGIC = b"TLC1"
_LENGTHS = struct.Struct("<IQ")
PREFIX_SIZE = len(MAGIC) + _LENGTHS.size
MAX_HEADER_SIZE = 1 << 20
MAX_PAYLOAD_SIZE = 1 << 32
_ALIGNMENT = 8
_MAX_DIMENSIONS = 4
_DTYPES = {name: np.dtype(f"<{name}") for name in ("u1", "u2", "i8", "f4", "f8")}
_QUOTED_BYTES = 80
_LONGEST_VALUE = 160

Buffer: TypeAlias = bytes | bytearray | memoryview
AnyArray: TypeAlias = NDArray[Any]


class MessageError(Exception):
    """What came is no message of the protocol; the text says what it is instead."""


class StrayBytesError(MessageError):
    """It does not even begin like a message: a program printed something."""


@dataclass(frozen=True, slots=True)
class Message:
    """One message as it came."""

    header: Mapping[str, Any]
    payload: Buffer = b""

    @property
    def kind(self) -> str:
        """Get the header's ``type``."""
        return self.header["type"]

    def arrays(self, shared: Buffer | None = None) -> dict[str, AnyArray]:
        """Give the arrays by name, as views of the payload or of the shared memory.

        Raises:
            MessageError: The header describes them wrongly, or they reach beyond their memory.
        """
        parts = self.header.get("parts") or []
        if not isinstance(parts, list):
            raise MessageError(f"'parts' is {brief(parts)}, must be a list of objects")
        arrays: dict[str, AnyArray] = {}
        for part in cast(list[object], parts):
            name, array = _array(part, {"payload": self.payload, "shared_memory": shared})
            if name in arrays:
                raise MessageError(f"two parts are called {name!r}")
            arrays[name] = array
        return arrays


def encode(
    header: Mapping[str, object], arrays: Mapping[str, AnyArray] | None = None
) -> list[Buffer]:
    """Give a message as pieces to be sent one after the other, without copying large arrays.

    Args:
        header: Keys and values as JSON has them, with ``type``.
        arrays: Sent as parts in the payload, behind those the header describes already.

    Raises:
        MessageError: It would be larger than messages may be, or is not JSON.
    """
    parts: list[object] = list(cast(Sequence[object], header.get("parts", ())))
    pieces: list[Buffer] = []
    size = 0
    for name, array in (arrays or {}).items():
        padding = -size % _ALIGNMENT
        wire = wire_array(array)
        size += padding
        parts.append(describe_part(name, wire, offset=size))
        # A view of bytes cannot be cast from an empty array.
        pieces += [bytes(padding), wire.data.cast("B") if wire.size else b""]
        size += wire.nbytes
    text = _json({**header, "parts": parts} if parts else header)
    if len(text) > MAX_HEADER_SIZE or size > MAX_PAYLOAD_SIZE:
        raise MessageError(
            f"a message has a header of {len(text)} and a payload of {size} bytes;"
            f" at most {MAX_HEADER_SIZE} and {MAX_PAYLOAD_SIZE} are allowed"
        )
    return [MAGIC + _LENGTHS.pack(len(text), size) + text, *(piece for piece in pieces if piece)]


def wire_array(array: AnyArray) -> AnyArray:
    """Give an array as it is sent: little endian, C order, truth values as 0 and 1.

    Raises:
        MessageError: The protocol has no such type of numbers.
    """
    if array.dtype == np.bool_:
        array = array.view(np.uint8)
    code = f"{array.dtype.kind}{array.dtype.itemsize}"
    if code not in _DTYPES:
        raise MessageError(f"arrays of {array.dtype} cannot be sent, only {', '.join(_DTYPES)}")
    # Not ascontiguousarray, which makes a number an array of one.
    return np.asarray(array, dtype=_DTYPES[code], order="C")


def describe_part(name: str, wire: AnyArray, *, offset: int, where: str = "payload") -> object:
    """Give the entry in ``parts`` of an array as ``wire_array`` gives it."""
    return {
        "name": name,
        "dtype": f"{wire.dtype.kind}{wire.dtype.itemsize}",
        "shape": list(wire.shape),
        "offset": offset,
        "where": where,
    }


def check_magic(first: Buffer) -> None:
    """Return if a message may begin with these bytes, be they less than a prefix.

    Raises:
        StrayBytesError: None does.
    """
    if bytes(first[: len(MAGIC)]) != MAGIC[: len(first)]:
        raise StrayBytesError(f"wrote {quoted(first)}")


def decode_prefix(prefix: Buffer, *, max_payload: int = MAX_PAYLOAD_SIZE) -> tuple[int, int]:
    """Give the lengths of header and payload, bytes, from the ``PREFIX_SIZE`` first bytes.

    Raises:
        MessageError: It is no prefix, or a length is beyond what is allowed.
    """
    check_magic(prefix)
    n_header, n_payload = _LENGTHS.unpack(prefix[len(MAGIC) :])
    for what, size, limit in (
        ("header", n_header, MAX_HEADER_SIZE),
        ("payload", n_payload, max_payload),
    ):
        if size > limit:
            raise MessageError(f"announced a {what} of {size} bytes; at most {limit} are allowed")
    return n_header, n_payload


def decode_header(text: Buffer) -> dict[str, Any]:
    """Give the header of a message.

    Raises:
        MessageError: It is no JSON object with a ``type``.
    """
    try:
        header = json.loads(bytes(text))
    except (ValueError, RecursionError) as error:  # ValueError: not JSON, not UTF-8, a huge number
        raise MessageError(f"sent a header that is no JSON ({error}): {quoted(text)}") from None
    if not isinstance(header, dict) or not isinstance(header.get("type"), str):
        raise MessageError(f"sent a header that is no object with a 'type': {quoted(text)}")
    return cast(dict[str, Any], header)


def quoted(data: Buffer) -> str:
    """Give what came in words: its beginning as text if it is some, else bytes in hexadecimal."""
    beginning = bytes(data[:_QUOTED_BYTES])
    # A program that prints goes on with a message: that is not what is to be shown.
    printed = beginning.partition(MAGIC)[0].decode("utf-8", errors="ignore").strip()
    if printed and all(letter.isprintable() or letter.isspace() for letter in printed):
        return json.dumps(printed, ensure_ascii=False)
    return f"bytes {beginning[:16].hex(' ')}{'...' if len(data) > 16 else ''}"


def brief(value: object) -> str:
    """Give a value as it would be written, and no more than a line of it."""
    text = repr(value)
    return text if len(text) <= _LONGEST_VALUE else f"{text[:_LONGEST_VALUE]}..."


def _array(part: object, memory: Mapping[str, Buffer | None]) -> tuple[str, AnyArray]:
    if not isinstance(part, dict):
        raise MessageError(f"a part is {brief(part)}, must be an object")
    values = cast(dict[str, object], part)
    name, dtype, shape = values.get("name"), values.get("dtype"), values.get("shape")
    offset, where = values.get("offset"), values.get("where", "payload")
    if not isinstance(name, str):
        raise MessageError(f"a part's name is {brief(name)}, must be text")
    what = f"part {brief(name)}"
    if not isinstance(dtype, str) or dtype not in _DTYPES:
        raise MessageError(f"{what}: dtype is {brief(dtype)}, must be {', '.join(_DTYPES)}")
    if not _is_shape(shape):
        raise MessageError(
            f"{what}: shape is {brief(shape)},"
            f" must be at most {_MAX_DIMENSIONS} whole numbers from 0, their product"
            f" at most {MAX_PAYLOAD_SIZE}"
        )
    if not _is_count(offset) or cast(int, offset) % _ALIGNMENT:
        raise MessageError(f"{what}: offset is {brief(offset)}, must be a multiple of 8")
    if not isinstance(where, str) or where not in memory or memory[where] is None:
        raise MessageError(f"{what}: where is {brief(where)}, there is no such memory")
    sizes, begin = cast(list[int], shape), cast(int, offset)
    room = memoryview(cast(Buffer, memory[where]))
    end = begin + prod(sizes) * _DTYPES[dtype].itemsize
    if end > len(room):
        raise MessageError(f"{what}: reaches to byte {end} of the {where}, which has {len(room)}")
    return name, np.frombuffer(room[begin:end], _DTYPES[dtype]).reshape(sizes)


def _is_count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _is_shape(value: object) -> bool:
    if not isinstance(value, list):
        return False
    sizes = cast(list[object], value)
    if len(sizes) > _MAX_DIMENSIONS or not all(map(_is_count, sizes)):
        return False
    # Without the zeros: an empty array must not have other sizes beyond all bounds.
    return prod(cast(int, size) or 1 for size in sizes) <= MAX_PAYLOAD_SIZE


def _json(header: Mapping[str, object]) -> bytes:
    try:
        return json.dumps(header, allow_nan=False, ensure_ascii=False).encode()
    except (TypeError, ValueError) as error:
        raise MessageError(f"a message cannot be written as JSON: {error}") from error
