"""``python -m drivers.gige.simulator``: a GigE Vision camera on the wire."""

import argparse
import logging
import sys
from contextlib import ExitStack
from typing import Final

from drivers.gige.options import CameraOptions, camera_address
from drivers.gige.simulator.device import CameraServer
from drivers.gige.simulator.faults import FAULTS, PromptFaults
from drivers.gige.simulator.features import Model
from drivers.gige.simulator.gvcp import STANDARD_PORT
from drivers.gige.simulator.scene import PatternScene, WorldScene
from drivers.simulation import (
    LOOPBACK,
    Simulation,
    announce,
    fail,
    start,
    wait_until_stopped,
)
from tronlab.errors import TronlabError
from tronlab.twin.world import World

_US_PER_S: Final = 1_000_000


def main() -> None:
    """Run a camera until stopped."""
    logging.basicConfig(format="%(levelname)s: %(message)s")
    simulation = start("camera", faults=FAULTS, add_arguments=_add_arguments)
    with ExitStack() as stack:
        try:
            server = _server(simulation, stack)
        except TronlabError as error:
            fail(error)
        stack.callback(server.close)
        announce("camera", *server.address)
        wait_until_stopped()


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--unthrottled", action="store_true", help="send faster than StreamBytesPerSecond"
    )
    parser.add_argument(
        "--segmentation-offload",
        action="store_true",
        help="let Linux cut packets: faster, but not for receivers of raw packets",
    )
    parser.add_argument(
        "--first-block",
        type=int,
        default=1,
        choices=range(1, 65536),
        metavar="ID",
        help="block id of the first frame, 1 to 65535 (default: 1)",
    )


def _server(simulation: Simulation, stack: ExitStack) -> CameraServer:
    arguments, world = simulation.arguments, simulation.world
    host, port = simulation.address(*_default_address(simulation))
    scene, model, faults, on_trigger = PatternScene(), Model(), simulation.faults, _nothing
    if world is not None:
        print("camera: preparing the terrain and a first view", file=sys.stderr, flush=True)
        world.prepare_view()
        world.rehearse_view()
        scene, model = WorldScene(world, simulation.noise), _model_of(world)
        stack.callback(scene.close)
        faults, name = PromptFaults(simulation.faults), simulation.context.name

        def on_trigger() -> None:
            world.faults.count("camera", "grab", name=name)

    return CameraServer(
        scene,
        faults,
        host=host,
        port=port,
        model=model,
        on_trigger=on_trigger,
        is_unthrottled=arguments.unthrottled,
        uses_segmentation_offload=arguments.segmentation_offload,
        first_block_id=arguments.first_block,
    )


def _default_address(simulation: Simulation) -> tuple[str, int]:
    """Give where the driver of the rig looks for the camera."""
    if simulation.world is not None:
        options = simulation.context.parse_options(CameraOptions)
        if options.address is not None:
            return camera_address(options.address)
    return LOOPBACK, STANDARD_PORT


def _model_of(world: World) -> Model:
    """Give the camera of the simulated laboratory."""
    camera, sensor = world.spec.camera, world.config.sensor
    shortest_s, longest_s = sensor.exposure_range_s
    lowest_db, highest_db = sensor.gain_range_db
    return Model(
        serial=world.serial,
        sensor_width_px=camera.sensor_width_px,
        sensor_height_px=camera.sensor_height_px,
        exposure_range_us=(round(shortest_s * _US_PER_S), round(longest_s * _US_PER_S)),
        gain_range_db=(round(lowest_db), round(highest_db)),
        readout_s=sensor.readout_s,
    )


def _nothing() -> None:
    """Do nothing."""


if __name__ == "__main__":
    main()
