"""Use cameras through harvesters and the producer, and print what was seen as lines of JSON.

``harvesters_host.py CTI stream N``: fetch N frames of the first camera.
``harvesters_host.py CTI hold``: open it, then wait for a line on standard input.
``harvesters_host.py CTI lose``: fetch until the camera is lost, then open it again.
"""

import hashlib
import json
import sys
import time
from typing import Any

from genicam.genapi import GenericException as GenApiError
from genicam.gentl import GenericException
from harvesters.core import Harvester, ImageAcquirer


def tell(**what: Any) -> None:
    print(json.dumps(what), flush=True)


def open_first(harvester: Harvester) -> ImageAcquirer:
    harvester.update()
    devices = harvester.device_info_list
    tell(devices=[[device.vendor, device.model, device.serial_number] for device in devices])
    acquirer = harvester.create(0)
    acquirer.num_buffers = 16
    return acquirer


def fetch(acquirer: ImageAcquirer) -> None:
    with acquirer.fetch(timeout=5) as buffer:
        component = buffer.payload.components[0]
        data = component.data.tobytes()
        tell(
            id=buffer.module.frame_id,
            ticks=buffer.module.timestamp,
            frequency=buffer.timestamp_frequency,
            width=component.width,
            height=component.height,
            format=component.data_format,
            sha256=hashlib.sha256(data).hexdigest(),
        )


def stream(harvester: Harvester, n_frames: int) -> None:
    acquirer = open_first(harvester)
    acquirer.start()
    for _ in range(n_frames):
        fetch(acquirer)
    nodes = acquirer.data_streams[0].node_map
    tell(
        delivered=nodes.StreamDeliveredFrameCount.value,
        lost=nodes.StreamLostFrameCount.value,
        incomplete=nodes.StreamIncompleteFrameCount.value,
        requested=nodes.StreamRequestedPacketCount.value,
        address=acquirer.device.node_map.GevDeviceIPAddress.value,
    )
    acquirer.stop()
    acquirer.destroy()


def hold(harvester: Harvester) -> None:
    try:
        acquirer = open_first(harvester)
    except GenericException as error:
        tell(error=type(error).__name__)
        return
    tell(held=True)
    sys.stdin.readline()
    acquirer.destroy()


def lose(harvester: Harvester) -> None:
    acquirer = open_first(harvester)
    acquirer.start()
    fetch(acquirer)
    tell(streams=True)
    begun = time.monotonic()
    try:
        while time.monotonic() < begun + 30:
            acquirer.fetch(timeout=20).queue()
    except GenericException as error:
        tell(error=type(error).__name__, text=str(error))
    try:
        acquirer.destroy()
    except (GenericException, GenApiError) as error:  # nodes of a camera that is gone
        tell(error_of_destroy=type(error).__name__)
    acquirer = open_first(harvester)
    acquirer.start()
    fetch(acquirer)
    acquirer.stop()
    acquirer.destroy()


harvester = Harvester()
harvester.add_file(sys.argv[1])
actions = {"hold": hold, "lose": lose}
if sys.argv[2] == "stream":
    stream(harvester, int(sys.argv[3]))
else:
    actions[sys.argv[2]](harvester)
harvester.reset()
tell(done=True)
