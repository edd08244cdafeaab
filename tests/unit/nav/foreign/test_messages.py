"""Messages survive the wire, and whatever else comes is one kind of error."""

import json
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tronlab.nav.foreign.messages import (
    MAX_HEADER_SIZE,
    PREFIX_SIZE,
    Message,
    MessageError,
    StrayBytesError,
    check_magic,
    decode_header,
    decode_prefix,
    encode,
)
from tronlab.nav.foreign.shared_memory import MappedFrame, SharedFrame

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(st.characters(codec="utf-8")),
    lambda inner: st.lists(inner, max_size=3)
    | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)  # fmt: skip
ARRAYS = st.dictionaries(
    st.text(st.characters(codec="utf-8"), max_size=5),
    hnp.arrays(
        st.sampled_from(["u1", "<u2", ">u2", "<i8", "<f4", ">f8", "?"]),
        hnp.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4),
    ),
    max_size=4,
)


def decoded(data: bytes) -> Message:
    n_header, n_payload = decode_prefix(data[:PREFIX_SIZE])
    assert len(data) == PREFIX_SIZE + n_header + n_payload
    header = decode_header(data[PREFIX_SIZE : PREFIX_SIZE + n_header])
    return Message(header, data[PREFIX_SIZE + n_header :])


@settings(max_examples=20, deadline=None)
@given(st.dictionaries(st.text(st.characters(codec="utf-8"), max_size=5), JSON), ARRAYS)
def test_every_header_and_array_comes_back_as_it_was(
    header: dict[str, Any], arrays: dict[str, np.ndarray]
) -> None:
    header = {**header, "type": "frame"}
    header.pop("parts", None)
    message = decoded(b"".join(encode(header, arrays)))
    assert {**message.header, "parts": None} == {**header, "parts": None}
    back = message.arrays()
    assert back.keys() == arrays.keys()
    for name, array in arrays.items():
        np.testing.assert_array_equal(back[name], array)
        assert back[name].shape == array.shape
        assert back[name].dtype.itemsize == array.dtype.itemsize


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_a_damaged_message_is_a_message_or_one_kind_of_error(data: st.DataObject) -> None:
    arrays = {"uv_inliers": np.arange(6.0).reshape(3, 2), "mask": np.ones((2, 3), np.bool_)}
    good = b"".join(encode({"type": "result", "number": 4}, arrays))
    damaged = bytearray(good)
    for _ in range(data.draw(st.integers(1, 3))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    complaint = ""
    try:
        n_header, _ = decode_prefix(bytes(damaged[:PREFIX_SIZE]))
        header = decode_header(bytes(damaged[PREFIX_SIZE : PREFIX_SIZE + n_header]))
        Message(header, bytes(damaged[PREFIX_SIZE + n_header :])).arrays()
    except MessageError as error:
        complaint = str(error)
    assert len(complaint) < 600


@settings(max_examples=40, deadline=None)
@given(JSON)
def test_whatever_stands_in_parts_is_arrays_or_one_kind_of_error(parts: object) -> None:
    for value in (parts, [parts], [{"name": "a", "dtype": "u1", "shape": parts, "offset": 0}]):
        try:
            arrays = Message({"type": "x", "parts": value}, bytes(16)).arrays()
        except MessageError:
            continue
        assert all(array.nbytes <= 16 for array in arrays.values())


@pytest.mark.parametrize(
    ("part", "what"),
    [
        ({"dtype": "f2"}, "dtype is 'f2', must be u1, u2"),
        ({"dtype": ["u1"]}, r"dtype is \['u1'\]"),
        ({"shape": [3, -1]}, "shape is .* whole numbers"),
        ({"shape": [True]}, "shape is"),
        ({"shape": [1 << 31, 0, 1]}, None),
        ({"shape": [1 << 31, 1 << 31, 1 << 31, 0]}, "their product at most 4294967296"),
        ({"shape": [1 << 40]}, "shape is"),
        ({"shape": [1] * 5}, "at most 4"),
        ({"shape": [1] * 100_000}, "at most 4"),
        ({"shape": [1 << 16, 1 << 16]}, "reaches to byte 4294967296 of the payload"),
        ({"shape": [17]}, "reaches to byte 17 of the payload, which has 16"),
        ({"offset": 16, "shape": [1]}, "reaches to byte 17"),
        ({"offset": 4}, "offset is 4, must be a multiple of 8"),
        ({"offset": 0.0}, "offset is 0.0"),
        ({"offset": None}, "offset is None"),
        ({"where": "shared_memory"}, "there is no such memory"),
        ({"where": []}, "there is no such memory"),
        ({"name": 1}, "name is 1, must be text"),
    ],
)
def test_parts_that_cannot_be_say_why(part: dict[str, object], what: str | None) -> None:
    whole = {"name": "a", "dtype": "u1", "shape": [16], "offset": 0, "where": "payload", **part}
    message = Message({"type": "x", "parts": [whole]}, bytes(16))
    if what is None:  # nothing in it
        assert message.arrays()["a"].size == 0
        return
    with pytest.raises(MessageError, match=what):
        message.arrays()


def test_two_parts_of_one_name_are_refused() -> None:
    part = {"name": "a", "dtype": "u1", "shape": [1], "offset": 0}
    with pytest.raises(MessageError, match="two parts are called 'a'"):
        Message({"type": "x", "parts": [part, part]}, bytes(8)).arrays()


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (b"{'a': 1}", "no JSON"),
        (b"\xff\xfe", "no JSON"),
        (b"[" * 100_000, "no JSON"),
        (b'{"type": 1' + b"0" * 5000 + b"}", "no JSON"),
        (b"[]", "no object with a 'type'"),
        (b'{"type": 3}', "no object with a 'type'"),
        (b"", "no JSON"),
    ],
)
def test_a_header_that_is_none_is_quoted(text: bytes, what: str) -> None:
    with pytest.raises(MessageError, match=what) as caught:
        decode_header(text)
    assert len(str(caught.value)) < 400


