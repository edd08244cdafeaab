"""What ``tronlab rig check`` finds out."""

from collections.abc import Mapping
from typing import Any

import pytest

from tronlab.campaign.inspection import Finding, inspect_devices
from tronlab.devices.registry import KINDS, Devices
from tronlab.errors import NotConnectedError

DRIVERS = {kind: f"fake.{kind}" for kind in KINDS}


def inspect_all(devices: Devices) -> dict[str, Finding]:
    return {finding.name: finding for finding in inspect_devices(devices, drivers=DRIVERS)}


def test_every_device_says_who_it_is_and_is_closed_again(devices: Devices, laboratory: Any):
    findings = inspect_all(devices)
    assert list(findings) == list(KINDS)
    assert findings["camera"].facts == {
        "device": "Fake camera",
        "serial number": "1",
        "firmware": "not said",
    }
    assert findings["robot"].driver == "fake.robot"
    assert findings["robot"].driver_file.name == "conftest.py"
    assert laboratory.log.count("close camera") == 1


def test_nothing_is_moved_or_measured(devices: Devices, laboratory: Any):
    inspect_all(devices)
    assert {call.split()[0] for call in laboratory.log} == {"connect", "close"}


def test_all_failures_are_found_not_only_the_first(devices: Devices, laboratory: Any):
    gone = {name: NotConnectedError("connect: gone", device=name) for name in ("robot", "camera")}
    laboratory.failures = {(f"connect {name}", 1): error for name, error in gone.items()}
    findings = inspect_all(devices)
    assert {name: finding.error for name, finding in findings.items() if finding.error} == {
        "robot": "robot: connect: gone",
        "camera": "camera: connect: gone",
    }
    assert laboratory.log.count("close robot") == 1


def test_a_device_that_can_say_its_state_is_asked(
    devices: Devices, monkeypatch: pytest.MonkeyPatch
):
    def diagnose(_self: object) -> Mapping[str, str]:
        return {"mode": "AUT"}

    monkeypatch.setattr(type(devices.robot), "diagnose", diagnose, raising=False)
    assert inspect_all(devices)["robot"].facts["mode"] == "AUT"
