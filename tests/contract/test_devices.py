"""Every installed device driver against the Protocol of its kind, in one file.

A driver belongs to the kind its name ends in: ``twin.robot`` is a robot. Drivers of real devices
talk to the simulators of a laboratory on the wire, which run as long as these tests. A rule that a
driver cannot keep is listed in ``EXCEPTED`` with the reason; the list is meant to shrink.
"""

import inspect
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from wire_laboratory import running, write_twin_rig, write_wire_rig

from tronlab.campaign.rig import load_rig
from tronlab.devices.protocols import Device, Diagnosable
from tronlab.devices.readings import (
    DeviceIdentity,
    Frame,
    PointReading,
    PoseReading,
    RobotReading,
    RoomReading,
)
from tronlab.devices.registry import (
    KINDS,
    DeviceContext,
    known_drivers,
    known_simulators,
    make_device,
)
from tronlab.errors import LimitError, NotConnectedError
from tronlab.geometry.poses import pose_along_boresight
from tronlab.terrain.heightmap import HeightMap
from tronlab.twin.world import WorldSetup

TWIN_YAML = Path(__file__).parents[2] / "campaigns" / "rigs" / "twin.yaml"

EXCEPTED = {
    "console.operator": {
        "before connect": "a person sits at the terminal whether or not anyone connected",
    },
}
"""Which rule a driver does not keep, and why."""

PROTOCOLS = {"kuka.robot by kvp": ("kuka.robot", "kvp")}
"""Drivers that speak more than one protocol, a second time."""

DRIVERS = sorted([*known_drivers(), *PROTOCOLS])


def kind_of(driver: str) -> str:
    driver, _ = PROTOCOLS.get(driver, (driver, ""))
    return driver.rsplit(".", 1)[-1]


def of_kind(kind: str) -> list[str]:
    return [driver for driver in DRIVERS if kind_of(driver) == kind]


@pytest.fixture(scope="module")
def rig():
    return load_rig(TWIN_YAML)


