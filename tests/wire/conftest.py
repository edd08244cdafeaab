"""A small laboratory on the wire: all simulators in processes of their own, on free ports."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from perfect_record import save_perfect_record
from ruamel.yaml import YAML
from wire_laboratory import (
    RIGS,
    WireLaboratory,
    running,
    write_twin_rig,
    write_wire_rig,
    write_yaml,
)

from tronlab.campaign.rig import load_rig
from tronlab.campaign.simulators import simulator_faults
from tronlab.twin.world import World


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the laboratory's files are."""
    return tmp_path_factory.mktemp("laboratory")


@pytest.fixture(scope="module")
def twin_path(folder: Path) -> Path:
    """Rig file of the laboratory in one process."""
    return write_twin_rig(folder)


@pytest.fixture
def start_wire(folder: Path, twin_path: Path) -> Iterator[Callable[..., WireLaboratory]]:
    """``start_wire(protocol="kvp")`` starts simulators, ended after the test."""
    with ExitStack() as stack:

        def start(*, protocol: str = "eki") -> WireLaboratory:
            path = write_wire_rig(folder, twin_path, protocol=protocol)
            return stack.enter_context(running(path, twin_path, seed=3))

        yield start


@pytest.fixture(scope="module")
def lasting_wire(folder: Path, twin_path: Path) -> Iterator[WireLaboratory]:
    """Simulators that several tests use one after the other."""
    shared = folder / "shared"
    shared.mkdir()
    with running(write_wire_rig(shared, twin_path), twin_path, seed=3) as wire:
        yield wire


@pytest.fixture
def wire(lasting_wire: WireLaboratory) -> Iterator[WireLaboratory]:
    """A laboratory that runs; whatever the test did to it is mended after it."""
    yield lasting_wire
    for fault in simulator_faults(lasting_wire.rig):
        lasting_wire.state.arm(fault, times=0)
    lasting_wire.state.change(is_door_closed=True, tracker_shift_m=(0.0, 0.0, 0.0))


@pytest.fixture
def record_path(tmp_path: Path, twin_path: Path) -> Path:
    """A perfect calibration record of the laboratory, made without the wire."""
    return save_perfect_record(tmp_path / "record.json", rig_path=twin_path)


@pytest.fixture
def campaign_path(tmp_path: Path, record_path: Path, twin_path: Path) -> Path:
    """Three shots of the repository's straight line, without drift checks: they take long."""
    root: dict[str, Any] = YAML().load(
        (RIGS.parent / "straight_line.yaml").read_text(encoding="utf-8")
    )
    root.update(rig=str(twin_path), calibration=str(record_path), seed=3)
    root["trajectory"].update(start_trs_m=[1.08, 2.08, 3.0], end_trs_m=[1.08, 2.08, 2.7])
    root["trajectory"]["n_points"] = 3
    root["database"]["n_views"] = 2
    root["tracker"]["window_s"] = 0.2
    root["settle"]["wait_s"] = 0.05
    root["camera"]["timeout_s"] = 3.0
    root["retry"] = {"lost_connection": {"max_attempts": 6, "pauses_s": [0.5]}}
    root["drift"] = None
    return write_yaml(tmp_path / "campaign.yaml", root)


@pytest.fixture
def replay() -> Callable[[WireLaboratory], World]:
    """A world in this process of the same laboratory, whose state can be set."""

    def make(wire: WireLaboratory) -> World:
        setup = load_rig(wire.twin_path).world_setup()
        assert setup is not None
        return World(setup)

    return make
