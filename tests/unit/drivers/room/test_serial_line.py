"""Serial lines: settings, who may open them, and what becomes of late answers."""

import termios
import time
from pathlib import Path
from typing import Any

import pytest
import serial

from drivers.room.options import SerialOptions
from drivers.room.serial_line import SerialLine
from drivers.room.simulator.pty_device import PtyDevice
from tronlab.errors import AccessDeniedError, ConfigError, DeviceTimeoutError, NotConnectedError


class Echo:
    """Gives back what it gets."""

    def receive(self, data: bytes) -> bytes:
        return data

    def spontaneous(self) -> bytes:
        return b""


class Mute(Echo):
    """Gives nothing."""

    def receive(self, data: bytes) -> bytes:
        return b""


@pytest.fixture
def terminal(tmp_path: Path):
    terminal = PtyDevice(tmp_path / "port", Echo())
    yield terminal
    terminal.close()


@pytest.fixture
def options(tmp_path: Path) -> SerialOptions:
    return SerialOptions(path=str(tmp_path / "port"), timeout_s=1.0)


@pytest.fixture
def line(options: SerialOptions, terminal: PtyDevice):
    line = SerialLine(options, what="thing", device="here")
    line.open()
    yield line
    line.close()


def test_every_byte_passes_both_ways(line: SerialLine):
    line.write(bytes(range(256)))
    received = b""
    while len(received) < 256:
        received += line.read(until_s=line.deadline_s())
    assert received == bytes(range(256))


def test_lines_end_with_or_without_a_carriage_return(line: SerialLine):
    line.write(b"one\r\ntwo\nthr")
    assert line.read_line(until_s=line.deadline_s()) == b"one"
    assert line.read_line(until_s=line.deadline_s()) == b"two"
    line.write(b"ee\r\n")
    assert line.read_line(until_s=line.deadline_s()) == b"three"


def test_what_was_left_of_a_line_is_read_first(line: SerialLine):
    line.write(b"one\ntwo")
    assert line.read_line(until_s=line.deadline_s()) == b"one"
    received = b""
    while len(received) < 3:
        received += line.read(until_s=line.deadline_s())
    assert received == b"two"


def test_a_line_that_does_not_end_is_a_timeout_that_shows_it(line: SerialLine):
    line.write(b"half")
    with pytest.raises(DeviceTimeoutError, match=r"no answer from the thing .*only b'half'"):
        line.read_line(until_s=line.deadline_s())


def test_after_a_timeout_no_late_answer_is_taken(line: SerialLine):
    with pytest.raises(DeviceTimeoutError):
        line.read(until_s=time.monotonic())
    with pytest.raises(DeviceTimeoutError, match=r"call connect\(\) again"):
        line.write(b"next question")
    line.open()
    line.write(b"answer\n")
    assert line.read_line(until_s=line.deadline_s()) == b"answer"


def test_only_one_program_has_the_line(line: SerialLine, options: SerialOptions):
    second = SerialLine(options, what="thing", device="here")
    with pytest.raises(AccessDeniedError, match="another program has it"):
        second.open()


def test_a_line_that_has_come_is_read_even_after_its_time(line: SerialLine):
    line.write(b"one\ntwo\n")
    assert line.read_line(until_s=line.deadline_s()) == b"one"
    assert line.read_line(until_s=time.monotonic() - 1.0) == b"two"


def test_a_line_without_an_end_is_not_waited_for_for_ever(tmp_path: Path):
    chatter = Echo()
    chatter.spontaneous = lambda: b"x" * 1000
    terminal = PtyDevice(tmp_path / "chatter", chatter)
    line = SerialLine(SerialOptions(path=str(tmp_path / "chatter")), what="thing", device="here")
    try:
        line.open()
        with pytest.raises(DeviceTimeoutError, match="only b'xxx"):
            line.read_line(until_s=line.deadline_s())
    finally:
        line.close()
        terminal.close()


def test_an_unplugged_device_is_lost(line: SerialLine, terminal: PtyDevice):
    terminal.close()
    with pytest.raises(NotConnectedError, match="lost the thing at"):
        line.read_line(until_s=line.deadline_s())


def test_no_such_port(tmp_path: Path):
    line = SerialLine(SerialOptions(path=str(tmp_path / "no")), what="thing", device="here")
    with pytest.raises(NotConnectedError, match=r"here: cannot open the thing at .*/no"):
        line.open()
    line.close()


@pytest.mark.parametrize("error", [termios.error(22, "Invalid argument"), ValueError("baud")])
def test_settings_that_the_port_cannot_have_are_one_clear_error(
    options: SerialOptions, monkeypatch: pytest.MonkeyPatch, error: Exception
):
    def refuse(url: str, **settings: Any):
        raise error

    monkeypatch.setattr(serial, "serial_for_url", refuse)
    line = SerialLine(options, what="thing", device="here")
    with pytest.raises(NotConnectedError, match="check path, baud, data_bits, parity"):
        line.open()


def test_settings_of_the_options_reach_pyserial(monkeypatch: pytest.MonkeyPatch):
    asked: dict[str, Any] = {}

    def open_port(url: str, **settings: Any):
        asked.update(settings, url=url)
        raise serial.SerialException("not today")

    monkeypatch.setattr(serial, "serial_for_url", open_port)
    options = SerialOptions(
        path="socket://server:4001", baud=4800, data_bits=7, parity="even", stop_bits=2
    )
    with pytest.raises(NotConnectedError, match="not today"):
        SerialLine(options, what="thing", device="here").open()
    assert asked["url"] == "socket://server:4001"
    assert (asked["baudrate"], asked["bytesize"]) == (4800, serial.SEVENBITS)
    assert (asked["parity"], asked["stopbits"]) == (serial.PARITY_EVEN, serial.STOPBITS_TWO)
    assert asked["exclusive"] is True


def test_a_simulated_port_replaces_only_links(tmp_path: Path):
    path = tmp_path / "port"
    path.symlink_to("/dev/gone")
    PtyDevice(path, Mute()).close()
    assert not path.is_symlink()
    path.write_text("precious")
    with pytest.raises(ConfigError, match="exists and is no symbolic link"):
        PtyDevice(path, Mute())
    assert path.read_text() == "precious"


def test_a_simulated_port_makes_its_folder_where_it_can(tmp_path: Path):
    PtyDevice(tmp_path / "new" / "folder" / "port", Mute()).close()
    assert list((tmp_path / "new" / "folder").iterdir()) == []
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match=r"file/port: .* cannot be made here"):
        PtyDevice(tmp_path / "file" / "port", Mute())


def test_a_simulated_port_can_be_closed_twice(tmp_path: Path):
    terminal = PtyDevice(tmp_path / "port", Mute())
    terminal.close()
    terminal.close()
