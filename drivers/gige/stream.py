"""Counting the frames of a free-running camera by their block ids."""

from dataclasses import dataclass
from typing import Final, Self

_N_SHORT_IDS: Final = 65535  # GigE Vision 1.x counts 1 to 65535, then 1 again


class BlockIds:
    """Which block ids came, whatever their order and however often they began anew."""

    def __init__(self) -> None:
        self.n = 0
        """How many came."""
        self._lowest = self._highest = self._latest = 0

    def add(self, block_id: int) -> None:
        """Count a frame."""
        if self.n == 0:
            self._lowest = self._highest = self._latest = block_id
        self._latest += self._step_to(block_id)
        self._lowest = min(self._lowest, self._latest)
        self._highest = max(self._highest, self._latest)
        self.n += 1

    @property
    def n_missing(self) -> int:
        """Get how many ids between the lowest and the highest did not come."""
        return self._highest - self._lowest + 1 - self.n if self.n else 0

    def _step_to(self, block_id: int) -> int:
        """Give how far on an id is from the latest one, the short way round."""
        step = block_id - self._latest
        if block_id > _N_SHORT_IDS:
            return step  # GigE Vision 2.x counts in 64 bits
        half = _N_SHORT_IDS // 2
        return (step + half) % _N_SHORT_IDS - half


@dataclass(frozen=True, slots=True)
class StreamCounters:
    """What became of the frames a camera sent, from the first complete one on."""

    n_delivered: int
    """Complete frames handed out."""
    n_incomplete: int
    """Frames that came with gaps, and were dropped."""
    n_lost: int
    """Frames of which nothing came, or for which there was no buffer: gaps in the block ids."""

    @classmethod
    def of(cls, ids: BlockIds, *, n_incomplete: int) -> Self:
        """Count from the ids of the complete frames.

        The ids of incomplete frames are missing among them, except before the first and after
        the last.
        """
        n_lost = max(0, ids.n_missing - n_incomplete)
        return cls(n_delivered=ids.n, n_incomplete=n_incomplete, n_lost=n_lost)
