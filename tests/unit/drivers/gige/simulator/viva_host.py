"""Run viva-genicam's host against a simulated camera, and print what it saw as JSON.

A process of its own: that host asks only UDP port 3956 of 127.0.0.1, so there can be but one
camera. With ``--own-network`` it is in a network namespace whose loopback is not up yet.
"""

import json
import sys
import time
from typing import Any

import numpy as np
import viva_genicam as vg
from own_network import raise_loopback

from drivers.gige.simulator.device import CameraServer
from drivers.gige.simulator.scene import PatternScene, pattern
from tronlab.twin.state import ArmedFaults

LOOPBACK = "127.0.0.1"
N_FRAMES = 10


def n_exact(camera: Any, pixel_format: str, **options: Any) -> tuple[int, Any]:
    """Stream some frames; count those that are bit-exact."""
    camera.set("PixelFormat", pixel_format)
    n = 0
    with camera.stream(iface=LOOPBACK, **options) as frames:
        for _ in range(N_FRAMES):
            frame = frames.next_frame(10_000)
            expected = pattern(frame.block_id, frame.width, frame.height, pixel_format)
            n += np.array_equal(frame.to_numpy(), expected)
        return n, frames.stats()


def error_of(call: Any, *arguments: Any) -> str | None:
    try:
        call(*arguments)
    except vg.GenicamError as error:
        return str(error)
    return None


def look(server: CameraServer, faults: ArmedFaults) -> dict[str, Any]:
    (info,) = vg.discover(timeout_ms=1000, iface=LOOPBACK)
    seen: dict[str, Any] = {"maker": info.manufacturer, "model": info.model}
    with vg.connect_gige(info, iface=LOOPBACK) as camera:
        seen["skipped"] = [str(node) for node in camera.skipped()]
        seen["serial"] = camera.get("DeviceID")
        seen["second host"] = error_of(vg.connect_gige, info, LOOPBACK)
        camera.set_exposure_time(1500.0)
        seen["exposure"] = server_register(camera, "ExposureTimeAbs")
        camera.set_gain(12)
        seen["gain"] = server_register(camera, "GainRaw")
        seen["too long"] = error_of(camera.set_float, "ExposureTimeAbs", 6.1e7)
        seen["not simulated"] = error_of(camera.set, "ExposureAuto", "Continuous")
        camera.set_roi(vg.Roi(100, 50, 640, 480))
        seen["payload"] = camera.get_integer("PayloadSize")
        camera.set_exposure_time(100.0)
        camera.set_frame_rate(100.0)
        for name in ("Mono8", "Mono12", "Mono12Packed"):
            seen[name], _ = n_exact(camera, name)
        camera.set_frame_rate(20.0)  # what that host loses on a busy computer is not our matter
        camera.set_roi(vg.Roi(0, 0, 1360, 1024))
        seen["full"], _ = n_exact(camera, "Mono8", packet_size=8228)
        seen["losses"] = losses(camera, server, faults)
        seen["garbage"] = garbage(camera, faults)
        seen["triggered"] = triggered(camera)
        seen["slow"] = slow(camera, faults)
        camera.time_calibrate(samples=4)
        seen["clock error s"] = clock_error_s(camera)
    return seen


def server_register(camera: Any, name: str) -> int:
    return camera.get_integer(f"{name}Register")


def losses(camera: Any, server: CameraServer, faults: ArmedFaults) -> dict[str, int]:
    faults.arm("camera.lose_packets")
    n, stats = n_exact(camera, "Mono8", packet_size=1500)
    faults.arm("camera.lose_packets", times=0)
    return {
        "exact": n,
        "lost": server.statistics.n_packets_lost,
        "recovered": stats.resend_recovered,
    }


def garbage(camera: Any, faults: ArmedFaults) -> dict[str, int]:
    faults.arm("camera.bad_packets")
    n, stats = n_exact(camera, "Mono8")
    faults.arm("camera.bad_packets", times=0)
    return {"exact": n, "ignored": stats.packets_ignored}


def triggered(camera: Any) -> list[int]:
    """Give the block ids of three triggers, and -1 if a frame comes without one."""
    camera.enable_trigger("FrameStart", "Software")
    block_ids: list[int] = []
    with camera.stream(iface=LOOPBACK) as frames:
        for _ in range(3):
            camera.trigger_software()
            block_ids.append(frames.next_frame(10_000).block_id)
        if error_of(frames.next_frame, 300) is None:
            block_ids.append(-1)
    camera.disable_trigger("FrameStart")
    return block_ids


def slow(camera: Any, faults: ArmedFaults) -> bool:
    """Tell whether a write that needs a PENDING_ACK goes well."""
    faults.arm("camera.slow_command", times=1)
    camera.set_integer("GainRaw", 3)
    return camera.get_integer("GainRaw") == 3 and not faults.is_armed("camera.slow_command")


def clock_error_s(camera: Any) -> float:
    """Compare the time of a latched time stamp with this computer's."""
    camera.execute("GevTimestampControlLatch")
    mapped = camera.map_dev_ts(camera.get_integer("GevTimestampValue"))
    return abs(time.time() - mapped)


def main() -> None:
    if "--own-network" in sys.argv:
        raise_loopback()
    faults = ArmedFaults()
    server = CameraServer(PatternScene(), faults, port=3956)
    try:
        print(json.dumps(look(server, faults)))
    finally:
        server.close()


if __name__ == "__main__":
    main()
