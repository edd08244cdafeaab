"""Which simulators a rig needs so that its drivers find a laboratory on the wire."""

from collections.abc import Mapping

from tronlab.campaign.rig import DeviceConfig, Rig
from tronlab.devices.address import parse_address
from tronlab.devices.registry import KINDS, known_simulators
from tronlab.errors import ConfigError

TWIN_PREFIX = "twin."


def simulator_modules(rig: Rig) -> dict[str, str]:
    """Give the module of every simulator a rig needs, by kind of device.

    Raises:
        ConfigError: The rig describes no simulated world, or none of its drivers has a simulator.
    """
    if rig.config.world is None:
        raise ConfigError(
            "required key is missing: a rig of hardware has nothing to simulate;"
            " campaigns/rigs/wire.yaml is one that has",
            path=rig.path,
            key="world",
        )
    simulators = known_simulators()
    modules = {
        kind: simulators[config.driver].module
        for kind, config in _devices(rig).items()
        if config.driver in simulators
    }
    if not modules:
        raise ConfigError(
            f"no driver of this rig has a simulator; those that have: {', '.join(simulators)}",
            path=rig.path,
            key="devices",
        )
    return modules


def simulator_faults(rig: Rig) -> dict[str, str]:
    """Give every fault the rig's simulators can have, by name, and what happens then.

    Raises:
        ConfigError: As ``simulator_modules``.
    """
    from importlib import import_module

    faults: dict[str, str] = {}
    for module in simulator_modules(rig).values():
        faults.update(import_module(module).FAULTS)
    return faults


def world_address(rig: Rig) -> tuple[str, int]:
    """Give where the laboratory of a rig is served: where its simulated devices look for it.

    Raises:
        ConfigError: No device of the rig says so.
    """
    for kind, config in _devices(rig).items():
        world = config.options.get("world") if config.driver.startswith(TWIN_PREFIX) else None
        if world is None:
            continue
        try:
            return parse_address(str(world))
        except ValueError as error:
            key = f"devices.{kind}.options.world"
            raise ConfigError(f"'{world}': {error}", path=rig.path, key=key) from None
    raise ConfigError(
        "HOST:PORT where `tronlab twin up` serves the laboratory is missing, such as"
        " 127.0.0.1:10600",
        path=rig.path,
        key="devices.operator.options.world",
    )


def _devices(rig: Rig) -> Mapping[str, DeviceConfig]:
    return {kind: getattr(rig.config.devices, kind) for kind in KINDS}