@settings(max_examples=25)
@given(st.binary(max_size=8) | st.integers(0, 4).map(lambda n: b"TLC1"[:n]))
def test_only_the_beginning_of_a_message_passes_for_one(first: bytes) -> None:
    if b"TLC1".startswith(first[:4]):
        check_magic(first)
        return
    with pytest.raises(StrayBytesError):
        check_magic(first)


def test_lengths_are_checked_before_anything_is_made() -> None:
    with pytest.raises(MessageError, match=f"header of 4294967295 bytes; at most {1 << 20}"):
        decode_prefix(struct.pack("<4sIQ", b"TLC1", (1 << 32) - 1, 0))
    with pytest.raises(MessageError, match="payload of 9223372036854775808 bytes"):
        decode_prefix(struct.pack("<4sIQ", b"TLC1", 2, 1 << 63))
    with pytest.raises(MessageError, match="at most 9 are allowed"):
        decode_prefix(struct.pack("<4sIQ", b"TLC1", 2, 10), max_payload=9)


@pytest.mark.parametrize(
    ("header", "arrays", "what"),
    [
        ({"settings": object()}, {}, "cannot be written as JSON"),
        ({"settings": float("nan")}, {}, "cannot be written as JSON"),
        ({"reason": "x" * MAX_HEADER_SIZE}, {}, "at most 1048576"),
        ({}, {"image": np.zeros(3, np.int32)}, "arrays of int32 cannot be sent"),
        ({}, {"image": np.zeros(3, np.complex128)}, "arrays of complex128 cannot be sent"),
    ],
)
def test_what_cannot_be_sent_says_why(
    header: dict[str, object], arrays: dict[str, np.ndarray], what: str
) -> None:
    with pytest.raises(MessageError, match=what):
        encode({"type": "x", **header}, arrays)


def test_shared_memory_holds_one_frame_after_the_other() -> None:
    memory = SharedFrame(1000)
    seen = MappedFrame(memory.path, memory.size)
    for value in (1, 2):
        arrays = {"image": np.full((11, 9), 300 * value, np.uint16), "mask": np.eye(9, dtype=bool)}
        parts = memory.put(arrays)
        header = json.loads(json.dumps({"type": "frame", "parts": parts}))
        back = Message(header).arrays(seen.data)
        for name, array in arrays.items():
            np.testing.assert_array_equal(back[name], array)
    assert memory.put({"image": np.zeros(1001, np.uint8)}) is None  # it does not fit
    with pytest.raises(MessageError, match="reaches to byte 1008 of the shared_memory"):
        Message(
            {"type": "frame", "parts": [{"name": "a", "dtype": "u1", "shape": [8], "offset": 1000,
                                         "where": "shared_memory"}]}
        ).arrays(seen.data)  # fmt: skip
    assert memoryview(seen.data).readonly  # a core cannot write into it by mistake
    memory.close()
    memory.close()
    assert bytes(seen.data[:2]) == (600).to_bytes(2, "little")
