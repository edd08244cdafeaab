import pytest

from tronlab.devices.console import ConsoleOperator
from tronlab.devices.registry import (
    DeviceContext,
    Devices,
    connected,
    known_drivers,
    make_device,
)
from tronlab.errors import ConfigError, NotConnectedError


def context(name="operator"):
    return DeviceContext(name=name, options={}, seed=0, world=None)


class FakeDevice:
    def __init__(self, name, failure=None):
        self.name, self.failure, self.calls = name, failure, []

    def connect(self):
        self.calls.append("connect")
        if self.failure:
            raise self.failure

    def close(self):
        self.calls.append("close")


def fake_rig(**failures):
    names = ("robot", "tracker", "camera", "room", "operator")
    return Devices(*(FakeDevice(name, failures.get(name)) for name in names))


def test_the_built_in_drivers_are_found():
    assert {"twin.robot", "twin.tracker", "twin.camera", "console.operator"} <= set(known_drivers())


def test_a_driver_is_made_by_name():
    assert isinstance(make_device("console.operator", "operator", context()), ConsoleOperator)


def test_an_unknown_driver_is_an_error_that_lists_the_known_ones():
    with pytest.raises(ConfigError, match=r"devices.robot.driver: no driver 'kuka'; .*twin.robot"):
        make_device("kuka", "robot", context("robot"))


def test_a_driver_of_another_kind_is_refused():
    with pytest.raises(ConfigError, match=r"'console\.operator' is not a Robot"):
        make_device("console.operator", "robot", context("robot"))


def test_devices_of_one_rig_share_what_the_first_made():
    rig = context()
    assert rig.share("world", lambda: [1]) is rig.share("world", lambda: [2])


def test_connecting_closes_every_device_afterwards():
    rig = fake_rig()
    with connected(rig):
        pass
    assert all(device.calls == ["connect", "close"] for device in rig.all())


def test_every_device_that_fails_is_named_and_all_are_closed():
    rig = fake_rig(
        tracker=NotConnectedError("no answer", device="tracker"),
        room=NotConnectedError("no answer", device="room"),
    )
    with pytest.raises(ExceptionGroup, match="2 of 5 devices") as caught, connected(rig):
        pass
    assert [error.device for error in caught.value.exceptions] == ["tracker", "room"]
    assert all("close" in device.calls for device in rig.all())


def test_the_operator_at_the_console_is_asked_and_waited_for(monkeypatch):
    asked = []
    monkeypatch.setattr("builtins.input", asked.append)
    ConsoleOperator(context()).perform("place_board")
    assert "calibration board" in asked[0]
