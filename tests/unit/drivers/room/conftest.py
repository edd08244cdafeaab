"""Fixtures: a simulated room on the wire, and a driver connected to it."""

import threading
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from drivers.room.driver import RoomDriver
from drivers.room.options import (
    AirOptions,
    DimmerOptions,
    PlcOptions,
    RoomOptions,
    SupplyOptions,
)
from drivers.room.simulator.room import RoomSimulator
from drivers.room.simulator.scene import StaticScene
from tronlab.twin.state import ArmedFaults

HOST = "127.0.0.1"
TIMEOUT_S = 1.0


@pytest.fixture(autouse=True)
def _no_thread_is_left():
    before = set(threading.enumerate())
    yield
    left = {thread for thread in threading.enumerate() if thread not in before}
    assert not {thread.name for thread in left if thread.is_alive()}


@pytest.fixture(autouse=True)
def _pseudo_terminals_are_quick(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("drivers.room.air._LAST_LINE_S", 0.02)


@pytest.fixture
def faults() -> ArmedFaults:
    return ArmedFaults()


@pytest.fixture
def scene() -> StaticScene:
    return StaticScene()


class Laboratory:
    """A simulated room, and the options that lead a driver to it."""

    def __init__(self, folder: Path, scene: StaticScene, faults: ArmedFaults, **plc: Any) -> None:
        self.folder, self.scene, self.faults = folder, scene, faults
        self.options = RoomOptions(
            plc=PlcOptions(host=HOST, port=1, timeout_s=TIMEOUT_S, **plc),
            dimmer=DimmerOptions(path=str(folder / "dimmer"), timeout_s=TIMEOUT_S),
            supply=SupplyOptions(
                path=str(folder / "supply"), timeout_s=TIMEOUT_S, voltage_v=24.0, current_a=5.0
            ),
            air=AirOptions(path=str(folder / "air"), timeout_s=TIMEOUT_S),
            lamp_settle_s=0.0,
        )
        self.simulator: RoomSimulator | None = None

    def without(self, *parts: str) -> "Laboratory":
        self.options = self.options.model_copy(update=dict.fromkeys(parts))
        return self

    def start(self) -> "Laboratory":
        self.simulator = RoomSimulator(self.options, self.scene, self.faults, host=HOST, port=0)
        return self.moved(port=self.simulator.addresses[0][2])

    def moved(self, **plc: Any) -> "Laboratory":
        """Change options of the PLC as the driver has them."""
        self.options = self.options.model_copy(
            update={"plc": self.options.plc.model_copy(update=plc)}
        )
        return self

    def close(self) -> None:
        if self.simulator is not None:
            self.simulator.close()


@pytest.fixture
def make_lab(tmp_path: Path, scene: StaticScene, faults: ArmedFaults):
    """Make a laboratory, not yet started; ``make_lab(word_order="little")``."""
    with ExitStack() as stack:

        def make(**plc: Any) -> Laboratory:
            lab = Laboratory(tmp_path, scene, faults, **plc)
            stack.callback(lab.close)
            return lab

        yield make


@pytest.fixture
def lab(make_lab: Callable[..., Laboratory]) -> Laboratory:
    return make_lab().start()


@pytest.fixture
def make_room():
    """Make a driver, not yet connected, and close it at the end."""
    with ExitStack() as stack:

        def make(lab: Laboratory, *, name: str = "here") -> RoomDriver:
            room = RoomDriver(name, lab.options)
            stack.callback(room.close)
            return room

        yield make


@pytest.fixture
def room(lab: Laboratory, make_room: Callable[..., RoomDriver]) -> RoomDriver:
    """A connected driver."""
    driver = make_room(lab)
    driver.connect()
    return driver
