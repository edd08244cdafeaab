"""Mitsuba and Dr.Jit, imported where they are installed."""

import os
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tronlab.render.renderer import RenderError

_VARIANT = "llvm_ad_mono"
_OLDEST_LLVM = (17, 0, 0)
_LLVM_PATH = "DRJIT_LIBLLVM_PATH"
_LLVM_REMEDY = (
    "pip install karellen-llvm-core, or install the system's (Debian: libllvm19), or set"
    f" {_LLVM_PATH} to a libLLVM.so"
)


class Backend(NamedTuple):
    """Mitsuba and Dr.Jit, which carry no types, and numbers in their form.

    The numbers lie in memory: a plain number would become part of the compiled code, and each new
    pose or lamp would be compiled for.
    """

    mi: Any
    dr: Any

    def number(self, value: float) -> Any:
        """Give a Float."""
        return self.dr.opaque(self.mi.Float, float(value))

    def vector(self, xyz: ArrayLike) -> Any:
        """Give a Vector3f of three numbers."""
        return self.mi.Vector3f([self.number(value) for value in np.asarray(xyz)])

    def point(self, xyz: ArrayLike) -> Any:
        """Give a Point3f of three numbers."""
        return self.mi.Point3f(self.vector(xyz))


def load_backend() -> Backend:
    """Import Mitsuba and choose the variant that compiles for this processor.

    Only that variant casts rays from a table at once: the scalar ones take them one by one from
    Python, a million times slower, so there is no fallback to them.

    Raises:
        RenderError: Mitsuba is not installed, or LLVM's library not found or too old.
    """
    if find_spec("mitsuba") is None:
        raise RenderError(
            "renderer mitsuba: needs the package mitsuba\npip install 'tronlab[mitsuba]'"
        )
    _point_to_llvm()
    dr = import_module("drjit")
    if not dr.has_backend(dr.JitBackend.LLVM):
        raise RenderError(f"renderer mitsuba: LLVM's library is not found\n{_LLVM_REMEDY}")
    version = dr.detail.llvm_version()
    if version < _OLDEST_LLVM:
        # An older one has no code for some operations, and ends the process where it meets them.
        raise RenderError(
            f"renderer mitsuba: LLVM found is {'.'.join(map(str, version))}, must be"
            f" {_OLDEST_LLVM[0]} or newer\n{_LLVM_REMEDY}"
        )
    mi = import_module("mitsuba")
    mi.set_variant(_VARIANT)
    return Backend(mi, dr)


def _point_to_llvm() -> None:
    """Let Dr.Jit find an LLVM that lies in the environment itself: it only asks the system."""
    library = Path(sys.prefix) / "lib" / "libLLVM.so"
    if library.exists():
        os.environ.setdefault(_LLVM_PATH, str(library))
