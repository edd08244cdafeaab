"""What the simulators on the wire have in common: command line, world, faults, life and death.

``python -m drivers.leica.simulator`` runs one alone, over a small scene of its own.
``tronlab twin up RIG.yaml`` runs all of a rig, with ``--rig`` and ``--world``: then they are views
of one simulated laboratory, each in its own process.
"""

import argparse
import json
import os
import signal
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NoReturn

from numpy.random import Generator

from tronlab.devices.address import HIGHEST_PORT, parse_address
from tronlab.devices.registry import DeviceContext
from tronlab.errors import ConfigError, TronlabError
from tronlab.twin.state import FOR_EVER, ArmedFaults, Faults
from tronlab.twin.world import World

LOOPBACK: Final = "127.0.0.1"
_USAGE_ERROR: Final = 2
_HIGHEST_SEED: Final = 2**32 - 1
_LOOK_S: Final = 0.2
_PARENT: Final = os.getppid()
"""Who started this process; asked at once, for it may be gone before the simulator is ready."""


@dataclass(frozen=True)
class Simulation:
    """What a simulator was started with."""

    arguments: argparse.Namespace
    """The command line, with what ``add_arguments`` added."""
    faults: Faults
    world: World | None
    """The simulated laboratory; None when the simulator runs alone."""
    context: DeviceContext
    """As the driver on the other side gets it: the options of the rig file; without a rig, none."""

    @property
    def noise(self) -> Generator:
        """Get the noise of this device, the same that its twin in one process has."""
        from tronlab.twin.instruments import noise_of

        return noise_of(self.context.name, seed=self.context.seed, session=self.context.session)

    def address(self, host: str, port: int) -> tuple[str, int]:
        """Give where to listen: as the command line says, else as given."""
        asked: argparse.Namespace = self.arguments
        return asked.host or host, port if asked.port is None else asked.port


def start(
    kind: str,
    *,
    faults: Mapping[str, str],
    add_arguments: Callable[[argparse.ArgumentParser], object] = lambda parser: None,
    argv: Sequence[str] | None = None,
) -> Simulation:
    """Read the command line of a simulator; a mistake in it ends the process with one line.

    From now until ``wait_until_stopped``, Ctrl-C and SIGTERM raise ``SystemExit``.

    Args:
        kind: Kind of device, as in the section ``devices`` of a rig file.
        faults: Faults it can be told to have, ``KIND.NAME``, and what happens then.
        add_arguments: Adds what only this simulator has.
        argv: Arguments instead of the process's.
    """
    arguments = _parser(kind, faults, add_arguments).parse_args(argv)
    try:
        simulation = _simulation(kind, faults, arguments)
    except TronlabError as error:
        fail(error)
    _when_told_to_stop(_unwind)  # until wait_until_stopped: getting ready may take a minute
    return simulation


def fail(error: TronlabError) -> NoReturn:
    """End the process with one clear error."""
    print(f"error: {error}", file=sys.stderr)
    raise SystemExit(_USAGE_ERROR)


def announce(device: str, host: str, port: int | str) -> None:
    """Say that a device can be reached, as one line of JSON; ``port`` of a serial one is a path."""
    print(json.dumps({"device": device, "host": host, "port": port}), flush=True)


def wait_until_stopped() -> None:
    """Return at Ctrl-C or SIGTERM, or when the process that started this one is gone."""
    stopped = threading.Event()
    _when_told_to_stop(lambda _signal, _frame: stopped.set())
    while not stopped.wait(_LOOK_S) and os.getppid() == _PARENT:
        pass


def _when_told_to_stop(handler: Callable[[int, object], None]) -> None:
    for kind in (signal.SIGINT, signal.SIGTERM):
        signal.signal(kind, handler)


def _unwind(_signal: int, _frame: object) -> NoReturn:
    raise SystemExit


def _parser(
    kind: str,
    faults: Mapping[str, str],
    add_arguments: Callable[[argparse.ArgumentParser], object],
) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=f"Simulated {kind} on the wire; prints one line of JSON an address when ready.",
        epilog="\n".join(["faults:", *(f"  {name:30} {what}" for name, what in faults.items())]),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--host", help=f"address to listen at (default: as in the rig file, else {LOOPBACK})"
    )
    parser.add_argument(
        "--port",
        type=_number_to(HIGHEST_PORT),
        help="port to listen at; 0: any free one (default: as in the rig file, else the usual one)",
    )
    parser.add_argument("--rig", type=Path, help="rig file with the options and the world")
    parser.add_argument("--world", help="HOST:PORT of the state of a running `tronlab twin up`")
    parser.add_argument(
        "--seed",
        type=_number_to(_HIGHEST_SEED),
        default=0,
        help="of measurement noise (default: 0)",
    )
    parser.add_argument("--session", default="run", help="what it runs for (default: run)")
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="NAME[:TIMES]",
        help="have this fault from the start, so many times (default: for ever)",
    )
    add_arguments(parser)
    return parser


def _number_to(highest: int) -> Callable[[str], int]:
    """Make a reader of whole numbers from 0 to the highest."""

    def read(text: str) -> int:
        if not text.isdecimal() or int(text) > highest:
            raise argparse.ArgumentTypeError(f"'{text}' is no whole number from 0 to {highest}")
        return int(text)

    return read


def _simulation(kind: str, faults: Mapping[str, str], arguments: argparse.Namespace) -> Simulation:
    armed = dict(_fault(text, faults) for text in arguments.fault)
    if arguments.rig is None:
        if arguments.world is not None:
            raise ConfigError("--world needs --rig: the laboratory is described there")
        context = DeviceContext(
            name=kind, options={}, seed=arguments.seed, world=None, session=arguments.session
        )
        return Simulation(arguments, ArmedFaults(armed), None, context)
    return _simulation_of_rig(kind, armed, arguments)


def _simulation_of_rig(
    kind: str, armed: Mapping[str, int], arguments: argparse.Namespace
) -> Simulation:
    from tronlab.campaign.rig import load_rig
    from tronlab.devices.clock import WallClock
    from tronlab.twin.server import RemoteState

    rig = load_rig(arguments.rig)
    setup = rig.world_setup()
    if setup is None:
        raise ConfigError("a simulator needs this section", path=arguments.rig, key="world")
    state = None if arguments.world is None else RemoteState(*_address(arguments.world))
    world = World(setup, clock=WallClock(), state=state)
    world.state.read()  # if nobody serves it that is told now, not at the first measurement
    for name, times in armed.items():
        world.state.arm(name, times=times)
    context = rig.device_context(kind, seed=arguments.seed, session=arguments.session, world=setup)
    return Simulation(arguments, world.state, world, context)


def _fault(text: str, known: Mapping[str, str]) -> tuple[str, int]:
    name, colon, times = text.partition(":")
    if name not in known:
        raise ConfigError(f"--fault {text}: no fault '{name}'; faults: {', '.join(known)}")
    if colon and not (times.isdecimal() and int(times) > 0):
        raise ConfigError(f"--fault {text}: '{times}' is no number of times, such as 1")
    return name, int(times) if colon else FOR_EVER


def _address(text: str) -> tuple[str, int]:
    try:
        return parse_address(text)
    except ValueError as error:
        raise ConfigError(f"--world {text}: {error}") from None