@pytest.fixture(autouse=True)
def _person_presses_enter(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("builtins.input", lambda _prompt: "")


@pytest.fixture(scope="module")
def wire_options(tmp_path_factory: pytest.TempPathFactory):
    """``wire_options(kind, protocol)`` starts the simulator once and gives its driver's options."""
    folder = tmp_path_factory.mktemp("wire")
    twin_path = write_twin_rig(folder)
    with ExitStack() as stack:

        @cache
        def options(kind: str, protocol: str) -> dict[str, Any]:
            (folder / f"{kind} {protocol}").mkdir()
            path = write_wire_rig(folder / f"{kind} {protocol}", twin_path, protocol=protocol)
            wire = stack.enter_context(running(path, twin_path, seed=1, only=(kind,)))
            return getattr(wire.rig.config.devices, kind).options

        yield options


@pytest.fixture
def make(rig, wire_options):
    """Make a device of a small laboratory: coarse camera, flat terrain."""
    made: list[Device] = []

    def make_one(driver: str, *, name: str = "thing") -> Device:
        kind = kind_of(driver)
        driver, protocol = PROTOCOLS.get(driver, (driver, "eki"))
        options = wire_options(kind, protocol) if driver in known_simulators() else {}
        spec = rig.config.laboratory
        camera = spec.camera.model_copy(
            update={"left_px": 648, "top_px": 480, "width_px": 64, "height_px": 48}
        )
        world = WorldSetup(
            config=rig.config.world,
            laboratory=spec.model_copy(update={"camera": camera}),
            load_heightmap=lambda: HeightMap(
                np.zeros((23, 43), np.float32), 0.1, np.array([0.0, 0.0, 0.0])
            ),
        )
        context = DeviceContext(name=name, options=options, seed=1, world=world)
        made.append(make_device(driver, kind, context))
        return made[-1]

    yield make_one
    for device in made:
        device.close()


@pytest.fixture
def target(rig):
    return rig.config.laboratory.mounting.nominal.robot_target(
        pose_along_boresight([1.1, 2.1, 2.0], boresight=[0, 0, -1], right=[0, 1, 0])
    )


def test_every_driver_of_the_wire_has_a_simulator_that_names_its_faults():
    wire = {driver for driver in known_drivers() if not driver.startswith(("twin.", "console."))}
    assert set(known_simulators()) == wire
    for driver, point in known_simulators().items():
        faults = point.load().FAULTS
        kind = kind_of(driver)
        assert faults
        assert all(name.startswith(f"{kind}.") and what for name, what in faults.items())


def test_the_list_of_exceptions_is_not_out_of_date():
    assert set(EXCEPTED) <= set(DRIVERS)


def test_every_kind_has_a_driver():
    assert {kind_of(driver) for driver in DRIVERS} == set(KINDS)


@pytest.mark.parametrize("driver", DRIVERS)
def test_driver_keeps_the_protocol_of_its_kind(driver: str, make):
    device = make(driver)
    protocol = KINDS[kind_of(driver)]
    assert isinstance(device, protocol)
    for name in dir(protocol):
        wanted = getattr(protocol, name)
        if name.startswith("_") or not callable(wanted):
            continue
        offered = getattr(type(device), name)
        assert inspect.signature(offered).parameters == inspect.signature(wanted).parameters, name
        assert inspect.getdoc(offered), name


@pytest.mark.parametrize("driver", DRIVERS)
def test_device_has_the_name_of_the_rig_file(driver: str, make):
    assert make(driver, name="the one on the left").name == "the one on the left"


@pytest.mark.parametrize("driver", DRIVERS)
def test_close_may_be_called_twice_and_before_connect(driver: str, make):
    device = make(driver)
    device.close()
    device.connect()
    device.close()
    device.close()


@pytest.mark.parametrize("driver", DRIVERS)
def test_device_can_be_connected_again(driver: str, make):
    device = make(driver)
    for _ in range(2):
        device.connect()
        device.identify()
        device.close()


@pytest.mark.parametrize("driver", DRIVERS)
def test_device_says_who_it_is_and_stays_it(driver: str, make):
    device = make(driver)
    device.connect()
    identity = device.identify()
    assert isinstance(identity, DeviceIdentity)
    assert identity.model
    assert device.identify() == identity


@pytest.mark.parametrize("driver", DRIVERS)
def test_a_device_that_says_its_state_says_it_in_words(driver: str, make):
    device = make(driver)
    if not isinstance(device, Diagnosable):
        assert driver.startswith(("twin.", "console.")), "a real device can say its state"
        return
    device.connect()
    facts = device.diagnose()
    assert facts
    assert all(isinstance(text, str) and text for text in facts.values())


@pytest.mark.parametrize("driver", DRIVERS)
def test_use_before_connect_names_device_and_call(driver: str, make):
    if "before connect" in EXCEPTED.get(driver, {}):
        pytest.skip(EXCEPTED[driver]["before connect"])
    with pytest.raises(NotConnectedError, match=r"^here: identify: "):
        make(driver, name="here").identify()


@pytest.mark.parametrize("driver", DRIVERS)
def test_use_after_close_names_device_and_call(driver: str, make):
    if "before connect" in EXCEPTED.get(driver, {}):
        pytest.skip(EXCEPTED[driver]["before connect"])
    device = make(driver, name="here")
    device.connect()
    device.close()
    with pytest.raises(NotConnectedError, match=r"^here: identify: "):
        device.identify()


@pytest.mark.parametrize("driver", of_kind("robot"))
def test_robot_stands_where_it_was_told(driver: str, make, target):
    robot = make(driver)
    robot.connect()
    robot.check(target)
    robot.move(target, timeout_s=120.0)
    reading = robot.read()
    assert isinstance(reading, RobotReading)
    assert reading.rail_m == pytest.approx(target.rail_m, abs=1e-3)
    np.testing.assert_allclose(
        reading.base_from_flange.translation, target.base_from_flange.translation, atol=1e-3
    )
    robot.stop()


@pytest.mark.parametrize("driver", of_kind("robot"))
def test_robot_refuses_what_it_cannot_reach_before_it_moves(driver: str, make, target):
    from dataclasses import replace

    robot = make(driver)
    robot.connect()
    robot.move(target, timeout_s=120.0)
    with pytest.raises(LimitError, match=r"allowed"):
        robot.move(replace(target, rail_m=1e3), timeout_s=60.0)
    assert robot.read().rail_m == pytest.approx(target.rail_m, abs=1e-3)


@pytest.mark.parametrize("driver", of_kind("tracker"))
def test_tracker_measures_points_and_poses_with_covariance(driver: str, make):
    tracker = make(driver)
    tracker.connect()
    assert isinstance(tracker.identify_target(), DeviceIdentity)
    point = tracker.measure_point("top_left", window_s=0.5)
    assert isinstance(point, PointReading)
    assert point.target == "top_left"
    assert point.p_trk_m.shape == (3,)
    assert np.linalg.eigvalsh(point.covariance_m2).min() > 0
    pose = tracker.measure_pose(window_s=0.5)
    assert isinstance(pose, PoseReading)
    assert pose.covariance.shape == (6, 6)
    assert np.linalg.eigvalsh(pose.covariance).min() > 0


@pytest.mark.parametrize("driver", of_kind("camera"))
@pytest.mark.parametrize(("pixel_format", "dtype"), [("Mono8", np.uint8), ("Mono12", np.uint16)])
def test_camera_gives_frames_as_configured(driver: str, make, pixel_format: str, dtype: type):
    camera = make(driver)
    camera.connect()
    camera.configure(exposure_s=0.01, gain_db=0.0, pixel_format=pixel_format)
    frame = camera.grab(timeout_s=5.0)
    assert isinstance(frame, Frame)
    assert (frame.pixel_format, frame.image.dtype) == (pixel_format, dtype)
    assert frame.image.ndim == 2
    assert frame.exposure_s == pytest.approx(0.01, rel=0.01)
    assert camera.grab(timeout_s=5.0).time_s > frame.time_s


@pytest.mark.parametrize("driver", of_kind("camera"))
def test_camera_refuses_a_format_it_has_not(driver: str, make):
    camera = make(driver)
    camera.connect()
    with pytest.raises(LimitError, match=r"allowed .*Mono8"):
        camera.configure(exposure_s=0.01, gain_db=0.0, pixel_format="Bayer")


@pytest.mark.parametrize("driver", of_kind("room"))
def test_room_switches_its_lamp(driver: str, make):
    room = make(driver)
    room.connect()
    for on in (False, True):
        room.switch_lamp(on=on)
        reading = room.read()
        assert isinstance(reading, RoomReading)
        assert reading.is_lamp_on is on


@pytest.mark.parametrize("driver", of_kind("operator"))
@pytest.mark.parametrize("task", ["place_board", "remove_board"])
def test_operator_does_every_task(driver: str, task: str, make):
    operator = make(driver)
    operator.connect()
    operator.perform(task)
