"""Sending frames: paces packets, holds the last frames for resend, and has the stream's faults."""

import queue
import socket
import struct
import sys
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from drivers.gige.simulator.acquisition import ReadOut
from drivers.gige.simulator.gvsp import (
    Block,
    garbage,
    resent,
    test_packet,
    unavailable,
)
from drivers.gige.simulator.registers import Route
from tronlab.errors import TronlabError
from tronlab.twin.state import Faults

N_HELD: Final = 16
"""Frames held for resend."""

_LOSS: Final = 0.01
_LOSS_SEED: Final = 1380
_REFUSED_EVERY: Final = 7
_MOST_UNAVAILABLE: Final = 256
"""Most packets refused by name for a frame that is not held: its size is not known any more."""
_N_QUEUED: Final = 2
_BATCH_BYTES: Final = 60_000
_MOST_SEGMENTS: Final = 64
_SHORTEST_SLEEP_S: Final = 0.0003
_LONGEST_SLEEP_S: Final = 0.05
_POLL_S: Final = 0.2

# Linux, <netinet/in.h> and <linux/udp.h>; the module socket does not have all of them.
_IP_MTU_DISCOVER: Final = 10
_MAY_FRAGMENT: Final = 0
_MUST_NOT_FRAGMENT: Final = 2
_UDP_SEGMENT: Final = 103


@dataclass
class Statistics:
    """What was sent and what was not, since the camera started."""

    n_frames: int = 0
    n_packets_lost: int = 0
    """Left out on purpose."""
    n_packets_resent: int = 0
    n_packets_unavailable: int = 0


@dataclass(frozen=True)
class _Mischief:
    """What goes wrong with one frame."""

    lost: frozenset[int] = field(default_factory=frozenset[int])
    refused: frozenset[int] = field(default_factory=frozenset[int])
    has_garbage: bool = False


@dataclass(frozen=True)
class _Held:
    """A frame held for resend."""

    block: Block
    refused: frozenset[int]

    def has(self, packet_id: int) -> bool:
        return packet_id <= self.block.last_id and packet_id not in self.refused


