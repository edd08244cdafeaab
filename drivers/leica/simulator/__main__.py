"""``python -m drivers.leica.simulator``: one simulated tracker until Ctrl-C."""

import argparse
from typing import Final

from drivers.leica.options import TrackerOptions
from drivers.leica.simulator.faults import FAULTS
from drivers.leica.simulator.scene import Scene, StaticScene, WorldScene
from drivers.leica.simulator.server import TrackerServer
from drivers.leica.simulator.tracker import Machine
from drivers.simulation import LOOPBACK, Simulation, announce, fail, start, wait_until_stopped
from tronlab.errors import ConfigError, TronlabError

DEVICE: Final = "tracker"
PORT_ALONE: Final = 10_700
"""The real port, 700, is for privileged programs."""


def main() -> None:
    """Run the simulated tracker."""
    simulation = start(DEVICE, faults=FAULTS, add_arguments=_add_arguments)
    try:
        server = _serve(simulation)
    except TronlabError as error:
        fail(error)
    announce(DEVICE, *server.address)
    try:
        wait_until_stopped()
    finally:
        server.close()


def _serve(simulation: Simulation) -> TrackerServer:
    host, port = _address(simulation)
    machine = Machine(initialize_s=simulation.arguments.initialize_s)
    try:
        return TrackerServer(
            _scene(simulation), simulation.faults, host=host, port=port, machine=machine
        )
    except OSError as error:
        reason = error.strerror or str(error)
        raise ConfigError(
            f"cannot listen at {host}:{port}: {reason}; choose another with --port"
        ) from error


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--initialize-s",
        type=float,
        default=Machine().initialize_s,
        metavar="S",
        help="how long Initialize takes (default: %(default)s; the real one: up to 90)",
    )


def _address(simulation: Simulation) -> tuple[str, int]:
    if simulation.world is None:
        return simulation.address(LOOPBACK, PORT_ALONE)
    options = simulation.context.parse_options(TrackerOptions)
    return simulation.address(options.host, options.port)


def _scene(simulation: Simulation) -> Scene:
    if simulation.world is None:
        return StaticScene(simulation.noise)
    return WorldScene(simulation.world, simulation.noise)


if __name__ == "__main__":
    main()
