"""Floats and counts in registers, against pymodbus and against the simulator's own tables."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymodbus.client.mixin import ModbusClientMixin

from drivers.room.registers import count_from_words, float_from_words

WORD_ORDERS = st.sampled_from(["big", "little"])
FLOAT32 = ModbusClientMixin.DATATYPE.FLOAT32
UINT32 = ModbusClientMixin.DATATYPE.UINT32


@pytest.mark.parametrize(
    ("words", "word_order"), [((0x41AC, 0x0000), "big"), ((0x0000, 0x41AC), "little")]
)
def test_golden_words_of_21_5(words: tuple[int, int], word_order):
    assert float_from_words(words, word_order=word_order) == 21.5


@settings(deadline=None)
@given(value=st.floats(width=32), word_order=WORD_ORDERS)
def test_floats_are_what_pymodbus_wrote(value: float, word_order):
    words = ModbusClientMixin.convert_to_registers(value, FLOAT32, word_order=word_order)
    read = float_from_words(words, word_order=word_order)
    assert read == value or (math.isnan(read) and math.isnan(value))


@settings(deadline=None)
@given(value=st.integers(0, 2**32 - 1), word_order=WORD_ORDERS)
def test_counts_are_what_pymodbus_wrote(value: int, word_order):
    words = ModbusClientMixin.convert_to_registers(value, UINT32, word_order=word_order)
    assert count_from_words(words, word_order=word_order) == value
