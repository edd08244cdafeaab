"""Splits, silence, nonsense, lost connections and threads."""

import contextlib
import struct
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from drivers.leica.driver import LeicaTracker
from drivers.leica.notices import Notice
from tronlab.errors import (
    AccessDeniedError,
    DeviceError,
    DeviceFaultError,
    DeviceTimeoutError,
    NotConnectedError,
    ProtocolError,
)

START = 49
STOP = 52
GET_AIR = 21
GET_REFLECTOR = 41
GET_REFLECTORS = 42
FIND = 63
GET_FACE = 98
GET_PROBES = 103


def test_events_between_request_and_reply_are_kept(peer, make):
    told: list[int] = []
    tracker = make()
    tracker = LeicaTracker("tracker", tracker._options, on_notice=lambda n: told.append(n.code))
    tracker.connect()
    live = struct.pack("<iII3d", 36, 7, 0, 1.0, 2.0, 3.0)
    peer.answers[START] = (
        peer.event(17)
        + live
        + peer.reply(START)
        + peer.event(26)
        + live
        + peer.pose()
        + peer.event(31_000)
    )
    tracker.measure_pose(window_s=0.1)
    while len(told) < 3:
        tracker.notices()
    assert told == [17, 26, 31_000]
    tracker.close()


def test_notices_name_events_and_errors(peer, tracker: LeicaTracker):
    peer.say(peer.event(27) + peer.error(64, 701) + peer.event(4711) + peer.error(64, 4712))
    notices: list[Any] = []
    while len(notices) < 4:
        notices += tracker.notices()
    assert [(n.is_error, n.code) for n in notices] == [
        *((False, 27), (True, 701), (False, 4711), (True, 4712))
    ]
    assert [n.text for n in notices[:3]] == ["ready", "the beam is broken", "event 4711"]
    assert tracker.notices() == ()


def test_answers_survive_being_split_into_single_bytes(peer, tracker: LeicaTracker):
    def in_pieces(data: bytes) -> Callable[[bytes], None]:
        def send(_: bytes) -> None:
            for i in range(len(data)):
                peer.say(data[i : i + 1])

        return send

    peer.answers[START] = in_pieces(
        peer.event(26) + peer.reply(START) + peer.event(27) + peer.pose()
    )
    peer.answers[GET_REFLECTOR] = in_pieces(peer.reply(GET_REFLECTOR, struct.pack("<i", 7)))
    reading = tracker.measure_pose(window_s=0.1)
    np.testing.assert_array_equal(reading.trk_from_tmac.translation, peer.p_tmac)
    tracker.select_reflector("CCR-1.5in")


def test_result_of_an_earlier_measurement_is_not_taken_for_the_next(peer, tracker: LeicaTracker):
    tracker.measure_pose(window_s=0.1)
    peer.say(peer.pose((9.0, 9.0, 9.0)) + peer.event(27))
    while not tracker.notices():
        pass
    assert tracker.measure_pose(window_s=0.1).trk_from_tmac.translation[0] == peer.p_tmac[0]


@pytest.mark.parametrize("command", [GET_AIR, START])
def test_silence_is_a_timeout_and_closes_the_connection(peer, tracker: LeicaTracker, command: int):
    peer.answers[command] = None
    with pytest.raises(DeviceTimeoutError, match=r"no answer to .*; the connection is closed"):
        tracker.weather() if command == GET_AIR else tracker.measure_pose(window_s=0.1)
    with pytest.raises(NotConnectedError, match="weather: not connected; call connect"):
        tracker.weather()


def test_missing_result_is_a_timeout(peer, tracker: LeicaTracker):
    peer.answers[START] = peer.reply(START)
    with pytest.raises(DeviceTimeoutError, match=r"measure_pose: no result within 0.6 s"):
        tracker.measure_pose(window_s=0.1)


def test_missing_entry_of_a_list_is_a_timeout(peer, make):
    peer.answers[GET_REFLECTORS] = peer.reflector_list((4, "a"), (7, "CCR-1.5in"))[:100]
    with pytest.raises(DeviceTimeoutError, match="GetReflectors"):
        make().connect()


def test_list_that_breaks_off_with_an_error_closes_the_connection(peer, tracker: LeicaTracker):
    """What is left of it may come yet, and would be taken for the answer to the next question."""
    probe = peer.reply(GET_PROBES, struct.pack("<iiiIi", 3, 3, 877, 5, 4) + bytes(64 + 256))
    peer.answers[GET_PROBES] = probe + peer.reply(GET_PROBES, status=36)
    with pytest.raises(DeviceFaultError, match=r"identify_target: GetProbes: .*code 36"):
        tracker.identify_target()
    with pytest.raises(NotConnectedError, match="call connect"):
        tracker.weather()


def test_wait_for_an_answer_that_something_else_ends_closes_the_connection(peer, make):
    """A mistake of who takes the notices, or Ctrl-C: the answer comes, but nobody waits for it."""

    def take(notice: Notice) -> None:
        if notice.code == 26:
            raise RuntimeError("mistake")

    tracker = LeicaTracker("tracker", make()._options, on_notice=take)
    tracker.connect()
    peer.answers[GET_AIR] = peer.event(26)
    with pytest.raises(RuntimeError, match="mistake"):
        tracker.weather()
    with pytest.raises(NotConnectedError, match="weather: not connected; call connect"):
        tracker.weather()
    tracker.close()


