"""The air sensor's line: every form it may have, and what it must not be taken for."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.room.air import AirSensor, MissingValueError, air_reading, parse_air
from drivers.room.simulator.ptu300 import Ptu300
from drivers.room.simulator.pty_device import PtyDevice
from drivers.room.simulator.scene import RoomState
from tronlab.errors import DeviceTimeoutError, NotReadyError, ProtocolError

MANUAL = "P= 1013.2 hPa T= 31.1 'C RH= 38.3 %RH"
"""As the PTU300 manual prints it."""


def test_line_of_the_manual():
    reading = parse_air(MANUAL)
    assert reading.pressure_pa == pytest.approx(101320.0)
    assert reading.temperature_k == pytest.approx(304.25)
    assert reading.relative_humidity == pytest.approx(0.383)


@pytest.mark.parametrize(
    "line",
    [
        ">" + MANUAL,
        "P1= 1008.9 hPa P2= 1009.1 hPa P= 1013.2 hPa T= 31.1 'C RH= 38.3 %RH",
        "RH=38.3%RH T=31.1'C P=1013.2hPa",
        "P= 1013.2 hPa Tdf= 12.0 'C T= +31.1 'C RH=\t38.3 %RH",
    ],
)
def test_other_quantities_spaces_and_order_do_not_matter(line: str):
    assert parse_air(line) == parse_air(MANUAL)


@settings(deadline=None)
@given(
    pressure=st.floats(500.0, 1100.0),
    temperature=st.floats(-40.0, 60.0),
    humidity=st.floats(0.0, 100.0),
    gap=st.text(" ", max_size=3),
)
def test_every_reading_survives_being_printed(
    pressure: float, temperature: float, humidity: float, gap: str
):
    line = f"P={gap}{pressure:.1f} hPa T={gap}{temperature:.1f} 'C RH={gap}{humidity:.1f} %RH"
    reading = parse_air(line)
    assert reading.pressure_pa == pytest.approx(100.0 * pressure, abs=5.1)
    assert reading.temperature_k == pytest.approx(temperature + 273.15, abs=0.051)
    assert reading.relative_humidity == pytest.approx(humidity / 100.0, abs=0.00051)


@settings(deadline=None)
@given(st.text(max_size=80))
def test_no_text_is_taken_for_air(text: str):
    with pytest.raises(ValueError, match=r"P|T|RH"):
        parse_air(text)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (MANUAL.replace("'C", "'F"), "T is in 'F, expected 'C"),
        (MANUAL.replace("hPa", "inHg"), "P is in inHg, expected hPa"),
        (MANUAL.replace("31.1", "81.1"), "temperature is 81.1 degrees Celsius, expected -40 to 60"),
        (MANUAL.replace("1013.2", "13.2"), "pressure is 13.2 hPa"),
        (MANUAL.replace("38.3", "138.3"), "relative humidity is 138.3 per cent"),
        (MANUAL[:24], "no 'RH= NUMBER %RH'"),
        (MANUAL.replace("31.1", "nan"), "no 'T= NUMBER 'C'"),
    ],
)
def test_what_is_wrong_is_said(line: str, message: str):
    with pytest.raises(ValueError, match=message) as caught:
        parse_air(line)
    assert not isinstance(caught.value, MissingValueError)


@pytest.mark.parametrize("stars", ["*", "****", "****.*"])
@pytest.mark.parametrize(("number", "name"), [("1013.2", "P"), ("31.1", "T"), ("38.3", "RH")])
def test_stars_are_a_missing_value(stars: str, number: str, name: str):
    with pytest.raises(MissingValueError, match=rf"^{name} is missing"):
        parse_air(MANUAL.replace(number, stars))


def test_nan_is_no_air():
    with pytest.raises(ValueError, match="temperature is nan"):
        air_reading(temperature_c=float("nan"), pressure_hpa=1000.0, humidity_pct=40.0)


@pytest.fixture
def sensor(lab):
    sensor = AirSensor(lab.options.air, device="here")
    yield sensor
    sensor.close()


def test_reads_what_the_room_has(sensor: AirSensor):
    sensor.connect()
    reading = sensor.read()
    assert reading.temperature_k == pytest.approx(293.15, abs=0.05)
    assert reading.pressure_pa == pytest.approx(101325.0, abs=5.1)
    assert reading.relative_humidity == pytest.approx(0.45, abs=0.0005)


@pytest.mark.parametrize(
    ("fault", "kind", "message"),
    [
        ("room.air_silent", DeviceTimeoutError, "no answer from the air sensor"),
        ("room.air_garbage", ProtocolError, "restore its format with the command 'form /'"),
        ("room.air_missing", NotReadyError, "T is missing"),
    ],
)
def test_faults_are_named(sensor: AirSensor, faults, fault: str, kind: type, message: str):
    sensor.connect()
    faults.arm(fault)
    with pytest.raises(kind, match=message):
        sensor.read()
    faults.arm(fault, times=0)
    sensor.connect()
    assert sensor.read().relative_humidity == pytest.approx(0.45)


def test_a_sensor_without_a_value_can_be_connected(sensor: AirSensor, faults):
    faults.arm("room.air_missing")
    sensor.connect()
    faults.arm("room.air_missing", times=0)
    assert sensor.read().temperature_k == pytest.approx(293.15, abs=0.05)


def test_a_sensor_left_in_run_mode_is_stopped(lab, faults, tmp_path):
    running = Ptu300(RoomState, faults, is_running=True, interval_s=0.0)
    terminal = PtyDevice(tmp_path / "running", running)
    sensor = AirSensor(
        lab.options.air.model_copy(update={"path": str(tmp_path / "running")}), device="here"
    )
    try:
        sensor.connect()
        readings = [sensor.read() for _ in range(3)]
        assert running.spontaneous() == b""
    finally:
        sensor.close()
        terminal.close()
    assert readings[0] == readings[1] == readings[2]
