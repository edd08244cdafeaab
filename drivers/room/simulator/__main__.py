"""``python -m drivers.room.simulator``: the room on the wire."""

import argparse
import tempfile
from collections.abc import Generator
from contextlib import closing, contextmanager
from pathlib import Path

from drivers.room.options import (
    AirOptions,
    DimmerOptions,
    PlcOptions,
    RoomOptions,
    SupplyOptions,
)
from drivers.room.simulator.room import RoomSimulator
from drivers.room.simulator.scene import FAULTS, StaticScene, WorldScene
from drivers.simulation import (
    LOOPBACK,
    Simulation,
    announce,
    fail,
    start,
    wait_until_stopped,
)
from tronlab.errors import ConfigError, TronlabError

_PORT_ALONE = 10502  # 502 needs privileges


def main() -> None:
    """Run until stopped."""
    simulation = start("room", faults=FAULTS, add_arguments=_add_arguments)
    try:
        _run(simulation)
    except TronlabError as error:
        fail(error)


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--serial-dir",
        type=Path,
        metavar="DIR",
        help="folder for the serial ports, without --rig (default: a temporary one)",
    )


def _run(simulation: Simulation) -> None:
    with _options(simulation) as options:
        world = simulation.world
        name = simulation.context.name
        host, port = simulation.address(options.plc.host, options.plc.port)
        simulator = RoomSimulator(
            options,
            StaticScene() if world is None else WorldScene(world, name=name),
            simulation.faults,
            host=host,
            port=port,
            serial="" if world is None else world.serial,
        )
        with closing(simulator):
            for address in simulator.addresses:
                announce(*address)
            wait_until_stopped()


@contextmanager
def _options(simulation: Simulation) -> Generator[RoomOptions]:
    """Give the options of the rig file, or a room with every part."""
    folder: Path | None = simulation.arguments.serial_dir
    if simulation.world is not None:
        if folder is not None:
            raise ConfigError("--serial-dir is not for --rig: the rig file has the serial ports")
        context = simulation.context
        yield context.parse_options(RoomOptions).located(context.base_dir)
    elif folder is not None:
        yield _every_part(folder)
    else:
        with tempfile.TemporaryDirectory(prefix="tronlab-room-") as temporary:
            yield _every_part(Path(temporary))


def _every_part(folder: Path) -> RoomOptions:
    return RoomOptions(
        plc=PlcOptions(host=LOOPBACK, port=_PORT_ALONE),
        dimmer=DimmerOptions(path=str(folder / "dimmer")),
        supply=SupplyOptions(path=str(folder / "supply"), voltage_v=24.0, current_a=5.0),
        air=AirOptions(path=str(folder / "air")),
    )


if __name__ == "__main__":
    main()
