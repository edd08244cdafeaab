"""Decoding of pixel formats, against values worked out by hand and a slow decoder."""

import numpy as np
import pytest

from drivers.gige.pixels import WIRE_FORMATS, unpack_mono12_packed


def packed_by_hand(values: np.ndarray) -> np.ndarray:
    """Pack pixel by pixel: upper 8 bits in a byte of their own, lower 4 bits between."""
    packed = bytearray()
    for i in range(0, len(values), 2):
        first = int(values[i])
        second = int(values[i + 1]) if i + 1 < len(values) else 0
        packed += bytes([first >> 4, (first & 15) | (second & 15) << 4, second >> 4])
    return np.frombuffer(bytes(packed), np.uint8)[: (3 * len(values) + 1) // 2]


def test_two_pixels_share_the_middle_byte():
    assert unpack_mono12_packed(np.array([0xAB, 0x6C, 0x45], np.uint8)).tolist() == [0xABC, 0x456]


@pytest.mark.parametrize("n_pixels", [1, 2, 3, 64, 1361])
def test_packed_pixels_come_back(n_pixels: int, rng: np.random.Generator):
    values = rng.integers(0, 4096, n_pixels, dtype=np.uint16)
    unpacked = unpack_mono12_packed(packed_by_hand(values))
    assert unpacked.dtype == np.uint16
    np.testing.assert_array_equal(unpacked, values)


def test_every_format_has_the_size_of_its_pixels():
    sizes = {wire.name: wire.n_bytes(1361 * 1023) for wire in WIRE_FORMATS.values()}
    n = 1361 * 1023
    assert sizes == {"Mono8": n, "Mono12": 2 * n, "Mono12Packed": (3 * n + 1) // 2}


@pytest.mark.parametrize("number", WIRE_FORMATS)
def test_decoded_pixels_are_a_copy(number: int):
    wire = WIRE_FORMATS[number]
    raw = np.zeros(wire.n_bytes(4), np.uint8)
    pixels = wire.decode(raw)
    raw[:] = 255
    assert pixels.tolist() == [0, 0, 0, 0]


def test_mono12_has_its_low_byte_first():
    wire = next(wire for wire in WIRE_FORMATS.values() if wire.name == "Mono12")
    assert wire.decode(np.array([0xBC, 0x0A], np.uint8)).tolist() == [0xABC]
