"""No wait is longer than allowed, whatever the other side does with its end."""

import os
import threading
from collections.abc import Generator
from contextlib import suppress
from time import monotonic, sleep

import numpy as np
import pytest

from tronlab.nav.foreign.channel import FOREVER, Channel, Ends, GoneError, LateError
from tronlab.nav.foreign.messages import MessageError, StrayBytesError, encode


@pytest.fixture
def pipes() -> Generator[tuple[int, int, int, int]]:
    """(our reading, their writing, their reading, our writing) ends of two pipes."""
    ends = (*os.pipe(), *os.pipe())
    yield ends
    for end in ends:
        with suppress(OSError):  # closed by the test
            os.close(end)


def soon(s: float = 0.1) -> float:
    return monotonic() + s


def whole(number: int, size: int = 0) -> bytes:
    return b"".join(encode({"type": "result", "number": number}, {"a": np.zeros(size, "u1")}))


def test_messages_come_one_by_one_however_the_bytes_arrive(pipes: tuple[int, ...]) -> None:
    channel = Channel(Ends(pipes[0], pipes[3]))
    data = whole(1, 70_000) + whole(2) + whole(3, 5)

    def write() -> None:
        for i in range(0, len(data), 9973):
            os.write(pipes[1], data[i : i + 9973])

    writer = threading.Thread(target=write)
    writer.start()
    numbers = [channel.receive(soon(20.0)).header["number"] for _ in range(3)]
    writer.join()
    assert numbers == [1, 2, 3]
    assert channel.unread() == b""


def test_a_message_larger_than_the_pipe_passes_while_the_other_side_talks(
    pipes: tuple[int, ...],
) -> None:
    """Both sides write at once; neither stands still."""
    ours, theirs = Channel(Ends(pipes[0], pipes[3])), Channel(Ends(pipes[2], pipes[1]))
    image = encode({"type": "frame"}, {"image": np.ones(400_000, np.uint8)})
    seen: list[object] = []

    def talk() -> None:
        theirs.send(encode({"type": "talk"}, {"words": np.zeros(30_000, np.uint8)}), FOREVER)
        seen.append(theirs.receive(FOREVER).arrays()["image"].sum())

    other = threading.Thread(target=talk)
    other.start()
    ours.send(image, soon(20.0))
    assert ours.receive(soon(20.0)).kind == "talk"
    other.join()
    assert seen == [400_000]


def test_silence_crumbs_and_deafness_end_at_the_deadline(pipes: tuple[int, ...]) -> None:
    channel = Channel(Ends(pipes[0], pipes[3]))
    with pytest.raises(LateError, match="is silent"):
        channel.receive(soon(0.02))
    is_over = threading.Event()

    def crumble() -> None:
        for byte in whole(1, 1000):
            if is_over.wait(0.002):
                return
            os.write(pipes[1], bytes([byte]))

    crumbler = threading.Thread(target=crumble)
    crumbler.start()
    with pytest.raises(LateError, match=r"sent \d+ of \d+ bytes"):
        channel.receive(soon(0.05))
    is_over.set()
    crumbler.join()
    with pytest.raises(LateError, match="did not read"):
        channel.send(encode({"type": "frame"}, {"image": np.zeros(300_000, "u1")}), soon(0.02))


def test_what_is_no_message_is_seen_at_its_first_byte(pipes: tuple[int, ...]) -> None:
    channel = Channel(Ends(pipes[0], pipes[3]))
    os.write(pipes[1], b"Hi\n")  # the thirteen bytes that are missing never come
    with pytest.raises(StrayBytesError, match='wrote "Hi"'):
        channel.receive(soon(20.0))


def test_a_flood_that_nobody_asked_for_is_not_collected(pipes: tuple[int, ...]) -> None:
    channel = Channel(Ends(pipes[0], pipes[3]))
    is_over = False

    def flood() -> None:
        while not is_over:
            try:
                os.write(pipes[1], b"x" * 4096)
            except BrokenPipeError:
                return

    flooder = threading.Thread(target=flood)
    flooder.start()
    try:
        with pytest.raises(LateError, match="did not read"):
            channel.send(encode({"type": "frame"}, {"image": np.zeros(300_000, "u1")}), soon(0.05))
        assert len(channel.unread()) <= (1 << 16) + (1 << 20)
    finally:
        is_over = True
        os.close(pipes[0])
        flooder.join()


def test_an_end_is_said_with_what_was_there(pipes: tuple[int, ...]) -> None:
    channel = Channel(Ends(pipes[0], pipes[3]))
    os.write(pipes[1], whole(1)[:21])
    os.close(pipes[1])
    with pytest.raises(GoneError, match="in the middle of a message, after 21 bytes"):
        channel.receive(soon(20.0))
    os.close(pipes[2])
    with pytest.raises(GoneError, match="reads no more messages"):
        channel.send(encode({"type": "bye"}), soon(20.0))


def test_announced_lengths_cost_no_memory(pipes: tuple[int, ...]) -> None:
    channel = Channel(Ends(pipes[0], pipes[3]), max_payload=1 << 40)
    os.write(pipes[1], b"TLC1" + (13).to_bytes(4, "little") + (1 << 40).to_bytes(8, "little"))
    os.write(pipes[1], b'{"type": "x"}')
    sleep(0.01)
    with pytest.raises(LateError, match="sent 29 of 1099511627805 bytes"):
        channel.receive(soon(0.05))
    strict = Channel(Ends(pipes[0], pipes[3]), max_payload=100)
    os.write(pipes[1], whole(1, 101))
    with pytest.raises(MessageError, match="announced a payload of 101 bytes"):
        strict.receive(soon(20.0))
