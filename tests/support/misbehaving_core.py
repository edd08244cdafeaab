"""A navigation core that misbehaves in one of many ways: ``misbehaving_core.py WAY``.

Written from docs/reference/core_protocol.md with nothing but the standard library. On every tenth
frame it does what its way says, on the others it answers one and the same pose. Noise is answered
to every frame.
"""

import ctypes
import json
import math
import os
import random
import struct
import sys
import time
from collections.abc import Callable

Json = dict[str, object]
EVERY = 10
LATE_S = 0.85
"""How long it takes for a late answer, in seconds; the limit in the tests is shorter."""
SANE: Json = {
    "status": "ok",
    "pose": {
        "parent": "trs",
        "child": "cam",
        "position_m": [0.0, 0.0, 2.0],
        "quaternion_xyzw": [math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0],
    },
}


def receive() -> Json:
    magic, n_header, n_payload = struct.unpack("<4sIQ", sys.stdin.buffer.read(16))
    if magic != b"TLC1":
        raise ValueError(magic)
    header = json.loads(sys.stdin.buffer.read(n_header))
    sys.stdin.buffer.read(n_payload)
    return header


def send(header: Json) -> None:
    text = json.dumps(header).encode()
    sys.stdout.buffer.write(struct.pack("<4sIQ", b"TLC1", len(text), 0) + text)
    sys.stdout.buffer.flush()


def sane_pose(**changed: object) -> Json:
    return SANE | {"pose": dict(SANE["pose"]) | changed}  # type: ignore[call-overload]


def crash() -> Json:
    print("pose.c:42: assertion failed", file=sys.stderr, flush=True)
    os.abort()


def segfault() -> Json:
    ctypes.string_at(0)
    return SANE


def leave() -> Json:
    sys.exit(3)


def hang() -> Json:
    while True:
        time.sleep(60)


def late() -> Json:
    time.sleep(LATE_S)
    return SANE


def chat() -> Json:
    print("Loading model...", flush=True)
    return SANE


def noise() -> Json:
    quaternion = [random.gauss(0, 1) for _ in range(4)]
    norm = math.hypot(*quaternion)
    position_m = [random.gauss(0, 50) for _ in range(3)]
    return sane_pose(position_m=position_m, quaternion_xyzw=[q / norm for q in quaternion])


def nan() -> Json:
    return sane_pose(position_m=[0.0, math.nan, 2.0])


def wrong_frame() -> Json:
    return sane_pose(parent="cam", child="trs")


def wrong_number() -> Json:
    return SANE | {"number": 8}


WAYS: dict[str, Callable[[], Json]] = {
    "crash": crash,
    "segfault": segfault,
    "leave": leave,
    "hang": hang,
    "late": late,
    "chat": chat,
    "noise": noise,
    "nan": nan,
    "wrong-frame": wrong_frame,
    "wrong-number": wrong_number,
}


def main() -> None:
    misbehave = WAYS[sys.argv[1]]
    random.seed(1)
    receive()
    send({"type": "hello", "protocol": 1, "name": sys.argv[1], "version": "1"})
    while (message := receive())["type"] != "bye":
        if message["type"] == "setup":
            send({"type": "ready"})
        elif message["type"] == "frame":
            number = int(str(message["number"]))
            is_due = misbehave is noise or number % EVERY == EVERY - 1
            answer = misbehave() if is_due else SANE
            send({"type": "result", "number": number} | answer)


if __name__ == "__main__":
    main()
