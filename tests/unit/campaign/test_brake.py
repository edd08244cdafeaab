import threading
from typing import Any

from tronlab.campaign.brake import Brake
from tronlab.devices.registry import Devices
from tronlab.errors import NotConnectedError


def test_the_robot_is_stopped_as_often_as_wished_before_the_brake_is_left(
    devices: Devices, laboratory: Any
) -> None:
    with Brake(devices.robot, warn=laboratory.log.append) as brake:
        brake.pull()
        brake.pull()
    assert laboratory.log == ["stop", "stop"]


def test_a_brake_nobody_pulls_stops_nothing(devices: Devices, laboratory: Any) -> None:
    with Brake(devices.robot, warn=laboratory.log.append):
        pass
    assert laboratory.log == []


def test_a_robot_that_cannot_be_stopped_is_told_of_and_stopped_again(
    devices: Devices, laboratory: Any
) -> None:
    laboratory.failures = {("stop", 1): NotConnectedError("stop: not connected", device="robot")}
    with Brake(devices.robot, warn=laboratory.log.append) as brake:
        brake.pull()
        brake.pull()
    assert laboratory.log == [
        "stop",
        "robot: stop: not connected; see whether the robot stands still, and press the emergency"
        " stop if not",
        "stop",
    ]


def test_nobody_waits_for_ever_for_a_robot_that_does_not_answer(
    devices: Devices, laboratory: Any
) -> None:
    answers = threading.Event()
    laboratory.on_call = lambda call: answers.wait(timeout=60)
    told: list[str] = []
    with Brake(devices.robot, warn=told.append, patience_s=0.05) as brake:
        brake.pull()
    answers.set()
    assert told == [
        "robot: did not answer to stop within 0.05 s; see whether it stands still, and press the"
        " emergency stop if not"
    ]
