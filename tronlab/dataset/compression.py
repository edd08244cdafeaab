"""Lossless compression of images as HDF5 itself does it, on all processors.

HDF5 compresses in one thread only. Its format is simple enough to make here: the bytes of a chunk
shuffled, so that those of equal weight lie together, then deflated.
"""

import os
import zlib
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray


def chunk_options(shape: tuple[int, ...], level: int | None) -> dict[str, Any]:
    """Give how h5py shall store a stack of images: one chunk an image, compressed or not.

    Args:
        shape: Of the stack, (n, rows, columns).
        level: How much it is compressed, 1 to 9; None: not at all.
    """
    chunks = {"chunks": (1, *shape[1:])}
    if level is None:
        return chunks
    return {**chunks, "shuffle": True, "compression": "gzip", "compression_opts": level}


def fill_stack(stack: h5py.Dataset, images: Iterable[NDArray[Any]]) -> Iterator[int]:
    """Write all images of a stack; as many are in memory as there are processors.

    Args:
        stack: Compressed as ``chunk_options`` says, or not at all.
        images: All of them, in order, each of shape (rows, columns).

    Yields:
        How many are written.
    """
    remaining, n_done = iter(images), 0
    level = stack.compression_opts

    def compressed(image: NDArray[Any]) -> bytes:
        return zlib.compress(_shuffled(np.ascontiguousarray(image, stack.dtype)), level)

    with ThreadPoolExecutor() as pool:
        while group := list(islice(remaining, os.cpu_count() or 1)):
            if level is None:
                stack[n_done : n_done + len(group)] = group
            else:
                for row, chunk in enumerate(pool.map(compressed, group), start=n_done):
                    stack.id.write_direct_chunk((row, 0, 0), chunk)
            n_done += len(group)
            yield n_done


def _shuffled(image: NDArray[Any]) -> bytes:
    """Give the first bytes of all elements, then the second ones, and so on."""
    return image.reshape(-1).view(np.uint8).reshape(-1, image.itemsize).T.tobytes()