class Transmitter:
    """Sends frames in a thread of its own; resends at once, in the caller's."""

    def __init__(
        self,
        endpoint: socket.socket,
        *,
        route: Callable[[], Route | None],
        faults: Faults,
        uses_segmentation_offload: bool,
    ) -> None:
        """Make it ready.

        Args:
            endpoint: UDP socket that sends.
            route: Gives where the stream goes at this moment.
            faults: What goes wrong.
            uses_segmentation_offload: Let Linux cut packets (UDP_SEGMENT): several times faster,
                but a receiver that looks at raw packets on loopback sees them uncut.
        """
        self.statistics = Statistics()
        self._socket = endpoint
        self._route = route
        self._faults = faults
        self._offloads = uses_segmentation_offload
        self._rng = np.random.default_rng(_LOSS_SEED)
        self._held: OrderedDict[int, _Held] = OrderedDict()
        self._lock = threading.Lock()
        self._sending = threading.Lock()
        self._frames: queue.Queue[ReadOut | None] = queue.Queue(_N_QUEUED)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._work, name="camera stream", daemon=True)
        self._thread.start()

    def send(self, frame: ReadOut) -> None:
        """Send a frame when it has been read out; wait while the queue is full."""
        while not self._closing.is_set():
            with suppress(queue.Full):
                self._frames.put(frame, timeout=_POLL_S)
                return

    def settle(self) -> None:
        """Wait until nothing is being sent of a frame that is not wanted any more."""
        with self._sending:
            pass

    def forget(self) -> None:
        """Forget the frames held for resend."""
        with self._lock:
            self._held.clear()

    def resend(self, block_id: int, first_id: int, last_id: int) -> None:
        """Send packets of a held frame again; say which ones are not held any more."""
        route = self._route()
        if route is None or last_id < first_id:
            return
        with self._lock:
            held = self._held.get(block_id)
        if held is None:
            last_id = min(last_id, first_id + _MOST_UNAVAILABLE - 1)
        else:
            last_id = max(first_id, min(last_id, held.block.last_id))
        for packet_id in range(first_id, last_id + 1):
            self._resend_one(held, block_id, packet_id, route)

    def fire_test_packet(self) -> None:
        """Send a packet of the stream's size that must not be cut on its way."""
        if (route := self._route()) is not None:
            self._forbid_fragments(is_forbidden=True)
            self._send(test_packet(route.packet_bytes), route)

    def close(self) -> None:
        """Stop sending."""
        self._closing.set()
        with suppress(queue.Full):  # a full queue wakes the thread as well
            self._frames.put_nowait(None)
        self._thread.join()

    def _work(self) -> None:
        while (frame := self._frames.get()) is not None:
            if self._closing.wait(max(0.0, frame.ready_s - time.perf_counter())):
                return
            with self._sending:
                if frame.is_wanted() and (route := self._route()) is not None:
                    self._send_frame(frame, route)

    def _send_frame(self, frame: ReadOut, route: Route) -> None:
        block = Block(frame.frame, packet_bytes=route.packet_bytes)
        mischief = self._mischief(block)
        if mischief is None:
            return
        self._hold(block, mischief)
        self._forbid_fragments(is_forbidden=not route.may_fragment)
        self._send(block.packet(0), route)
        pacer = _Pacer(route, lambda: frame.is_wanted() and not self._closing.is_set())
        for batch in _batches(block):
            self._send_batch(block, batch, mischief, route)
            if not pacer.wait(len(batch) * route.packet_bytes, len(batch)):
                return
        self._send(block.packet(block.last_id), route)
        self.statistics.n_frames += 1
        self.statistics.n_packets_lost += len(mischief.lost)

    def _hold(self, block: Block, mischief: _Mischief) -> None:
        with self._lock:
            self._held[block.block_id] = _Held(block, mischief.refused)
            self._held.move_to_end(block.block_id)
            while len(self._held) > N_HELD:
                self._held.popitem(last=False)

    def _mischief(self, block: Block) -> _Mischief | None:
        """Look what goes wrong with a frame; None: it is lost altogether."""
        try:
            return self._armed_mischief(block)
        except TronlabError:
            return None  # the simulated laboratory has ended, and with it the camera

    def _armed_mischief(self, block: Block) -> _Mischief | None:
        if self._faults.is_armed("camera.gone") or self._faults.strike("camera.lose_frame"):
            return None
        ids = np.arange(1, block.last_id)
        if self._faults.strike("camera.incomplete"):
            refused = frozenset(ids[::_REFUSED_EVERY].tolist())
            return _Mischief(lost=refused, refused=refused)
        lost: frozenset[int] = frozenset()
        if self._faults.is_armed("camera.lose_packets"):
            lost = frozenset(ids[self._rng.random(ids.size) < _LOSS].tolist())
        return _Mischief(lost=lost, has_garbage=self._faults.is_armed("camera.bad_packets"))

    def _send_batch(
        self, block: Block, packet_ids: range, mischief: _Mischief, route: Route
    ) -> None:
        if self._offloads and not mischief.lost and not mischief.has_garbage:
            packets = block.payload_packets(packet_ids.start, len(packet_ids))
            self._send_segmented(packets, block.udp_bytes, route)
        else:
            self._send_one_by_one(block, packet_ids, mischief, route)

    def _send_one_by_one(
        self, block: Block, packet_ids: range, mischief: _Mischief, route: Route
    ) -> None:
        address, lost = (route.host, route.port), mischief.lost
        with suppress(OSError):
            for packet_id in packet_ids:
                if packet_id not in lost:
                    self._socket.sendto(block.payload_packets(packet_id, 1), address)
        if mischief.has_garbage:
            for packet in garbage(block.block_id):
                self._send(packet, route)

    def _send_segmented(self, packets: memoryview, udp_bytes: int, route: Route) -> None:
        size = [(socket.IPPROTO_UDP, _UDP_SEGMENT, struct.pack("=H", udp_bytes))]
        with suppress(OSError):
            self._socket.sendmsg([packets], size, 0, (route.host, route.port))

    def _send(self, packet: bytes | memoryview, route: Route) -> None:
        with suppress(OSError):  # as on a cable, nobody tells that a packet got lost
            self._socket.sendto(packet, (route.host, route.port))

    def _resend_one(self, held: _Held | None, block_id: int, packet_id: int, route: Route) -> None:
        if held is not None and held.has(packet_id):
            self.statistics.n_packets_resent += 1
            self._send(resent(held.block.packet(packet_id)), route)
        else:
            self.statistics.n_packets_unavailable += 1
            self._send(unavailable(block_id, packet_id), route)

    def _forbid_fragments(self, *, is_forbidden: bool) -> None:
        if sys.platform == "linux":
            value = _MUST_NOT_FRAGMENT if is_forbidden else _MAY_FRAGMENT
            self._socket.setsockopt(socket.IPPROTO_IP, _IP_MTU_DISCOVER, value)


def _batches(block: Block) -> Iterator[range]:
    """Give the ids of the payload packets, as many at once as may be sent without a pause."""
    n = max(1, min(_BATCH_BYTES // block.udp_bytes, _MOST_SEGMENTS))
    for first_id in range(1, block.last_id, n):
        yield range(first_id, min(first_id + n, block.last_id))


class _Pacer:
    """Keeps the packets of a frame from being sent faster than the route allows."""

    def __init__(self, route: Route, goes_on: Callable[[], bool]) -> None:
        self._route = route
        self._goes_on = goes_on
        self._due_s = time.perf_counter()

    def wait(self, n_bytes: int, n_packets: int) -> bool:
        """Wait after so much has been sent; tell whether to go on."""
        self._due_s += n_bytes / self._route.bytes_per_second
        self._due_s += n_packets * self._route.packet_delay_s
        while self._goes_on():
            ahead_s = self._due_s - time.perf_counter()
            if ahead_s < _SHORTEST_SLEEP_S:
                return True
            time.sleep(min(ahead_s, _LONGEST_SLEEP_S))
        return False
