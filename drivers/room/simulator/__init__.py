"""Simulator of the room: a PLC on Modbus TCP, and serial devices on pseudo-terminals."""

from drivers.room.simulator.scene import FAULTS

__all__ = ["FAULTS"]
