"""Run the simulated robot: ``python -m drivers.kuka.simulator``."""

import argparse
import math
from dataclasses import dataclass, replace
from typing import Final

from drivers.kuka.options import EkiOptions, KukaOptions
from drivers.kuka.simulator.controller import Controller
from drivers.kuka.simulator.eki import EkiServer
from drivers.kuka.simulator.faults import FAULTS
from drivers.kuka.simulator.kvp import KvpServer
from drivers.kuka.simulator.machine import KR16, Machine
from drivers.kuka.simulator.scene import EmptyScene, Scene, WorldScene
from drivers.simulation import LOOPBACK, Simulation, announce, fail, start, wait_until_stopped
from tronlab.errors import TronlabError

_EKI: Final = EkiOptions(kind="eki")
_KVP_PORT: Final = 7000
_BEYOND_MM: Final = 50.0
"""The controller's limits of the rail lie so far outside those of the rig file."""


@dataclass(frozen=True)
class _Ports:
    """Where to listen; None for what is not served."""

    command: int | None = None
    state: int | None = None
    kvp: int | None = None


def main() -> None:
    """Serve until stopped."""
    simulation = start("robot", faults=FAULTS, add_arguments=_add_arguments)
    try:
        _serve(simulation)
    except TronlabError as error:
        fail(error)


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--protocol",
        choices=("both", "eki", "kvp"),
        help="what to serve (default: what the rig file says; both without one)",
    )
    parser.add_argument("--state-port", type=int, help="EthernetKRL port of the state")
    parser.add_argument("--kvp-port", type=int, help="port of the variables")
    parser.add_argument(
        "--faster",
        type=_factor,
        default=1.0,
        metavar="FACTOR",
        help="how many times faster than a KR 16 it moves, to save time (default: 1)",
    )


def _factor(text: str) -> float:
    try:
        factor = float(text)
    except ValueError:
        factor = math.nan
    if not 0.0 < factor < math.inf:
        raise argparse.ArgumentTypeError(f"'{text}' is no positive number")
    return factor


def _serve(simulation: Simulation) -> None:
    options = None
    if simulation.world is not None:
        options = simulation.context.parse_options(KukaOptions)
    ports = _asked(simulation.arguments, _ports(options, simulation.arguments.protocol))
    host, _ = simulation.address(LOOPBACK if options is None else options.host, 0)
    controller = Controller(
        _scene(simulation), simulation.faults, machine=_machine(simulation, options)
    )
    servers: list[EkiServer | KvpServer] = []
    addresses: dict[str, tuple[str, int]] = {}
    try:
        if ports.command is not None and ports.state is not None:
            eki = EkiServer(
                controller,
                simulation.faults,
                host=host,
                command_port=ports.command,
                state_port=ports.state,
            )
            servers.append(eki)
            addresses["robot eki command"] = eki.command_address
            addresses["robot eki state"] = eki.state_address
        if ports.kvp is not None:
            kvp = KvpServer(controller, simulation.faults, host=host, port=ports.kvp)
            servers.append(kvp)
            addresses["robot kvp"] = kvp.address
        for device, address in addresses.items():
            announce(device, *address)
        wait_until_stopped()
    finally:
        for server in servers:
            server.close()
        controller.close()


def _ports(options: KukaOptions | None, protocol: str | None) -> _Ports:
    """Give the ports that the driver will dial, or the usual ones."""
    if options is None:
        ports = _Ports(_EKI.command_port, _EKI.state_port, _KVP_PORT)
    elif isinstance(options.protocol, EkiOptions):
        eki = options.protocol
        ports = _Ports(eki.command_port, eki.state_port, eki.kvp_port)
    else:
        ports = _Ports(kvp=options.protocol.port)
    if protocol == "eki":
        return _Ports(ports.command or _EKI.command_port, ports.state or _EKI.state_port)
    if protocol == "kvp":
        return _Ports(kvp=_first(ports.kvp, _KVP_PORT))
    return ports


def _asked(arguments: argparse.Namespace, ports: _Ports) -> _Ports:
    """Put what the command line says in place; ``--port`` is that of the first server.

    ``--port 0`` asks for any free one, and so for all servers that are given no port of their own.
    """
    if arguments.port == 0:
        served = (ports.command, ports.state, ports.kvp)
        ports = _Ports(*(None if port is None else 0 for port in served))
    command, kvp = ports.command, ports.kvp
    if command is None:
        kvp = _first(arguments.kvp_port, arguments.port, kvp)
    else:
        command = _first(arguments.port, command)
        kvp = _first(arguments.kvp_port, kvp)
    return _Ports(command, _first(arguments.state_port, ports.state), kvp)


def _first(*values: int | None) -> int | None:
    return next((value for value in values if value is not None), None)


def _scene(simulation: Simulation) -> Scene:
    if simulation.world is None:
        return EmptyScene()
    return WorldScene(simulation.world, simulation.noise)


def _machine(simulation: Simulation, options: KukaOptions | None) -> Machine:
    kr16 = KR16.faster(simulation.arguments.faster)
    if simulation.world is None or options is None:
        return kr16
    ends_mm = sorted(
        options.rail_zero_mm + options.rail_sign * rail_m * 1e3 for rail_m in options.rail_range_m
    )
    return replace(
        kr16,
        serial=simulation.world.serial,
        rail_range_mm=(ends_mm[0] - _BEYOND_MM, ends_mm[1] + _BEYOND_MM),
        rail_zero_mm=options.rail_zero_mm,
        rail_sign=options.rail_sign,
    )


if __name__ == "__main__":
    main()
