"""Faults of a laboratory that another process keeps."""

import threading

import pytest

from drivers.gige.simulator.faults import FAULTS, PromptFaults
from tronlab.errors import NotConnectedError
from tronlab.twin.state import ArmedFaults

CCP = 0xA00


class Shared(ArmedFaults):
    """Faults of a laboratory that answers only while it is free."""

    def __init__(self) -> None:
        super().__init__()
        self.is_free = threading.Event()
        self.is_free.set()
        self.has_ended = False

    def is_armed(self, name):
        self.is_free.wait()
        if self.has_ended:
            raise NotConnectedError("nobody answers", device="simulated world")
        return super().is_armed(name)


@pytest.fixture
def shared():
    faults = Shared()
    yield faults
    faults.is_free.set()


def test_what_is_armed_is_known(shared):
    faults = PromptFaults(shared)
    faults.arm("camera.silent", times=1)
    # A busy computer may take longer than the patience; what is armed is known soon nevertheless.
    assert any(faults.is_armed("camera.silent") for _ in range(1000))
    assert faults.strike("camera.silent")
    assert not faults.strike("camera.silent")
    assert not all(faults.is_armed("camera.silent") for _ in range(1000))


def test_a_laboratory_that_is_busy_keeps_nobody_waiting(shared):
    faults = PromptFaults(shared)
    shared.arm("camera.held")
    assert any(faults.is_armed("camera.held") for _ in range(1000))
    shared.is_free.clear()
    shared.arm("camera.held", times=0)
    shared.arm("camera.gone")
    assert all(faults.is_armed("camera.held") for _ in range(100))
    assert not faults.is_armed("camera.gone")


def test_a_laboratory_that_has_ended_is_told(shared):
    faults = PromptFaults(shared)
    shared.has_ended = True
    with pytest.raises(NotConnectedError, match="nobody answers"):
        any(faults.is_armed("camera.gone") for _ in range(1000))


def test_the_camera_answers_while_the_laboratory_is_busy(camera, hosts, shared):
    shared.is_free.clear()
    host = hosts(camera(faults=PromptFaults(shared))).take_control()
    assert host.read(CCP) == 2


def test_every_fault_has_the_name_of_the_device():
    assert all(name.startswith("camera.") and what for name, what in FAULTS.items())
