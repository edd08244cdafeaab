"""A small laboratory on the wire for tests: its rig file on free ports, and its simulators."""

import socket
from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from tronlab.campaign.rig import Rig, load_rig
from tronlab.campaign.simulators import simulator_modules, world_address
from tronlab.twin.fleet import Fleet
from tronlab.twin.server import StateServer
from tronlab.twin.state import LocalState
from tronlab.twin.world import initial_state

RIGS = Path(__file__).resolve().parents[2] / "campaigns" / "rigs"
LOOPBACK = "127.0.0.1"
HASTE = {"robot": ("--faster", "20"), "tracker": ("--initialize-s", "0.1")}
"""Arguments of simulators that would take a real device's time."""
REGION = {"left_px": 616, "top_px": 448, "width_px": 128, "height_px": 128}


@dataclass
class WireLaboratory:
    """A laboratory whose simulators run."""

    rig: Rig
    twin_path: Path
    """Rig file of the same laboratory in one process."""
    state: LocalState
    """What is true, and which faults are armed."""
    fleet: Fleet


def write_yaml(path: Path, value: object) -> Path:
    with path.open("w", encoding="utf-8") as file:
        YAML().dump(value, file)
    return path


def write_twin_rig(folder: Path) -> Path:
    """The repository's twin with a coarse terrain and a small part of the sensor."""
    rig: dict[str, Any] = YAML().load((RIGS / "twin.yaml").read_text(encoding="utf-8"))
    rig["laboratory"]["camera"].update(REGION)
    rig["terrain"]["spacing_m"] = 0.01
    rig["world"]["surface"]["rays_per_pixel"] = 1
    return write_yaml(folder / "twin.yaml", rig)


def write_wire_rig(folder: Path, twin_path: Path, *, protocol: str = "eki") -> Path:
    """The repository's wire rig on free ports, with the robot by "eki" or "kvp"."""
    rig: dict[str, Any] = YAML().load((RIGS / "wire.yaml").read_text(encoding="utf-8"))
    rig["extends"] = str(twin_path)
    options = {kind: device["options"] for kind, device in rig["devices"].items()}
    options["tracker"].update(port=_free_port(), timeout_s=2.0)
    options["robot"]["protocol"] = (
        {"kind": "eki", "command_port": _free_port(), "state_port": _free_port()}
        if protocol == "eki"
        else {"kind": "kvp", "port": _free_port()}
    )
    address = f"{LOOPBACK}:{_free_port(socket.SOCK_DGRAM)}"
    options["camera"].update(address=address, region=REGION)
    options["room"]["plc"].update(port=_free_port(), timeout_s=2.0)
    for part in ("dimmer", "supply", "air"):
        options["room"][part]["path"] = str(folder / "serial" / part)
    options["operator"]["world"] = f"{LOOPBACK}:{_free_port()}"
    return write_yaml(folder / f"wire_{protocol}.yaml", rig)


@contextmanager
def running(
    rig_path: Path, twin_path: Path, *, seed: int, only: tuple[str, ...] | None = None
) -> Generator[WireLaboratory]:
    """Run the simulators of a rig, or only those of some kinds of device."""
    rig = load_rig(rig_path)
    setup = rig.world_setup()
    assert setup is not None
    modules = simulator_modules(rig)
    with ExitStack() as stack:
        state = LocalState(initial_state(setup))
        host, port = world_address(rig)
        server = StateServer(state, host=host, port=port)
        stack.callback(server.close)
        fleet = Fleet(
            {kind: modules[kind] for kind in only or modules},
            rig_path=rig_path,
            world=server.address,
            seed=seed,
            more_arguments=HASTE,
        )
        stack.callback(fleet.close)
        yield WireLaboratory(rig, twin_path, state, fleet)


def _free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    with socket.socket(type=kind) as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])
