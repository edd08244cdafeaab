"""Values and arrays as bytes: what is kept on disk, and what worker processes answer.

Every bit survives. Pickle would not do: it normalises the rotation of a pose again, and a file that
was tampered with would run code.

Layout: ``TLP1``, CRC-32 of what follows, length of the header (both uint32, little endian), header
(JSON: values and the arrays' names, types and shapes), then the arrays, one after the other.
"""

import json
import struct
import zlib
from collections.abc import Mapping
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.nav.core import NavigationResult, Status

_MAGIC = b"TLP1"
_PREFIX = struct.Struct("<4sII")
_NUMBERS = (
    "n_features",
    "n_matches",
    "n_inliers",
    "time_detect_s",
    "time_match_s",
    "time_pose_s",
)
_TEXTS = ("status", "reason", "database")
_ARRAYS = ("covariance", "bound", "uv_inliers", "landmark_inliers")


class PackingError(Exception):
    """The bytes are not what was packed."""


def pack(values: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Give values, as JSON has them, and arrays of numbers as bytes."""
    rows = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    described = [[name, row.dtype.str, list(np.shape(arrays[name]))] for name, row in rows.items()]
    header = json.dumps({"values": dict(values), "arrays": described}).encode()
    body = b"".join([header, *(row.tobytes() for row in rows.values())])
    return _PREFIX.pack(_MAGIC, zlib.crc32(body), len(header)) + body


def unpack(packed: bytes | bytearray) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Give back what was packed; the arrays may be written to, and are parts of a bytearray given.

    Raises:
        PackingError: The bytes were cut short or changed.
    """
    try:
        magic, crc32, n_header = _PREFIX.unpack_from(packed)
        owned = packed if isinstance(packed, bytearray) else bytearray(packed)
        body = memoryview(owned)[_PREFIX.size :]
        if magic != _MAGIC or zlib.crc32(body) != crc32:
            raise PackingError("the checksum does not match")
        header = json.loads(bytes(body[:n_header]))
        return header["values"], _arrays(header["arrays"], body[n_header:])
    except (struct.error, ValueError, TypeError, KeyError) as error:
        raise PackingError(f"not what was packed: {error}") from error


def pack_result(result: NavigationResult) -> bytes:
    """Give the answer of a core as bytes."""
    values = {name: getattr(result, name) for name in _TEXTS}
    values |= {name: int(getattr(result, name)) for name in _NUMBERS if name.startswith("n_")}
    values |= {name: float(getattr(result, name)) for name in _NUMBERS if name.startswith("time_")}
    arrays = {
        name: np.asarray(getattr(result, name))
        for name in _ARRAYS
        if getattr(result, name) is not None
    }
    if result.trs_from_cam is not None:
        arrays["trs_from_cam"] = result.trs_from_cam.as_matrix()
    return pack(values, arrays)


def unpack_result(packed: bytes) -> NavigationResult:
    """Give back the answer of a core, bit for bit.

    Raises:
        PackingError: The bytes were cut short or changed.
    """
    values, arrays = unpack(packed)
    try:
        matrix = arrays.get("trs_from_cam")
        return NavigationResult(
            status=cast("Status", values["status"]),
            # Not normalised again: it was, and another time would change the last bits.
            trs_from_cam=None if matrix is None else RigidTransform(matrix, normalize=False),
            covariance=arrays.get("covariance"),
            bound=arrays.get("bound"),
            uv_inliers=arrays["uv_inliers"],
            landmark_inliers=arrays["landmark_inliers"],
            database=values["database"],
            reason=values["reason"],
            **{name: values[name] for name in _NUMBERS},
        )
    except (KeyError, ValueError) as error:
        raise PackingError(f"not the answer of a core: {error}") from error


def _arrays(described: list[Any], data: memoryview) -> dict[str, NDArray[Any]]:
    arrays: dict[str, NDArray[Any]] = {}
    start = 0
    for name, dtype, shape in described:
        kind = np.dtype(dtype)
        n = int(np.prod(shape, dtype=np.int64))
        arrays[name] = np.frombuffer(data, kind, n, start).reshape(shape)
        start += n * kind.itemsize
    if start != len(data):
        raise PackingError(f"{len(data)} bytes of arrays, expected {start}")
    return arrays
