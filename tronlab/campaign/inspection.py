"""Which devices of a rig answer, who they are, and in which state."""

import inspect
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from tronlab.devices.protocols import Device, Diagnosable
from tronlab.devices.registry import Devices
from tronlab.errors import TronlabError


@dataclass(frozen=True)
class Finding:
    """What was found out about one device."""

    name: str
    driver: str
    driver_file: Path
    """Which code talked to it: more than one version may be installed."""
    facts: dict[str, str] = field(default_factory=dict[str, str])
    """What it says of itself, as far as it got."""
    error: str = ""
    """Why it failed; empty if it did not."""


def inspect_devices(devices: Devices, *, drivers: Mapping[str, str]) -> tuple[Finding, ...]:
    """Connect to each device, ask it, and close it again; a failure does not keep from the next.

    Args:
        devices: Not connected.
        drivers: Name of each device's driver.
    """
    return tuple(_inspect(device, drivers[device.name]) for device in devices.all())


def _inspect(device: Device, driver: str) -> Finding:
    facts: dict[str, str] = {}
    error = ""
    try:
        device.connect()
        facts.update(_ask(device))
    except TronlabError as caught:
        error = str(caught)
    finally:
        device.close()
    return Finding(
        name=device.name,
        driver=driver,
        driver_file=Path(inspect.getfile(type(device))),
        facts=facts,
        error=error,
    )


def _ask(device: Device) -> dict[str, str]:
    identity = device.identify()
    facts = {
        "device": " ".join(filter(None, (identity.maker, identity.model))),
        "serial number": identity.serial,
        "firmware": identity.firmware,
    }
    if isinstance(device, Diagnosable):
        facts.update(device.diagnose())
    return {name: value or "not said" for name, value in facts.items()}
