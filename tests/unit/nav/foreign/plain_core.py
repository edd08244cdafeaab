"""A core written from the protocol's specification, with nothing of tronlab; misbehaves on demand.

    plain_core.py [--shared] [--sequential] [WHEN=WHAT]...

WHEN is a frame's number, ``start``, ``hello`` or ``setup``; WHAT is a function below.
It answers where it "is": (sum of the image's bytes, sum of the mask's, number of references).
"""

import json  # the others where they are used: it is started a hundred times
import mmap
import os
import signal
import struct
import sys
import time

FLAGS = {text for text in sys.argv[1:] if text.startswith("--")}
WHAT = dict(text.split("=", 1) for text in sys.argv[1:] if "=" in text)
OUT = 1
memory: mmap.mmap | None = None
n_since_reset = 0


def receive() -> tuple[dict, bytes]:
    prefix = sys.stdin.buffer.read(16)
    if len(prefix) < 16:
        sys.exit(0)
    magic, n_header, n_payload = struct.unpack("<4sIQ", prefix)
    assert magic == b"TLC1"
    return json.loads(sys.stdin.buffer.read(n_header)), sys.stdin.buffer.read(n_payload)


def encoded(header: dict, payload: bytes = b"") -> bytes:
    text = json.dumps(header).encode()
    return struct.pack("<4sIQ", b"TLC1", len(text), len(payload)) + text + payload


def write(data: bytes) -> None:
    while data:
        data = data[os.write(OUT, data) :]


def part_sum(header: dict, payload: bytes, name: str) -> int:
    (part,) = (part for part in header["parts"] if part["name"] == name)
    size = {"u1": 1, "u2": 2}[part["dtype"]]
    for n in part["shape"]:
        size *= n
    source = payload if part["where"] == "payload" else memory
    return sum(source[part["offset"] : part["offset"] + size])


def answer_to(header: dict, payload: bytes, n_references: int) -> dict:
    sums = [part_sum(header, payload, name) for name in ("image", "mask")]
    return {
        "type": "result",
        "number": header["number"],
        "status": "ok",
        "pose": {
            "parent": "trs",
            "child": "cam",
            "position_m": [*sums, n_references],
            "quaternion_xyzw": [0, 0, 0, 1],
        },
        "reason": json.dumps({**header, "since_reset": n_since_reset, "pid": os.getpid()}),
        "unheard of": None,
    }


def segfault(*_: object) -> None:
    import resource

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    os.kill(os.getpid(), signal.SIGSEGV)


def exit3(*_: object) -> None:
    print("first line\nout of fuel\n", file=sys.stderr)
    sys.exit(3)


def stop(*_: object) -> None:
    os.kill(os.getpid(), signal.SIGSTOP)


def with_child(answer: dict) -> dict:
    import subprocess

    child = subprocess.Popen(["sleep", "1000"])
    return {**answer, "reason": str(child.pid)}


def late(answer: dict) -> dict:
    time.sleep(0.45)
    return answer


def loud(answer: dict) -> dict:
    for _ in range(300):
        print("x" * 1000, file=sys.stderr)
    return answer


def printing(answer: dict) -> dict:
    write(b"Loading model...\n")
    return answer


def answer_and_exit(answer: dict) -> None:
    write(encoded(answer))
    sys.exit(4)


def noise(*_: object) -> None:
    write(bytes(range(200, 256)) * 9)


def half(answer: dict) -> None:
    write(encoded(answer)[:100])


def half_and_exit(answer: dict) -> None:
    write(encoded(answer)[:100])
    sys.exit(0)


def crumbs(answer: dict) -> None:
    for byte in encoded(answer):
        write(bytes([byte]))
        time.sleep(0.02)


def closed(*_: object) -> None:
    os.close(OUT)


def deaf(answer: dict) -> None:
    """Answer, and do not read what comes next."""
    write(encoded(answer))
    time.sleep(1000)


def endless(*_: object) -> None:
    write(struct.pack("<4sIQ", b"TLC1", 10, 1 << 62))


def long_header(*_: object) -> None:
    write(struct.pack("<4sIQ", b"TLC1", (1 << 32) - 1, 0))


def no_json(*_: object) -> None:
    write(struct.pack("<4sIQ", b"TLC1", 9, 0) + b"{'a': nan")


def twice(answer: dict) -> None:
    write(encoded(answer) * 2)
    time.sleep(0.05)


def other_number(answer: dict) -> dict:
    return {**answer, "number": answer["number"] + 1}


def other_type(answer: dict) -> dict:
    return {**answer, "type": "ready"}


def not_a_number(answer: dict) -> dict:
    answer["pose"]["position_m"] = [0.0, float("nan"), 1.0]
    return answer


def other_frames(answer: dict) -> dict:
    answer["pose"].update(parent="cam", child="trs")
    return answer


def long_quaternion(answer: dict) -> dict:
    answer["pose"]["quaternion_xyzw"] = [0, 0, 0.1, 1]
    return answer


def parts_beyond(answer: dict) -> dict:
    part = {"name": "uv_inliers", "dtype": "f8", "shape": [10, 2], "offset": 0}
    return {**answer, "parts": [part]}


def covariance(answer: dict) -> dict:
    return {**answer, "covariance": [-1.0, *[0.0] * 35]}


def fail(answer: dict) -> dict:
    return {"type": "failed", "reason": "not with this lens"}


def protocol2(answer: dict) -> dict:
    return {**answer, "protocol": 2}


def respond(when: str, answer: dict | None) -> None:
    what = WHAT.get(when)
    changed = globals()[what](answer) if what else answer
    if changed is not None:
        write(encoded(changed))


def main() -> None:
    global memory, n_since_reset  # noqa: PLW0603  # a program of one file
    respond("start", None)
    hello, _ = receive()
    assert (hello["type"], hello["protocol"]) == ("hello", 1)
    greeting = {
        "type": "hello",
        "protocol": 1,
        "name": "plain",
        "version": "7",
        "sequential": "--sequential" in FLAGS,
        "references": "--references" in FLAGS,
        "shared_memory": "--shared" in FLAGS,
    }
    respond("hello", greeting)
    setup, _ = receive()
    if setup["type"] == "bye":
        return
    references = [receive()[0] for _ in range(setup["n_references"])]
    if setup["shared_memory"]:
        with open(setup["shared_memory"]["path"], "rb") as file:
            size = setup["shared_memory"]["size"]
            memory = mmap.mmap(file.fileno(), size, prot=mmap.PROT_READ)
    respond("setup", {"type": "ready"})
    while True:
        header, payload = receive()
        if header["type"] == "bye":
            return
        if header["type"] == "reset":
            n_since_reset = 0
            continue
        answer = answer_to(header, payload, len(references))
        n_since_reset += 1
        respond(str(header["number"]), answer)


main()
