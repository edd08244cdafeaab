"""What the simulated camera looks at: a test pattern, or the simulated laboratory."""

import threading
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Protocol

import numpy as np
from numpy.random import Generator

from drivers.gige.simulator.gvsp import GreyImage
from tronlab.errors import NotConnectedError
from tronlab.twin.instruments import CameraOptics
from tronlab.twin.world import World

_N_PATTERNS: Final = 1 << 16
_STRIDE: Final = 40503  # odd, so that every block id has a shift of its own
_LOOK_S: Final = 0.1


@dataclass(frozen=True, slots=True)
class Region:
    """The part of the sensor that is read out."""

    left_px: int
    top_px: int
    width_px: int
    height_px: int


@dataclass(frozen=True, slots=True)
class Exposure:
    """How one frame is taken."""

    block_id: int
    region: Region
    exposure_s: float
    gain_db: float
    pixel_format: str
    """``Mono8`` or ``Mono12``: how densely 12 bits are packed is no matter of the scene."""


class Scene(Protocol):
    """Anything that makes images."""

    def image(self, exposure: Exposure) -> GreyImage:
        """Give what the camera sees now, shape (rows, columns); called in mid-exposure."""
        ...


class PatternScene:
    """Noise that a receiver can compute for itself, other noise for every block id."""

    def image(self, exposure: Exposure) -> GreyImage:
        """Give the pattern of the block id, whatever the exposure."""
        region = exposure.region
        return pattern(exposure.block_id, region.width_px, region.height_px, exposure.pixel_format)


def pattern(n: int, width: int, height: int, pixel_format: str) -> GreyImage:
    """Compute the image of block id ``n``, to compare a received one with bit by bit.

    Pixel ``i``, counted row by row, is bits 20 to 31 of the hash (``lowbias32``) of
    ``i + n * 40503 mod 65536``; Mono8 has the upper eight of these twelve bits.

    Args:
        n: The block id.
        width: Columns.
        height: Rows.
        pixel_format: ``Mono8``, or ``Mono12`` and ``Mono12Packed``, which look alike unpacked.

    Returns:
        Grey values, shape (height, width), uint8 or uint16; not writable.
    """
    shift = n * _STRIDE % _N_PATTERNS
    codes = _hashes(width * height + _N_PATTERNS, pixel_format == "Mono8")
    return codes[shift : shift + width * height].reshape(height, width)


class WorldScene:
    """What the camera of the simulated laboratory sees; it looks ahead until it is closed."""

    def __init__(self, world: World, noise: Generator) -> None:
        self._world = world
        self._region = world.spec.camera
        self._optics = CameraOptics(world, noise)
        self._stopped = threading.Event()
        self._looker = threading.Thread(
            target=self._look_ahead, name="camera look-ahead", daemon=True
        )
        self._looker.start()

    def close(self) -> None:
        """Look no more; returns when a view that is being rendered is ready."""
        self._stopped.set()
        self._looker.join()

    def image(self, exposure: Exposure) -> GreyImage:
        """Render the region from where the camera truly is."""
        region = exposure.region
        self._region = self._region.model_copy(
            update={
                "left_px": region.left_px,
                "top_px": region.top_px,
                "width_px": region.width_px,
                "height_px": region.height_px,
            }
        )
        return self._optics.image(
            exposure_s=exposure.exposure_s,
            gain_db=exposure.gain_db,
            pixel_format=exposure.pixel_format,
            region=self._region,
        )

    def _look_ahead(self) -> None:
        """Render each view as soon as nothing moves any more.

        The world keeps what was rendered last, so that a trigger that comes later finds it ready: a
        real camera does not wait for its light either.
        """
        before: object = None
        while not self._stopped.wait(_LOOK_S):
            try:
                view = self._world.state.read().view
                if view == before:
                    self._world.radiance(self._region)
            except NotConnectedError:
                continue  # whoever serves the state has gone, and this process will follow
            before = view


@lru_cache(maxsize=8)
def _hashes(n: int, is_mono8: bool) -> GreyImage:
    """Hash 0 to n - 1 to grey values, shape (n,)."""
    x = np.arange(n, dtype=np.uint32)
    x ^= x >> 16
    x *= np.uint32(0x7FEB352D)
    x ^= x >> 15
    x *= np.uint32(0x846CA68B)
    x ^= x >> 16
    codes = (x >> 24).astype(np.uint8) if is_mono8 else (x >> 20).astype(np.uint16)
    codes.flags.writeable = False
    return codes
