# pyright: basic
"""Compiled: how many bits of two descriptors differ, and who of several is nearest."""

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from tronlab.nav.matching.matches import SAME_POINT_SIZES
from tronlab.terrain.kernels import inlined

_USUAL_BYTES = (61, 64)
"""Of AKAZE and BRISK: their words are counted without a loop, in half the time."""


def _make_n_ones(_typing_context, _word):
    """Count the ones of a 64-bit word; numba has no function for it."""

    def generate(_context, builder, _signature, arguments):
        return builder.ctpop(arguments[0])

    return types.uint64(types.uint64), generate


def _make_word_at(_typing_context, _address):
    """Read a 64-bit word from an address that need not be a multiple of 8, as numba cannot."""

    def generate(_context, builder, _signature, arguments):
        pointer = builder.inttoptr(arguments[0], ir.IntType(64).as_pointer())
        word = builder.load(pointer)
        word.align = 1
        return word

    return types.uint64(types.intp), generate


n_ones: Any = intrinsic(_make_n_ones)
word_at: Any = intrinsic(_make_word_at)


@inlined
def n_different(a, i, b, j):
    """Count the bits in which row i of ``Words`` a differs from row j of b."""
    n_bytes = a.rows.shape[1]
    p, q = a.address + i * n_bytes, b.address + j * n_bytes
    n = n_ones((word_at(p + n_bytes - 8) ^ word_at(q + n_bytes - 8)) >> a.overlap_bits)
    if _USUAL_BYTES[0] <= n_bytes <= _USUAL_BYTES[1]:
        return (
            n
            + n_ones(word_at(p) ^ word_at(q))
            + n_ones(word_at(p + 8) ^ word_at(q + 8))
            + n_ones(word_at(p + 16) ^ word_at(q + 16))
            + n_ones(word_at(p + 24) ^ word_at(q + 24))
            + n_ones(word_at(p + 32) ^ word_at(q + 32))
            + n_ones(word_at(p + 40) ^ word_at(q + 40))
            + n_ones(word_at(p + 48) ^ word_at(q + 48))
        )
    for byte in range(0, n_bytes - 8, 8):
        n += n_ones(word_at(p + byte) ^ word_at(q + byte))
    return n


@inlined
def are_apart(places, i, k):
    """Tell whether landmark k is elsewhere on the terrain than landmark i."""
    p = places.p_trs_m
    x, y, z = p[i, 0] - p[k, 0], p[i, 1] - p[k, 1], p[i, 2] - p[k, 2]
    return x * x + y * y + z * z > (SAME_POINT_SIZES * places.size_m[i]) ** 2
