"""The simulated lamp: it burns when all that stands between it and the mains lets it."""

import threading

from drivers.room.simulator.scene import Scene


class SimulatedLamp:
    """A lamp behind contactor, supply output and dimmer, which are set from several threads.

    Args:
        scene: Where its light goes.
        has_supply: Without a supply it burns from the mains.
        has_dimmer: Without a dimmer it always has its full light.
    """

    def __init__(self, scene: Scene, *, has_supply: bool, has_dimmer: bool) -> None:
        self._scene = scene
        self._lock = threading.Lock()
        self._factors = {
            "contactor": 0.0,
            "plc": 1.0,
            "supply": 0.0 if has_supply else 1.0,
            "dimmer": 0.0 if has_dimmer else 1.0,
        }
        self._level = 0.0

    @property
    def level(self) -> float:
        """Get how much of its full light it gives."""
        return self._level

    def close_contactor(self, *, closed: bool) -> None:
        """Move the contactor."""
        self._set("contactor", float(closed))

    def dim_by_plc(self, level: float) -> None:
        """Set the level that the PLC asks for."""
        self._set("plc", level)

    def power(self, *, on: bool) -> None:
        """Switch the output of its supply."""
        self._set("supply", float(on))

    def dim(self, level: float) -> None:
        """Set its dimmer."""
        self._set("dimmer", level)

    def _set(self, what: str, factor: float) -> None:
        with self._lock:
            self._factors[what] = factor
            level = 1.0
            for each in self._factors.values():
                level *= each
            if level != self._level:
                self._scene.set_lamp(level)
                self._level = level  # not before: what the scene did not take is told it again
