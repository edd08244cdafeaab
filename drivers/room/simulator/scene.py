"""What the simulated room is part of: a shared laboratory, or a small scene that stands still."""

from dataclasses import dataclass
from typing import Final, Literal, Protocol, TypeAlias

from tronlab.twin.world import World

Call: TypeAlias = Literal["read", "switch_lamp"]

FAULTS: Final = {
    "room.door_open": "the door input says open",
    "room.emergency_stop": "the emergency stop is pressed; the lamp goes dark",
    "room.over_temperature": "the lamp is too hot and goes dark",
    "room.silent": "the PLC does not answer",
    "room.disconnect": "the PLC closes every connection at its next request",
    "room.wrong_word_order": "32-bit values have their words in the other order",
    "room.heartbeat_stopped": "the PLC answers, but its heartbeat stands",
    "room.dimmer_silent": "the DMX widget neither answers nor dims",
    "room.supply_error": "the supply refuses its next setting with error -350",
    "room.supply_silent": "the supply neither answers nor switches",
    "room.air_silent": "the air sensor does not answer",
    "room.air_garbage": "the air sensor prints noise",
    "room.air_missing": "the air sensor prints stars for the temperature",
}


@dataclass(frozen=True, slots=True)
class RoomState:
    """Door and air as they are."""

    is_door_closed: bool = True
    air_temperature_k: float = 293.15
    air_pressure_pa: float = 101325.0
    relative_humidity: float = 0.45


class Scene(Protocol):
    """What the room's devices see and change."""

    def state(self) -> RoomState:
        """Get door and air now."""
        ...

    def set_lamp(self, level: float) -> None:
        """Let the lamp burn with this part of its full light; 0 is dark."""
        ...

    def begin(self, call: Call) -> None:
        """Tell that a driver begins a call, for faults that are scripted by its count.

        Raises:
            DeviceTimeoutError: Do not answer this time.
            DeviceFaultError: Report this fault.
        """
        ...


class StaticScene:
    """A room in which nothing changes but the lamp."""

    def __init__(self, state: RoomState | None = None) -> None:
        self._state = state or RoomState()
        self.lamp_level = 0.0

    def state(self) -> RoomState:
        """Get door and air."""
        return self._state

    def set_lamp(self, level: float) -> None:
        """Let the lamp burn."""
        self.lamp_level = level

    def begin(self, call: Call) -> None:
        """Do nothing: no faults are scripted here."""


class WorldScene:
    """The room of a simulated laboratory.

    Args:
        world: The laboratory.
        name: What errors of its script call the room.
    """

    def __init__(self, world: World, *, name: str) -> None:
        self._world = world
        self._name = name

    def state(self) -> RoomState:
        """Get door and air now."""
        state = self._world.state.read()
        return RoomState(
            is_door_closed=state.is_door_closed,
            air_temperature_k=state.air_temperature_k,
            air_pressure_pa=state.air_pressure_pa,
            relative_humidity=state.relative_humidity,
        )

    def set_lamp(self, level: float) -> None:
        """Let the lamp burn."""
        self._world.state.change(lamp_level=level)

    def begin(self, call: Call) -> None:
        """Count a call by the rig file's script."""
        self._world.faults.count("room", call, name=self._name)
