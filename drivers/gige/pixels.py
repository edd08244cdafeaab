"""From the bytes of a frame on the wire to grey values.

Pixel formats by their number in the Pixel Format Naming Convention (PFNC) of EMVA.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

GreyImage: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class WireFormat:
    """A pixel format as it is sent."""

    name: str
    bits_per_pixel: int
    decode: Callable[[NDArray[np.uint8]], GreyImage]
    """Copies grey values, shape (n,), out of the bytes of n pixels."""

    def n_bytes(self, n_pixels: int) -> int:
        """Give the size of so many pixels."""
        return -(-n_pixels * self.bits_per_pixel // 8)


def unpack_mono12_packed(packed: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Unpack two pixels of 12 bits in three bytes, as GigE Vision 1.0 packs them.

    The first and the third byte hold the upper 8 bits of their pixel; the one between them holds
    the lower 4 bits of both, those of the first pixel in its lower half.

    Args:
        packed: Bytes, shape (n,); a last pair may lack its second pixel.

    Returns:
        Values 0 to 4095, shape (2 n // 3,).
    """
    n_pixels = packed.size * 2 // 3
    triples = np.zeros((-(-packed.size // 3), 3), np.uint8)
    triples.reshape(-1)[: packed.size] = packed
    first, low, second = triples.T
    pixels = np.empty((len(triples), 2), np.uint16)
    np.left_shift(first, 4, out=pixels[:, 0], dtype=np.uint16)
    np.left_shift(second, 4, out=pixels[:, 1], dtype=np.uint16)
    pixels[:, 0] |= low & 0x0F
    pixels[:, 1] |= low >> 4
    return pixels.reshape(-1)[:n_pixels]


def _copy_mono8(raw: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return raw.copy()


def _copy_mono12(raw: NDArray[np.uint8]) -> NDArray[np.uint16]:
    return raw.view("<u2").astype(np.uint16)


WIRE_FORMATS: Final[Mapping[int, WireFormat]] = {
    0x01080001: WireFormat("Mono8", 8, _copy_mono8),
    0x01100005: WireFormat("Mono12", 16, _copy_mono12),
    0x010C0006: WireFormat("Mono12Packed", 12, unpack_mono12_packed),
}
"""What the driver can decode, by PFNC number."""
