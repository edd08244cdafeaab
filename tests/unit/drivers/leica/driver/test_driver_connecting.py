"""Connecting to a scripted peer: what is set, who is refused, which air is used."""

import socket
import struct

import pytest

from drivers.leica.driver import LeicaTracker, open_tracker
from tronlab.devices.readings import AirReading
from tronlab.devices.registry import DeviceContext
from tronlab.errors import (
    AccessDeniedError,
    ConfigError,
    DeviceFaultError,
    LimitError,
    NotConnectedError,
    NotReadyError,
)

START = 49
CHANGE_FACE = 53
POINT_LASER = 58
FIND = 63
SET_STATISTICS = 80
SYSTEM_STATUS = 1
SET_UNITS = 5
INITIALIZE = 7
STATION = 12
TRANSFORMATION = 14
SET_AIR = 20
SET_CS = 26
GET_REFLECTORS = 42
SET_SETTINGS = 47
CHECK_BIRDBATH = 87
SET_LONG = 120
METEO = 139
EVERYTHING = 0xFFFFF


def test_connecting_sets_what_measurements_rely_on_and_moves_nothing(peer, tracker: LeicaTracker):
    assert peer.last(SET_UNITS) == struct.pack("<5I", 0, 0, 0, 0, 0)
    assert peer.last(SET_CS) == struct.pack("<I", 0)
    assert peer.last(STATION) == struct.pack("<6d", *[0.0] * 6)
    assert peer.last(TRANSFORMATION) == struct.pack("<7d", *[0.0] * 6, 1.0)
    assert peer.last(SET_STATISTICS) == struct.pack("<2I", 1, 0)
    assert peer.last(SET_LONG) == struct.pack("<Ii", 52, 1)
    # weather 2, no transformation, no orientation, keep position, messages, no stream, no try mode
    assert peer.last(SET_SETTINGS) == struct.pack("<9I", 2, 0, 0, 1, 1, 0, 0, 1, 0)
    assert not peer.told(INITIALIZE, POINT_LASER, FIND, CHANGE_FACE, CHECK_BIRDBATH, START)


def test_identity_is_read_from_the_tracker(tracker: LeicaTracker):
    identity = tracker.identify()
    assert (identity.maker, identity.model, identity.serial) == ("Leica", "AT901-MR", "2345")
    assert identity.firmware == "2.19 (emScon 3.6.412)"


def test_state_is_read_from_the_tracker(peer, tracker: LeicaTracker):
    peer.tracker_status = 3
    state = tracker.status()
    assert (state.tracker, state.face, state.system.processor) == (3, 1, 5)
    assert state.ready == EVERYTHING


def test_use_before_connect_names_device_and_call(make):
    with pytest.raises(NotConnectedError, match=r"^here: identify: not connected; call connect"):
        make("here").identify()


def test_nobody_listening_is_not_connected(make):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    with pytest.raises(NotConnectedError, match=rf"connect: 127.0.0.1:{port} cannot be reached"):
        make(port=port).connect()


def test_a_second_client_is_told_who_holds_the_tracker(peer, make):
    peer.greeting = peer.error(64, 10011)
    with pytest.raises(AccessDeniedError, match=r"connect: .*another client holds .*10011"):
        make().connect()


def test_a_second_client_that_is_told_by_a_reply(peer, make):
    peer.answers[SYSTEM_STATUS] = peer.reply(SYSTEM_STATUS, status=10011)
    with pytest.raises(AccessDeniedError, match="another client"):
        make().connect()


def test_a_second_client_whose_connection_is_closed_at_once(peer, make):
    peer.hangs_up_at_once = True
    with pytest.raises(AccessDeniedError, match="closed the connection at once"):
        make().connect()


