"""The whole simulated room: a PLC, and those serial devices that the options name."""

import time
from contextlib import ExitStack
from pathlib import Path

from drivers.room.options import RoomOptions
from drivers.room.simulator.dmx import DmxWidget
from drivers.room.simulator.lamp import SimulatedLamp
from drivers.room.simulator.plc import PlcServer
from drivers.room.simulator.program import PlcProgram
from drivers.room.simulator.ptu300 import Ptu300
from drivers.room.simulator.pty_device import PtyDevice, SerialDevice
from drivers.room.simulator.scene import Scene
from drivers.room.simulator.scpi import ScpiSupply
from tronlab.errors import ConfigError
from tronlab.twin.state import Faults


class RoomSimulator:
    """A room on the wire, until closed.

    Args:
        options: As the driver has them, with the paths of serial ports located; a part that they
            leave out is not simulated.
        scene: The room behind it.
        faults: See ``FAULTS``.
        host: Where the PLC listens.
        port: 0: any free one.
        serial: Serial number of what has one.

    Raises:
        NotConnectedError: The PLC cannot listen there.
        ConfigError: A serial port cannot be made.
    """

    def __init__(
        self,
        options: RoomOptions,
        scene: Scene,
        faults: Faults,
        *,
        host: str,
        port: int,
        serial: str = "",
    ) -> None:
        lamp = SimulatedLamp(
            scene,
            has_supply=options.supply is not None,
            has_dimmer=options.dimmer is not None,
        )
        program = PlcProgram(
            scene, lamp, faults, word_order=options.plc.word_order, now_s=time.monotonic()
        )
        self._addresses: list[tuple[str, str, int | str]] = []
        with ExitStack() as parts:
            plc = PlcServer(
                program,
                faults,
                host=host,
                port=port,
                device_id=options.plc.device_id,
                serial=serial,
            )
            parts.callback(plc.close)
            self._addresses.append(("room plc", *plc.address))
            for name, path, device in _serial_devices(options, scene, lamp, faults, serial):
                terminal = PtyDevice(_file(path), device)
                parts.callback(terminal.close)
                self._addresses.append((f"room {name}", *terminal.address))
            self._parts = parts.pop_all()

    @property
    def addresses(self) -> tuple[tuple[str, str, int | str], ...]:
        """Get name, host and port of each part; of a serial one, name, ``pty`` and path."""
        return tuple(self._addresses)

    def close(self) -> None:
        """End every part; may be called twice."""
        self._parts.close()


def _serial_devices(
    options: RoomOptions, scene: Scene, lamp: SimulatedLamp, faults: Faults, serial: str
) -> list[tuple[str, str, SerialDevice]]:
    """Give name, path and device of every serial part."""
    devices: list[tuple[str, str, SerialDevice]] = []
    if options.dimmer:
        widget = DmxWidget(
            lamp,
            faults,
            channel=options.dimmer.channel,
            fine_channel=options.dimmer.fine_channel,
        )
        devices.append(("dimmer", options.dimmer.path, widget))
    if options.supply:
        devices.append(("supply", options.supply.path, ScpiSupply(lamp, faults, serial=serial)))
    if options.air:
        devices.append(("air", options.air.path, Ptu300(scene.state, faults)))
    return devices


def _file(path: str) -> Path:
    if "://" in path:
        raise ConfigError(f"'{path}' is a URL; a simulated serial port needs a file path")
    return Path(path)
