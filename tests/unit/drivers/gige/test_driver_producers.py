"""Addresses of cameras as vendors' producers say them, with interfaces that exist only here."""

from types import SimpleNamespace

import pytest

pytest.importorskip("harvesters", reason="needs the extra 'lab'")

from genicam import gentl

from drivers.gige.producers import _address_of


class Interface:
    """The node map of an interface (GenTL SFNC): DeviceSelector chooses whom the rest is about."""

    def __init__(self, cameras: dict[str, int]) -> None:
        self._cameras = list(cameras.items())
        self.DeviceSelector = SimpleNamespace(value=0, min=0, max=len(cameras) - 1)

    def has_node(self, name: str) -> bool:
        return name in {"DeviceSelector", "DeviceID", "GevDeviceIPAddress"}

    @property
    def DeviceID(self) -> SimpleNamespace:  # noqa: N802
        return SimpleNamespace(value=self._cameras[self.DeviceSelector.value][0])

    @property
    def GevDeviceIPAddress(self) -> SimpleNamespace:  # noqa: N802
        return SimpleNamespace(value=self._cameras[self.DeviceSelector.value][1])


class Unwilling(Interface):
    @property
    def GevDeviceIPAddress(self) -> SimpleNamespace:  # noqa: N802
        raise gentl.NotImplementedException("no addresses here")


def info_of(device_id: str, node_map: object) -> SimpleNamespace:
    return SimpleNamespace(id_=device_id, parent=SimpleNamespace(node_map=node_map))


CAMERAS = {"left": 0xC0A80214, "right": 0xC0A80215}


@pytest.mark.parametrize(
    ("device_id", "address"), [("left", "192.168.2.20"), ("right", "192.168.2.21"), ("else", "")]
)
def test_address_is_read_from_the_interface(device_id: str, address: str):
    assert _address_of(info_of(device_id, Interface(CAMERAS))) == address


@pytest.mark.parametrize("node_map", [None, Unwilling(CAMERAS)])
def test_producer_that_says_no_addresses_is_no_error(node_map: object):
    assert _address_of(info_of("left", node_map)) == ""
