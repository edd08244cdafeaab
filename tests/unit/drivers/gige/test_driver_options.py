"""What a rig file may say about the camera, and what it is told when it may not."""

import sys

import pytest

from drivers.gige.driver import open_camera
from drivers.gige.options import CameraOptions, camera_address
from tronlab.devices.protocols import Camera
from tronlab.devices.registry import DeviceContext
from tronlab.errors import ConfigError


def context(**options: object) -> DeviceContext:
    return DeviceContext(name="camera", options=options, seed=0, world=None)


def test_factory_makes_a_camera_without_touching_the_network():
    pytest.importorskip("harvesters", reason="needs the extra 'lab'")
    camera = open_camera(context(address="192.0.2.1"))
    assert isinstance(camera, Camera)
    assert camera.name == "camera"


def test_missing_package_is_said_with_the_command_that_installs_it(
    monkeypatch: pytest.MonkeyPatch,
):
    for name in [name for name in sys.modules if name.startswith("drivers.gige.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "harvesters", None)
    monkeypatch.setitem(sys.modules, "harvesters.core", None)
    with pytest.raises(ConfigError, match=r"harvesters.*pip install 'tronlab\[lab\]'"):
        open_camera(context(address="192.0.2.1"))


def test_whole_sensor_of_a_camera_on_loopback_is_the_default():
    options = context(serial="02-2110A-06179").parse_options(CameraOptions)
    assert options.interfaces == ("lo",)
    assert options.region is None
    assert options.n_buffers == 16


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, r"exactly one of serial, address and model.*given: none"),
        ({"serial": "1", "model": "GC"}, r"exactly one.*given: serial, model"),
        ({"serial": ""}, r"options\.serial: .*at least 1 character"),
        ({"address": "here"}, r"options\.address: must be A\.B\.C\.D.*got 'here'"),
        ({"address": "10.0.0.1", "interfaces": ["eth1"]}, r"interfaces are not searched.*remove"),
        ({"model": "GC", "producer": "x.cti", "interfaces": ["eth1"]}, r"our own producer only"),
        ({"model": "GC", "interfaces": []}, r"options\.interfaces"),
        ({"model": "GC", "n_buffers": 1}, r"options\.n_buffers: .*got 1"),
        ({"model": "GC", "packet_size": 8228}, r"unknown key, did you mean packet_size_bytes"),
        (
            {"model": "GC", "region": {"left_px": 0, "top_px": 0, "width_px": 0, "height_px": 9}},
            r"options\.region\.width_px: .*got 0",
        ),
    ],
)
def test_wrong_option_is_named(options: dict[str, object], message: str):
    with pytest.raises(ConfigError, match=message):
        open_camera(context(**options))


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("127.0.0.1", ("127.0.0.1", 3956)),
        ("192.168.2.20:3956", ("192.168.2.20", 3956)),
        ("127.0.0.1:50123", ("127.0.0.1", 50123)),
    ],
)
def test_address_is_read(text: str, address: tuple[str, int]):
    assert camera_address(text) == address


@pytest.mark.parametrize(
    "text",
    ["", "1.2.3", "1.2.3.256", "1.2.3.4:", "1.2.3.4:0", "1.2.3.4:65536", "a.b.c.d", "1.2.3.٤"],
)
def test_what_is_no_address_is_refused(text: str):
    with pytest.raises(ValueError, match=r"A\.B\.C\.D:PORT"):
        camera_address(text)
