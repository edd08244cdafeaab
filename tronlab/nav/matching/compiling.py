"""How the kernels of matching are compiled."""

from collections.abc import Callable
from typing import Any

from numba import njit

from tronlab.terrain.kernels import compiled_with

# Without numba's counting of references: handing on a tuple of arrays would cost several atomic
# operations an array and call, more than comparing two descriptors. So kernels cannot make arrays.
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "_nrt": False}


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function that makes no arrays; kept on disk like ``terrain.kernels.compiled``."""
    return compiled_with(function, **_OPTIONS)


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function into each kernel that calls it."""
    return njit(forceinline=True, **_OPTIONS)(function)
