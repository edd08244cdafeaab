"""A rig's simulators on the wire, each in a process of its own, over one simulated laboratory."""

import json
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import IO

from tronlab.errors import DeviceError, DeviceTimeoutError, ProtocolError

START_TIMEOUT_S = 300.0
"""The camera makes its terrain before it answers."""
_END_TIMEOUT_S = 5.0
_LAST_ADDRESS_S = 0.3
"""So long after a simulator's last address there comes no other."""
_LOOK_S = 0.1


@dataclass(frozen=True, slots=True)
class Address:
    """Where a simulated device can be reached."""

    device: str
    host: str
    port: int | str
    """Of a serial device: its path."""

    def __str__(self) -> str:
        """Give HOST:PORT, or the path."""
        return self.port if isinstance(self.port, str) else f"{self.host}:{self.port}"


class Simulator:
    """One simulator in its process; its messages go to stderr."""

    def __init__(self, kind: str, module: str, arguments: Sequence[str]) -> None:
        self.kind = kind
        # A session of its own: Ctrl-C reaches the fleet alone, which ends its simulators in order.
        self._process = subprocess.Popen(  # noqa: S603  # our own module
            [sys.executable, "-m", module, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            start_new_session=True,
        )
        self._lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        assert self._process.stdout is not None  # noqa: S101  # asked for above
        self._reader = threading.Thread(
            target=self._read, args=(self._process.stdout,), daemon=True
        )
        self._reader.start()

    def wait_until_ready(self, timeout_s: float) -> tuple[Address, ...]:
        """Give its addresses.

        Raises:
            DeviceTimeoutError: It named none in time.
            DeviceError: It ended instead.
            ProtocolError: It printed something else.
        """
        give_up_s = time.monotonic() + timeout_s
        addresses: list[Address] = []
        while True:
            try:
                line = self._lines.get(timeout=_LAST_ADDRESS_S if addresses else _LOOK_S)
            except queue.Empty:
                if addresses:
                    return tuple(addresses)
                self.check_alive()
                if time.monotonic() > give_up_s:
                    raise DeviceTimeoutError(
                        f"the simulator is not ready after {timeout_s:g} s", device=self.kind
                    ) from None
            else:
                addresses.append(self._address(line))

    def check_alive(self) -> None:
        """Return if it still runs.

        Raises:
            DeviceError: It has ended.
        """
        code = self._process.poll()
        if code is not None:
            raise DeviceError(
                f"the simulator has ended with exit code {code}; it says why above",
                device=self.kind,
            )

    def ask_to_end(self) -> None:
        """Ask it to end, and do not wait."""
        self._process.terminate()

    def close(self) -> None:
        """End it."""
        self.ask_to_end()
        try:
            self._process.wait(_END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._reader.join()
        if self._process.stdout is not None:
            self._process.stdout.close()

    def _read(self, lines: IO[bytes]) -> None:
        for line in lines:
            self._lines.put(line)

    def _address(self, line: bytes) -> Address:
        try:
            return Address(**json.loads(line))
        except (ValueError, TypeError):
            raise ProtocolError(
                "the simulator printed no address", device=self.kind, sent=b"", received=line
            ) from None


class Fleet:
    """The simulators of a rig, until closed; all of them run, or none."""

    def __init__(
        self,
        modules: Mapping[str, str],
        *,
        rig_path: Path,
        world: tuple[str, int],
        seed: int = 0,
        session: str = "run",
        more_arguments: Mapping[str, Sequence[str]] = MappingProxyType({}),
        announce: Callable[[str], None] = lambda text: None,
    ) -> None:
        """Start them and wait until all are ready.

        Args:
            modules: Module of each simulator, by kind of device.
            rig_path: Rig file they read.
            world: Host and port of the state they share.
            seed: Of measurement noise.
            session: What they run for; see ``DeviceContext``.
            more_arguments: Of the command line, by kind of device.
            announce: Told of each that is started.

        Raises:
            DeviceError: One of them did not get ready.
        """
        host, port = world
        arguments = (
            "--rig", str(rig_path), "--world", f"{host}:{port}",
            "--seed", str(seed), "--session", session,
        )  # fmt: skip
        self._stack = ExitStack()
        self.simulators: list[Simulator] = []
        self.addresses: list[Address] = []
        with self._stack:
            for kind, module in modules.items():
                announce(f"{kind}: python -m {module}")
                more = more_arguments.get(kind, ())
                simulator = Simulator(kind, module, (*arguments, *more))
                self._stack.callback(simulator.close)
                self.simulators.append(simulator)
            self._stack.callback(self._ask_all_to_end)
            for simulator in self.simulators:
                self.addresses.extend(simulator.wait_until_ready(START_TIMEOUT_S))
            self._stack = self._stack.pop_all()

    def check_alive(self) -> None:
        """Return if all still run.

        Raises:
            DeviceError: One has ended.
        """
        for simulator in self.simulators:
            simulator.check_alive()

    def close(self) -> None:
        """End all of them."""
        self._stack.close()

    def _ask_all_to_end(self) -> None:
        for simulator in self.simulators:
            simulator.ask_to_end()