def test_failed_connect_leaves_no_connection_and_can_be_repeated(peer, make):
    tracker = make()
    peer.answers[SET_UNITS] = peer.reply(SET_UNITS, status=36)
    with pytest.raises(DeviceFaultError) as fault:
        tracker.connect()
    assert fault.value.code == 36
    with pytest.raises(NotConnectedError):
        tracker.identify()
    del peer.answers[SET_UNITS]
    tracker.connect()
    assert tracker.identify().serial == "2345"


@pytest.mark.parametrize(
    ("laser", "expected", "code"), [(2, NotReadyError, 10012), (5, DeviceFaultError, 5)]
)
def test_a_laser_that_is_not_ready_refuses_the_connection(
    peer, make, laser: int, expected: type[DeviceFaultError], code: int
):
    peer.answers[SYSTEM_STATUS] = peer.reply(
        SYSTEM_STATUS, struct.pack("<IIIIiiiIii", 0, 5, laser, 2, 3, 6, 412, 2, 0, 2345)
    )
    with pytest.raises(expected, match=r"connect: the laser") as refusal:
        make().connect()
    assert refusal.value.code == code


def test_a_booting_tracker_is_not_ready(peer, make):
    peer.answers[SYSTEM_STATUS] = peer.reply(
        SYSTEM_STATUS, struct.pack("<IIIIiiiIii", 0, 1, 3, 2, 3, 6, 412, 2, 0, 2345)
    )
    with pytest.raises(NotReadyError, match="boots"):
        make().connect()


def test_reflector_type_that_the_tracker_has_not_is_found_at_connect(peer, make):
    peer.answers[GET_REFLECTORS] = peer.reflector_list((4, "RRR-0.5in"))
    with pytest.raises(LimitError, match=r"'CCR-1.5in' in the tracker's list; it has: RRR-0.5in"):
        make().connect()


def test_empty_list_of_reflectors_is_no_wait(peer, make):
    peer.answers[GET_REFLECTORS] = peer.reply(GET_REFLECTORS, bytes(84))
    with pytest.raises(LimitError, match="it has: none"):
        make().connect()


def test_options_are_checked_without_a_network():
    options = {"host": "h", "reflectors": {}, "tmac": {"p_trk_m": [0, 0, 1]}, "prot": 700}
    with pytest.raises(ConfigError, match=r"tracker\.options\.prot: .*did you mean port"):
        open_tracker(DeviceContext(name="tracker", options=options, seed=0, world=None))


def test_without_weather_station_the_air_must_be_given(peer, make):
    peer.answers[METEO] = peer.reply(METEO, struct.pack("<I64sii", 0, b"", 0, 0))
    with pytest.raises(DeviceFaultError, match="no weather station; connect it or give") as fault:
        make().connect()
    assert fault.value.code == 27


def test_air_given_by_hand_switches_the_monitor_off(peer, make):
    air = {"temperature_k": 294.65, "pressure_pa": 98_700.0, "relative_humidity": 0.41}
    tracker = make(air=air)
    tracker.connect()
    assert peer.last(SET_SETTINGS)[:4] == struct.pack("<I", 0)
    assert struct.unpack("<3d", peer.last(SET_AIR)) == pytest.approx((21.5, 987.0, 41.0))
    tracker.set_environment(AirReading(293.15, 100_000.0, 0.5))
    assert struct.unpack("<3d", peer.last(SET_AIR)) == pytest.approx((20.0, 1000.0, 50.0))


def test_air_that_the_station_measures_is_not_overwritten(peer, tracker: LeicaTracker):
    with pytest.raises(LimitError, match=r"set_environment: .*weather station"):
        tracker.set_environment(AirReading(293.15, 100_000.0, 0.5))
    assert not peer.told(SET_AIR)


def test_weather_is_in_si_units(tracker: LeicaTracker):
    air = tracker.weather()
    assert air.temperature_k == pytest.approx(294.65)
    assert air.pressure_pa == pytest.approx(98_750.0)
    assert air.relative_humidity == pytest.approx(0.44)
