"""The lamp, and in which order what feeds it is switched."""

import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import ParamSpec

from drivers.room.dimmer import Dimmer
from drivers.room.plc import RoomPlc
from drivers.room.supply import Supply
from tronlab.errors import DeviceError, DeviceFaultError, NotConnectedError

P = ParamSpec("P")


class Lamp:
    """A lamp behind a contactor, with a supply and a dimmer if the room has them.

    On: supply, contactor, dimmer; off is the reverse, so that the contactor never carries the
    lamp's current when it moves. Neither ends halfway: where switching on fails the lamp is
    switched off again, and switching off goes on behind a part that failed.

    Args:
        plc: It has the contactor.
        supply: None if the lamp runs from the mains.
        dimmer: None if the lamp has no DMX.
        level: Of the full light, while on.
        settle_s: How long the light takes.
        device: Name of the device whose part it is.
    """

    def __init__(
        self,
        plc: RoomPlc,
        supply: Supply | None,
        dimmer: Dimmer | None,
        *,
        level: float,
        settle_s: float,
        device: str,
    ) -> None:
        self._plc = plc
        self._supply = supply
        self._dimmer = dimmer
        self._level = level
        self._settle_s = settle_s
        self._device = device
        self._is_wanted = False

    def forget(self) -> None:
        """Want nothing of it any more: after a time without connection nobody knows its state."""
        self._is_wanted = False

    def switch_on(self) -> None:
        """Have it burn steadily.

        Raises:
            DeviceFaultError: All was switched, yet it does not burn.
        """
        with ExitStack() as undo:
            if self._supply:
                undo.callback(_try, self._supply.switch, on=False)
                self._supply.switch(on=True)
            undo.callback(_try, self._plc.request_lamp, on=False)
            self._plc.request_lamp(on=True)
            if self._dimmer:
                undo.callback(_try, self._dimmer.set_level, 0.0)
                self._dimmer.set_level(self._level)
            time.sleep(self._settle_s)
            self._check_burning()
            undo.pop_all()
        self._is_wanted = True

    def switch_off(self) -> None:
        """Have it dark."""
        self._is_wanted = False
        with ExitStack() as steps:  # they run in reverse order, each even if another failed
            if self._supply:
                steps.callback(self._supply.switch, on=False)
            steps.callback(self._plc.request_lamp, on=False)
            if self._dimmer:
                steps.callback(self._dimmer.set_level, 0.0)
        time.sleep(self._settle_s)

    def look(self) -> bool:
        """Find out whether it burns.

        Raises:
            NotConnectedError: It was switched on, but the PLC has dropped the request since.
            DeviceFaultError: It was switched on, but went out.
        """
        if not self._is_wanted:
            return self.is_burning()
        if not self._plc.is_lamp_requested():
            raise NotConnectedError(
                "the PLC has let the lamp go dark: it missed this computer's heartbeat, or the"
                " cell was not safe; connect again and switch the lamp on",
                device=self._device,
            )
        self._check_burning()
        return True

    def _check_burning(self) -> None:
        if not self.is_burning():
            raise DeviceFaultError(
                "the lamp is switched on but does not burn; look after lamp and contactor",
                device=self._device,
                code=0,
            )

    def is_burning(self) -> bool:
        """Find out whether it burns: by the contactor, the supply's current and the level."""
        if self._dimmer and not self._dimmer.level:
            return False
        if not self._plc.is_lamp_requested():
            return False
        return self._supply is None or self._supply.is_burning()


def _try(action: Callable[P, None], *args: P.args, **kwargs: P.kwargs) -> None:
    """Undo a step; the error that made it necessary is the one to raise."""
    with suppress(DeviceError):
        action(*args, **kwargs)