def test_late_answer_is_not_taken_for_the_next_ones(peer, tracker: LeicaTracker):
    late = peer.reply(GET_AIR, struct.pack("<3d", 99.0, 99.0, 99.0))
    peer.answers[GET_AIR] = None
    with pytest.raises(DeviceTimeoutError):
        tracker.weather()
    with contextlib.suppress(OSError):
        peer.say(late)
    peer.answers[GET_AIR] = peer.reply(GET_AIR, struct.pack("<3d", 21.5, 987.5, 44.0))
    tracker.close()
    tracker.connect()
    assert tracker.weather().temperature_k == pytest.approx(294.65)


def test_connection_lost_while_idle_shows_at_the_next_call(peer, tracker: LeicaTracker):
    peer.hang_up()
    with pytest.raises(NotConnectedError, match="identify: connection lost") as lost:
        tracker.identify()
    assert not isinstance(lost.value, AccessDeniedError)
    tracker.close()
    tracker.connect()
    tracker.measure_pose(window_s=0.1)


def test_connection_lost_during_a_measurement(peer, tracker: LeicaTracker):
    peer.answers[START] = lambda _: peer.hang_up()
    with pytest.raises(NotConnectedError, match="measure_pose: connection lost"):
        tracker.measure_pose(window_s=0.1)


@pytest.mark.parametrize(
    ("answer", "text"),
    [
        (lambda peer: peer.reply(GET_FACE, bytes(4)), "a reply to command 98, which was not sent"),
        (lambda peer: peer.reply(GET_AIR, bytes(20)), "Environment takes 24 bytes, got 20"),
        (lambda _: struct.pack("<iIII", 7, 0, GET_AIR, 0), "7 is no size of a packet"),
        (lambda _: b"\xff" * 16, "-1 is no size of a packet"),
    ],
)
def test_bytes_that_make_no_sense_close_the_connection(
    peer, tracker: LeicaTracker, answer: Callable[[Any], bytes], text: str
):
    peer.answers[GET_AIR] = answer(peer)
    with pytest.raises(ProtocolError, match=rf"weather: {text}") as problem:
        tracker.weather()
    assert problem.value.sent == bytes.fromhex("0c000000 00000000 15000000")
    assert problem.value.received == answer(peer)
    with pytest.raises(NotConnectedError):
        tracker.weather()
    tracker.connect()


def test_refusal_during_a_session_is_access_denied(peer, tracker: LeicaTracker):
    peer.answers[GET_AIR] = peer.error(64, 10011)
    with pytest.raises(AccessDeniedError, match="weather: another client"):
        tracker.weather()


def test_stop_ends_a_measurement_of_another_thread(peer, tracker: LeicaTracker):
    measuring = threading.Event()

    def start(_: bytes) -> bytes:
        measuring.set()
        return peer.reply(START)

    peer.answers[START] = start
    failures: list[DeviceError] = []

    def measure() -> None:
        try:
            tracker.measure_pose(window_s=60.0)
        except DeviceError as error:
            failures.append(error)

    thread = threading.Thread(target=measure)
    thread.start()
    assert measuring.wait(5.0)
    tracker.stop()
    thread.join(5.0)
    assert not thread.is_alive()
    assert "measure_pose: stopped by stop()" in str(failures[0])
    assert STOP in peer.told(STOP)
    tracker.weather()


def test_stop_during_a_search_lets_no_measurement_begin(peer, tracker: LeicaTracker):
    searching, go_on = threading.Event(), threading.Event()
    peer.locks_when_searched(128)
    find = peer.answers[FIND]

    def find_late(body: bytes) -> bytes:
        searching.set()
        assert go_on.wait(5.0)
        return find(body)

    peer.answers[FIND] = find_late
    failures: list[DeviceError] = []

    def measure() -> None:
        try:
            tracker.measure_pose(window_s=0.1)
        except DeviceError as error:
            failures.append(error)

    measuring = threading.Thread(target=measure)
    measuring.start()
    assert searching.wait(5.0)
    stopping = threading.Thread(target=tracker.stop)
    stopping.start()
    while not tracker._connection._interrupted.is_set():
        time.sleep(0.001)
    go_on.set()
    for thread in (measuring, stopping):
        thread.join(5.0)
        assert not thread.is_alive()
    assert "measure_pose: stopped by stop()" in str(failures[0])
    assert peer.told(START, STOP) == [STOP]
    tracker.measure_pose(window_s=0.1)


def test_calls_of_several_threads_do_not_mix(peer, tracker: LeicaTracker):
    results: list[bool] = []

    def ask() -> None:
        results.extend(tracker.identify().serial == "2345" for _ in range(20))
        results.extend(tracker.weather().pressure_pa > 0 for _ in range(20))

    threads = [threading.Thread(target=ask) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(20.0)
    assert results == [True] * 160


def test_no_thread_is_left_after_close(peer, tracker: LeicaTracker):
    n_before = threading.active_count()
    tracker.measure_pose(window_s=0.1)
    tracker.close()
    tracker.close()
    assert threading.active_count() <= n_before
