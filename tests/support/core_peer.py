"""The other side of a core's conversation, written from docs/reference/core_protocol.md alone.

It shares nothing with tronlab.nav.foreign: cores that get on with both follow the text.
"""

import json
import socket
import struct
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.dataset.records import ReferenceView
from tronlab.geometry.camera import CameraModel

Arrays = Mapping[str, NDArray[Any]]
NO_ARRAYS: Arrays = {}
NO_SETTINGS: Mapping[str, object] = {}


def message(
    header: Mapping[str, object], arrays: Arrays = NO_ARRAYS, shared: Sequence[object] = ()
) -> bytes:
    """Give a message as bytes; ``shared``: parts that are in shared memory."""
    payload, parts = b"", list(shared)
    for name, array in arrays.items():
        payload += bytes(-len(payload) % 8)
        parts.append(part(name, array, len(payload), "payload"))
        payload += array.tobytes()
    text = json.dumps({**header, "parts": parts} if parts else header).encode()
    return b"TLC1" + struct.pack("<IQ", len(text), len(payload)) + text + payload


def part(name: str, array: NDArray[Any], offset: int, where: str) -> dict[str, object]:
    dtype = f"{array.dtype.kind}{array.dtype.itemsize}"
    shape = list(array.shape)
    return {"name": name, "dtype": dtype, "shape": shape, "offset": offset, "where": where}


def pose_of(trs_from_cam: RigidTransform) -> dict[str, object]:
    return {
        "parent": "trs",
        "child": "cam",
        "position_m": trs_from_cam.translation.tolist(),
        "quaternion_xyzw": trs_from_cam.rotation.as_quat().tolist(),
    }


def hello(settings: Mapping[str, object] = NO_SETTINGS, seed: int = 0) -> bytes:
    return message({"type": "hello", "protocol": 1, "settings": settings, "seed": seed})


def setup(
    camera: CameraModel,
    references: Sequence[ReferenceView],
    shared_memory: Mapping[str, object] | None = None,
) -> bytes:
    """Give ``setup`` and the references behind it."""
    header: dict[str, object] = {
        "type": "setup",
        "camera": camera.to_dict(),
        "n_references": len(references),
        "shared_memory": shared_memory,
    }
    return message(header) + b"".join(
        message(
            {"type": "reference", "index": i, "pose": pose_of(view.trs_from_cam)},
            {"image": view.image, "depth_m": view.depth_m, "mask": view.mask.view(np.uint8)},
        )
        for i, view in enumerate(references)
    )


def frame(
    number: int,
    image: NDArray[Any],
    mask: NDArray[np.bool_],
    *,
    time_s: float | None = None,
    prior: tuple[RigidTransform, NDArray[np.float64]] | None = None,
) -> bytes:
    offered = prior and {"pose": pose_of(prior[0]), "covariance": prior[1].ravel().tolist()}
    header = {"type": "frame", "number": number, "time_s": time_s, "prior": offered}
    return message(header, {"image": image, "mask": mask.view(np.uint8)})


BYE = message({"type": "bye"})
RESET = message({"type": "reset"})


class Peer:
    """Talks with a program over its pipes, or with a socket."""

    def __init__(self, *command: str | Path, address: tuple[str, int] | None = None) -> None:
        self._process = self._socket = None
        if address:
            self._socket = socket.create_connection(address, timeout=20)
            self._out = self._in = self._socket.makefile("rwb")
        else:
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
            )
            assert self._process.stdin is not None
            assert self._process.stdout is not None
            self._out, self._in = self._process.stdin, self._process.stdout

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._socket:
            self._in.close()
            self._socket.close()
        elif self._process and self._process.returncode is None:
            self._process.kill()
            self._process.communicate()

    def send(self, data: bytes) -> None:
        self._out.write(data)
        self._out.flush()

    def ask(self, data: bytes) -> tuple[dict[str, Any], bytes]:
        """Send, and give header and payload of the one answer."""
        self.send(data)
        start = self._in.read(16)
        assert start[:4] == b"TLC1", start
        n_header, n_payload = struct.unpack("<IQ", start[4:])
        return json.loads(self._in.read(n_header)), self._in.read(n_payload)

    def end(self, data: bytes = BYE) -> tuple[int, str]:
        """Send the last bytes of a program's input; give its exit code and what it complained."""
        assert self._process is not None
        output, complaints = self._process.communicate(data, timeout=20)
        assert output == b""
        return self._process.returncode, complaints.decode()
