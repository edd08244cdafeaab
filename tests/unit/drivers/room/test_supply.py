"""The supply: what is said on the line, and what its answers mean."""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest

from drivers.room.options import SupplyOptions
from drivers.room.simulator.pty_device import PtyDevice
from drivers.room.supply import Supply
from tronlab.errors import DeviceFaultError, DeviceTimeoutError, LimitError, ProtocolError


class Script:
    """A supply that answers by a table, and remembers what it was told."""

    def __init__(self, answers: dict[str, str]) -> None:
        self.answers = answers
        self.told: list[str] = []
        self._pending = b""

    def receive(self, data: bytes) -> bytes:
        *lines, self._pending = (self._pending + data).split(b"\n")
        told = [line.decode() for line in lines]
        self.told += told
        return b"".join(f"{self.answers[line]}\r\n".encode() for line in told if "?" in line)

    def spontaneous(self) -> bytes:
        return b""


GOOD = {
    "*IDN?": "HEWLETT-PACKARD,E3632A,0,1.1-5.0-1.0",
    "SYST:ERR?": '+0,"No error"',
    "VOLT?": "+2.40000000E+01",
    "CURR?": "+5.00000000E+00",
    "OUTP?": "1",
    "MEAS:CURR?": "+4.98000000E+00",
}


@pytest.fixture
def connect(tmp_path: Path):
    """Give a connected supply whose other end answers like this."""
    with ExitStack() as stack:

        def make(script: Script, **options: float) -> Supply:
            terminal = PtyDevice(tmp_path / "supply", script)
            stack.callback(terminal.close)
            values = {"voltage_v": 24.0, "current_a": 5.0, "timeout_s": 3.0} | options
            path = str(tmp_path / "supply")
            supply = Supply(SupplyOptions.model_validate({"path": path} | values), device="here")
            stack.callback(supply.close)
            supply.connect()
            return supply

        yield make


Connect = Callable[..., Supply]


def test_takes_over_control_first_and_reads_errors_after_every_setting(connect: Connect):
    script = Script(GOOD)
    connect(script).switch(on=True)
    assert script.told == [
        "SYST:REM",
        "*CLS",
        "*IDN?",
        "VOLT 24.0000",
        "SYST:ERR?",
        "VOLT?",
        "CURR 5.0000",
        "SYST:ERR?",
        "CURR?",
        "OUTP ON",
        "SYST:ERR?",
        "OUTP?",
    ]


def test_identity_of_a_real_e3632a(connect: Connect):
    identity = connect(Script(GOOD)).identify()
    assert (identity.maker, identity.model, identity.serial) == ("HEWLETT-PACKARD", "E3632A", "")


@pytest.mark.parametrize(
    ("query", "answer", "kind", "message"),
    [
        ("SYST:ERR?", '-222,"Data out of range"', LimitError, r"VOLT 24\.0000 .*supply\.voltage_v"),
        ("SYST:ERR?", '-350,"Too many errors"', DeviceFaultError, "error -350, Too many errors"),
        ("SYST:ERR?", '+601,"Front panel"', DeviceFaultError, "error 601"),
        ("SYST:ERR?", "what?", ProtocolError, "expected NUMBER"),
        ("VOLT?", "+1.20000000E+01", DeviceFaultError, "told VOLT 24, but has 12"),
        ("CURR?", "five", ProtocolError, "expected a number"),
        ("OUTP?", "0", DeviceFaultError, "output is not on"),
        ("OUTP?", "2", ProtocolError, "expected 0 or 1"),
    ],
)
def test_what_is_wrong_is_named(
    connect: Connect, query: str, answer: str, kind: type, message: str
):
    script = Script(GOOD)
    supply = connect(script)
    script.answers = GOOD | {query: answer}
    with pytest.raises(kind, match=message) as caught:
        supply.switch(on=True)
    if isinstance(caught.value, DeviceFaultError) and query == "SYST:ERR?":
        assert str(caught.value.code) in answer


def test_an_identity_that_is_none_is_refused(connect: Connect):
    with pytest.raises(ProtocolError, match="four fields"):
        connect(Script(GOOD | {"*IDN?": "hello"}))


@pytest.mark.parametrize(
    ("output", "current", "burns"),
    [("1", "4.98", True), ("1", "0.01", False), ("0", "4.98", False)],
)
def test_a_lamp_burns_if_it_draws_its_current(
    connect: Connect, output: str, current: str, burns: bool
):
    supply = connect(Script(GOOD | {"OUTP?": output, "MEAS:CURR?": current}))
    assert supply.is_burning() is burns


def test_simulated_supply_refuses_what_it_cannot_give(lab):
    options = lab.options.supply.model_copy(update={"voltage_v": 31.0})
    supply = Supply(options, device="here")
    supply.connect()
    try:
        with pytest.raises(LimitError, match=r"-222, Data out of range\); lower supply\.voltage_v"):
            supply.switch(on=True)
        assert not supply.is_output_on()
    finally:
        supply.close()


def test_a_silent_supply_is_a_timeout(lab, faults):
    faults.arm("room.supply_silent")
    supply = Supply(lab.options.supply, device="here")
    with pytest.raises(DeviceTimeoutError, match="no answer from the supply"):
        supply.connect()
    supply.close()
