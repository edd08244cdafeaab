"""What the driver makes of registers that the simulated PLC never has."""

import struct

import pytest

from drivers.room.options import PlcOptions
from drivers.room.plc import RoomPlc
from tronlab.errors import DeviceFaultError, NotReadyError, ProtocolError


def words(value: float) -> list[int]:
    return list(struct.unpack(">HH", struct.pack(">f", value)))


class Registers:
    """A link to a device with these input registers."""

    last_exchange = (b"\x01", b"\x02")

    def __init__(self) -> None:
        self.input = [1, 0, 1, 0] + [0] * 38
        self.input[10:16] = words(20.0) + words(1013.0) + words(40.0)
        self.input[40:42] = words(123456.0)

    def open(self) -> None: ...

    def close(self) -> None: ...

    def read_input_registers(self, address: int, count: int) -> list[int]:
        return self.input[address : address + count]


@pytest.fixture
def registers() -> Registers:
    return Registers()


@pytest.fixture
def plc(registers: Registers, monkeypatch: pytest.MonkeyPatch) -> RoomPlc:
    plc = RoomPlc(PlcOptions(host="x"), device="here")
    monkeypatch.setattr(plc, "_link", registers)
    return plc


def test_an_error_code_is_carried_through(plc: RoomPlc, registers: Registers):
    registers.input[3] = 4711
    with pytest.raises(DeviceFaultError, match="the PLC reports an error") as caught:
        plc.check_ready()
    assert caught.value.code == 4711


def test_a_plc_that_starts_is_not_ready(plc: RoomPlc, registers: Registers):
    plc.check_ready()
    registers.input[2] = 0
    with pytest.raises(NotReadyError, match="the PLC is starting"):
        plc.check_ready()


def test_a_state_of_its_own_is_no_error(plc: RoomPlc, registers: Registers):
    registers.input[2] = 77
    plc.check_ready()
    assert plc.status().state == 77


def test_another_version_of_the_map_is_refused(plc: RoomPlc, registers: Registers):
    registers.input[0] = 2
    with pytest.raises(ProtocolError, match="version 2 of the register map, this driver knows 1"):
        plc.connect()


def test_a_constant_that_fits_no_word_order_is_another_map(plc: RoomPlc, registers: Registers):
    registers.input[40:42] = [1, 2]
    with pytest.raises(ProtocolError, match="the PLC's program has another register map"):
        plc.connect()


@pytest.mark.parametrize(
    ("address", "value", "message"),
    [
        (10, float("nan"), "temperature is nan degrees Celsius, expected -40 to 60"),
        (12, 1.0132e5, "pressure is 101320 hPa"),
        (14, -1.0, "relative humidity is -1 per cent"),
    ],
)
def test_air_that_no_room_has_is_a_fault(
    plc: RoomPlc, registers: Registers, address: int, value: float, message: str
):
    registers.input[address : address + 2] = words(value)
    registers.input[3] = 12
    with pytest.raises(DeviceFaultError, match=f"the PLC's air sensor: {message}") as caught:
        plc.read_air()
    assert caught.value.code == 12


def test_uptime_is_unsigned(plc: RoomPlc, registers: Registers):
    registers.input[30:32] = [0xFFFF, 0xFFFE]
    assert plc.uptime_s() == 2**32 - 2
