"""The order in which the lamp is switched, and what happens where a step fails."""

from typing import cast

import pytest

from drivers.room.dimmer import Dimmer
from drivers.room.lamp import Lamp
from drivers.room.plc import RoomPlc
from drivers.room.supply import Supply
from tronlab.errors import DeviceFaultError, DeviceTimeoutError, NotConnectedError


class Parts:
    """PLC, supply and dimmer in one; they remember what they were told, and fail as told."""

    def __init__(self) -> None:
        self.steps: list[str] = []
        self.failing: set[str] = set()
        self.contactor = self.output = False
        self.draws_current = True
        self.level: float | None = None

    def _step(self, step: str) -> None:
        self.steps.append(step)
        if step in self.failing:
            raise DeviceTimeoutError(f"{step} failed", device="here")

    def request_lamp(self, *, on: bool) -> None:
        self._step(f"contactor {on}")
        self.contactor = on

    def is_lamp_requested(self) -> bool:
        return self.contactor

    def switch(self, *, on: bool) -> None:
        self._step(f"supply {on}")
        self.output = on

    def is_burning(self) -> bool:
        return self.output and self.draws_current

    def set_level(self, level: float) -> None:
        self._step(f"dimmer {level}")
        self.level = level


@pytest.fixture
def parts() -> Parts:
    return Parts()


def lamp_of(parts: Parts, *, has_supply: bool = True, has_dimmer: bool = True) -> Lamp:
    return Lamp(
        cast("RoomPlc", parts),
        cast("Supply", parts) if has_supply else None,
        cast("Dimmer", parts) if has_dimmer else None,
        level=0.8,
        settle_s=0.0,
        device="here",
    )


def test_on_is_supply_contactor_dimmer_and_off_the_reverse(parts: Parts):
    lamp = lamp_of(parts)
    lamp.switch_on()
    assert lamp.look()
    lamp.switch_off()
    assert not lamp.look()
    assert parts.steps == [
        *("supply True", "contactor True", "dimmer 0.8"),
        *("dimmer 0.0", "contactor False", "supply False"),
    ]


@pytest.mark.parametrize(
    ("has_supply", "has_dimmer"), [(False, False), (True, False), (False, True)]
)
def test_parts_that_are_not_there_are_not_needed(parts: Parts, has_supply: bool, has_dimmer: bool):
    lamp = lamp_of(parts, has_supply=has_supply, has_dimmer=has_dimmer)
    lamp.switch_on()
    assert lamp.look()
    lamp.switch_off()
    assert not lamp.look()


@pytest.mark.parametrize("step", ["supply True", "contactor True", "dimmer 0.8"])
def test_where_switching_on_fails_the_rest_is_switched_off(parts: Parts, step: str):
    parts.failing = {step}
    lamp = lamp_of(parts)
    with pytest.raises(DeviceTimeoutError, match=step):
        lamp.switch_on()
    assert not parts.contactor
    assert not parts.output
    assert not lamp.look()


def test_the_first_failure_is_the_one_to_know_even_if_undoing_fails(parts: Parts):
    parts.failing = {"dimmer 0.8", "dimmer 0.0", "contactor False", "supply False"}
    with pytest.raises(DeviceTimeoutError, match=r"dimmer 0\.8"):
        lamp_of(parts).switch_on()
    assert parts.steps[-3:] == ["dimmer 0.0", "contactor False", "supply False"]


def test_switching_off_goes_on_behind_a_part_that_failed(parts: Parts):
    lamp = lamp_of(parts)
    lamp.switch_on()
    parts.failing = {"dimmer 0.0"}
    with pytest.raises(DeviceTimeoutError):
        lamp.switch_off()
    assert not parts.contactor
    assert not parts.output


def test_a_lamp_that_draws_no_current_does_not_burn(parts: Parts):
    parts.draws_current = False
    with pytest.raises(DeviceFaultError, match="does not burn"):
        lamp_of(parts).switch_on()
    assert not parts.output


def test_a_lamp_that_went_out_is_an_error(parts: Parts):
    lamp = lamp_of(parts)
    lamp.switch_on()
    parts.draws_current = False
    with pytest.raises(DeviceFaultError, match="does not burn"):
        lamp.look()


def test_a_request_that_the_plc_dropped_is_an_error_until_it_is_forgotten(parts: Parts):
    lamp = lamp_of(parts)
    lamp.switch_on()
    parts.contactor = False
    with pytest.raises(NotConnectedError, match="connect again and switch the lamp on"):
        lamp.look()
    lamp.forget()
    assert not lamp.look()
