"""Behaviour of the simulated tracker: states, locking, refusals, settings, one client at a time."""

import socket
import struct
import threading
from dataclasses import replace

import numpy as np
import pytest

from drivers.leica.simulator.tracker import Machine

TALKING = (2, 0, 0, 0, 1, 0, 0, 1, 0)


def test_identity_is_read_from_the_tracker(rig):
    info = rig.client.do(132)
    assert info.size == 164
    assert info.at(16, "I") == 14
    assert info.text(20, 64) == "AT901-MR"
    assert info.at(84, "i") == rig.scene.serial
    assert info.at(132, "i") == 2
    assert rig.client.do(142).text(16, 64) == "3.6.0"
    assert rig.client.do(90).at(52, "I") == 14
    assert rig.client.do(139).at(16, "I") == 1
    status = rig.client.do(1)
    assert status.at(52, "i") == rig.scene.serial
    assert status.at(20, "2I") == (3, 3)


def test_probe_is_a_machine_control_probe(rig):
    info = rig.client.do(119)
    assert info.size == 72
    assert info.at(28, "I") in (4, 5)
    assert info.at(24, "i") == rig.scene.serial
    listed = rig.client.do(103)
    assert (listed.size, listed.at(16, "i"), listed.at(20, "i")) == (356, 1, 3)
    assert listed.text(36, 64) == "T-MAC"
    assert rig.client.do(104).at(16, "i") == 3
    assert rig.client.do(110).at(24, "i") == 3
    rig.client.do(112, "i", rig.client.do(111).at(16, "i"))
    assert rig.client.ask(112, "i", 99).status == 56
    assert rig.client.ask(105).status == 83


def test_nothing_moves_or_measures_before_initialisation(rig):
    for command, code, values in (
        (49, "", ()),
        (58, "3d", (1, 1, 1)),
        (54, "", ()),
        (53, "", ()),
        (63, "d", (3,)),
        (87, "", ()),
    ):
        reply = rig.client.ask(command, code, *values)
        assert (reply.status, reply.size) == (39, 16)
    assert rig.client.do(2).at(16, "I") == 0
    assert not rig.client.do(122).at(20, "i") & 65536


def test_initialisation_takes_its_time_and_is_told(make_rig):
    rig = make_rig(machine=Machine(initialize_s=0.4))
    rig.client.send_command(7)
    assert [packet.number for packet in rig.client.receive_event(26)] == [26]
    assert rig.client.ask(2).at(16, "I") == 1
    assert rig.client.ask(58, "3d", 1, 1, 1).status == 1
    assert rig.client.ask(24, "I", 6).status == 1
    told = rig.client.receive_until(lambda packet: packet.type == 8)
    assert (told[0].type, told[0].number, told[0].status) == (0, 7, 0)
    assert told[-1].number == 25
    assert rig.client.do(1).at(20, "I") == 5
    assert rig.client.do(122).at(20, "i") & 65536


def test_pointing_locks_to_what_is_within_the_search_radius(rig):
    client, p_m = rig.client, rig.scene.reflectors["lamp"]
    client.prepare()
    client.do(43, "di", 0.05, 5000)
    client.do(58, "3d", *np.add(p_m, [0.0, 0.0, 0.2]))
    assert client.do(2).at(16, "I") == 0
    assert not client.do(122).at(20, "i") & 2048
    client.do(58, "3d", *np.add(p_m, [0.0, 0.0, 0.03]))
    assert client.do(2).at(16, "I") == 2
    assert client.do(122).at(20, "i") & 2048
    assert client.do(124).floats(16) == pytest.approx(p_m, abs=1e-9)


def test_only_the_direction_counts_for_the_beam(rig):
    client, p_m = rig.client, rig.scene.reflectors["lamp"]
    client.prepare()
    client.do(58, "3d", *(1.3 * p_m))
    assert client.do(124).floats(16) == pytest.approx(p_m, abs=1e-9)


def test_without_beam_capture_pointing_catches_nothing_and_a_search_does(rig):
    client, p_m = rig.client, rig.scene.reflectors["lamp"]
    client.prepare()
    client.do(120, "Ii", 3, 0)
    client.do(58, "3d", *np.add(p_m, [0.0, 0.0, 0.02]))
    assert client.ask(124).status == 10004
    assert client.ask(49).status == 10004
    client.do(63, "d", 4.0)
    assert client.do(124).floats(16) == pytest.approx(p_m, abs=1e-9)


def test_a_search_that_finds_nothing_is_an_error(rig):
    client = rig.client
    client.prepare()
    assert client.ask(55, "3dI", -3, -3, 0, 1).status == 701
    assert client.ask(63, "d", 3.0).status == 701
    assert client.ask(65, "4d", -3, -3, 0, 0.1).status == 701
    assert client.ask(135, "3d", -3, -3, 0).status == 701
    assert client.ask(63, "d", -3.0).status == 12
    assert client.ask(62).status == 28


def test_the_tracker_does_not_point_at_itself_or_beyond_all_numbers(rig):
    rig.client.prepare()
    assert rig.client.ask(58, "3d", 0, 0, 0).status == 12
    assert rig.client.ask(59, "3d", 1, 1, 0).status == 12
    assert rig.client.ask(58, "3d", 1e300, 1e300, 0).status == 98


def test_other_ways_to_a_target(rig):
    client, p_m = rig.client, rig.scene.reflectors["lamp"]
    client.prepare()
    hz, vt = np.arctan2(p_m[0], p_m[1]), np.arccos(p_m[2] / np.linalg.norm(p_m))
    angles = client.do(65, "4d", *np.add(p_m, [0.01, 0, 0]), 0.1).floats(16, 2)
    assert angles == pytest.approx([hz, vt], abs=1e-9)
    for command, code, values in (
        (55, "3dI", (*p_m, 1)),
        (56, "3dI", (hz, vt, 4.0, 1)),
        (59, "3d", (hz, vt, 4.0)),
    ):
        client.do(58, "3d", 0, 0, -1)
        assert client.ask(124).status == 10004
        client.do(command, code, *values)
        assert client.do(124).floats(16) == pytest.approx(p_m, abs=1e-9)
    client.do(135, "3d", *p_m)
    seen = client.receive_data(2).floats(20)
    assert seen == pytest.approx(p_m, abs=1e-4)
    client.do(58, "3d", 0, 0, -1)
    client.do(62)
    assert client.do(124).floats(16) == pytest.approx(p_m, abs=1e-9)
    client.do(57, "2d", 0.5, 0.1)
    assert client.ask(124).status == 10004
    assert client.do(66).floats(16, 2) == pytest.approx([hz + 0.5, vt + 0.1], abs=1e-4)
    client.do(57, "2d", -0.5, -0.1)
    assert client.do(124).floats(16) == pytest.approx(p_m, abs=1e-9)


def test_without_adm_a_found_target_has_no_distance(rig):
    client, p_m = rig.client, rig.scene.reflectors["lamp"]
    client.prepare()
    client.do(28, "iI", 100, 0)
    client.do(55, "3dI", *p_m, 0)
    assert client.ask(49).status == 37
    client.do(54)
    client.do(49)
    client.receive_data(2)


@pytest.mark.parametrize(("mode", "target", "status"), [(6, "lamp", 75), (0, "tmac", 23)])
def test_wrong_mode_for_the_target(rig, mode, target, status):
    client = rig.client
    p_m = rig.scene.trk_from_tmac.translation if target == "tmac" else rig.scene.reflectors["lamp"]
    client.prepare(mode=mode)
    client.do(58, "3d", *p_m)
    assert client.do(2).at(16, "I") == 0
    assert client.ask(49).status == status


def test_scene_without_a_tmac_has_no_probe(rig):
    rig.scene.trk_from_tmac = None
    rig.client.prepare(mode=6)
    assert rig.client.ask(49).status == 75
    assert rig.client.ask(119).status == 75
    assert not rig.client.do(122).at(20, "i") & (128 | 256)


def test_6d_needs_face_1_and_no_tip(rig):
    client = rig.client
    client.prepare()
    client.do(53)
    assert client.ask(24, "I", 6).status == 97
    client.do(53)
    client.do(24, "I", 6)
    assert client.ask(53).status == 97
    client.do(58, "3d", *rig.scene.trk_from_tmac.translation)
    client.do(120, "Ii", 52, 0)
    assert client.ask(49).status == 83


def test_bird_bath_is_the_zero_position_in_6d_modes(rig):
    client = rig.client
    client.prepare()
    client.do(54)
    assert client.do(122).at(20, "i") & 2048
    client.do(24, "I", 6)
    client.do(95, "I", 1)
    assert not client.do(122).at(20, "i") & 2048
    assert client.do(66).floats(16, 2) == pytest.approx([0, np.pi / 2])


def test_parking_and_switching_off_let_go(rig):
    client, p_m = rig.client, rig.scene.reflectors["lamp"]
    client.prepare()
    for command, code, values in ((10, "", ()), (8, "", ()), (11, "I", (0,))):
        client.do(58, "3d", *p_m)
        assert client.do(2).at(16, "I") == 2
        client.do(command, code, *values)
        assert client.do(2).at(16, "I") == 0
    assert client.do(1).at(24, "I") == 5
    assert client.ask(58, "3d", *p_m).status == 10014
    client.do(11, "I", 1)
    client.do(58, "3d", *p_m)


def test_events_tell_what_happens(rig):
    client = rig.client
    client.prepare(settings=TALKING)
    client.do(58, "3d", *rig.scene.reflectors["lamp"])
    client.receive_event(27)
    client.send_command(49)
    busy, reply, result, ready = client.receive_event(27)
    assert (busy.type, busy.number) == (8, 26)
    assert (reply.type, reply.number, reply.status) == (0, 49, 0)
    assert (result.type, ready.type) == (2, 8)
    client.do(24, "I", 6)
    assert [packet.number for packet in client.receive_event(25)] == [17, 25]


@pytest.mark.parametrize(
    ("command", "code", "values", "event"),
    [
        (5, "5I", (0, 0, 0, 0, 0), 6),
        (20, "3d", (20, 1000, 50), 2),
        (24, "I", (0,), 17),
        (26, "I", (0,), 12),
        (28, "iI", (500, 1), 18),
        (30, "2i2I", (100, 0, 0, 0), 19),
        (32, "di2I", (0.1, 0, 0, 0), 20),
        (40, "i", (7,), 7),
        (47, "9I", TALKING, 8),
        (12, "6d", (0,) * 6, 15),
        (14, "7d", (0, 0, 0, 0, 0, 0, 1), 16),
        (112, "i", (21,), 39),
    ],
)
def test_every_change_is_told(rig, command, code, values, event):
    rig.client.do(5, "5I", 0, 0, 0, 0, 0)
    rig.client.receive_event(6)
    rig.client.do(command, code, *values)
    assert (rig.client.receive().data) == struct.pack("<iII", 12, 8, event)


def test_no_events_when_unsolicited_messages_are_off(rig):
    rig.client.prepare()
    rig.client.do(58, "3d", *rig.scene.reflectors["lamp"])
    rig.client.send_command(49)
    assert [rig.client.receive().type for _ in range(2)] == [0, 2]
    with pytest.raises(TimeoutError):
        rig.client.receive(timeout_s=0.25)


@pytest.mark.parametrize(
    ("setter", "getter", "code", "values"),
    [
        (3, 4, "I", (2,)),
        (5, 6, "5I", (3, 1, 1, 4, 0)),
        (12, 13, "6d", (1.5, -2, 3, 0.1, 0.2, 0.3)),
        (14, 15, "7d", (1, 2, 3, 0.1, 0.2, 0.3, 1.5)),
        (24, 25, "I", (7,)),
        (26, 27, "I", (6,)),
        (28, 29, "iI", (1500, 0)),
        (30, 31, "2i2I", (40, 12, 0, 0)),
        (32, 33, "di2I", (0.25, 3, 0, 0)),
        (40, 41, "i", (11,)),
        (43, 44, "di", (0.2, 4000)),
        (45, 46, "d2i", (0.001, 500, 4)),
        (47, 48, "9I", (1, 1, 0, 1, 0, 1, 1, 0, 1)),
        (80, 81, "2I", (1, 1)),
        (101, 102, "I", (1,)),
    ],
)
def test_what_is_set_can_be_read_back(rig, setter, getter, code, values):
    rig.client.do(5, "5I", 0, 0, 0, 0, 0)
    rig.client.do(setter, code, *values)
    assert rig.client.do(getter).at(16, code) == pytest.approx(
        values if len(values) > 1 else values[0]
    )


def test_parameters_of_commands_120_and_125(rig):
    client = rig.client
    client.do(120, "Ii", 400, 7)
    assert client.do(121, "I", 400).at(16, "2i") == (400, 7)
    assert client.ask(120, "Ii", 400, 11).status == 14
    assert client.ask(120, "Ii", 300, 5).status == 35
    assert client.do(121, "I", 300).at(20, "i") == 100
    assert client.ask(121, "I", 77).status == 4
    client.do(120, "Ii", 0, 1)
    assert client.do(48).at(16 + 12, "I") == 1
    client.do(125, "Id", 1000, 2.5)
    assert client.do(126, "I", 1000).at(20, "d") == 2.5
    client.do(5, "5I", 1, 0, 0, 0, 0)
    assert client.do(126, "I", 1102).at(20, "d") == 18_000.0
    assert client.ask(126, "I", 77).status == 4


@pytest.mark.parametrize(
    ("command", "code", "values", "status"),
    [
        (5, "5I", (6, 0, 0, 0, 0), 4),
        (5, "5I", (0, 0, 0, 7, 0), 7),
        (14, "7d", (0, 0, 0, 0, 0, 0, 0), 24),
        (20, "3d", (200, 1000, 50), 57),
        (20, "3d", (20, 1000, 150), 57),
        (24, "I", (3,), 4),
        (24, "I", (99,), 4),
        (26, "I", (8,), 4),
        (28, "iI", (50, 1), 12),
        (28, "iI", (100, 2), 5),
        (30, "2i2I", (0, 0, 0, 0), 12),
        (30, "2i2I", (10, -1, 0, 0), 14),
        (30, "2i2I", (10, 0, 1, 0), 2),
        (40, "i", (1,), 4),
        (43, "di", (-1, 100), 12),
        (47, "9I", (3, 0, 0, 0, 0, 0, 0, 0, 0), 4),
        (20, "3d", (float("nan"), 1000, 50), 98),
        (58, "3d", (float("inf"), 0, 0), 98),
    ],
)
def test_a_wrong_value_is_refused_and_changes_nothing(rig, command, code, values, status):
    before = rig.client.do(48).data, rig.client.do(6).data, rig.client.do(25).data
    reply = rig.client.ask(command, code, *values)
    assert (reply.status, reply.size) == (status, 16)
    assert (rig.client.do(48).data, rig.client.do(6).data, rig.client.do(25).data) == before


def test_6d_streams_have_a_slower_limit(rig):
    rig.client.do(24, "I", 7)
    assert rig.client.ask(30, "2i2I", 5, 0, 0, 0).status == 12
    rig.client.do(30, "2i2I", 10, 0, 0, 0)


def test_startup_conditions_come_back_and_initialisation_stays(rig):
    rig.client.prepare(mode=6)
    rig.client.do(134)
    assert rig.client.do(6).at(16, "5I") == (1, 2, 0, 0, 0)
    assert rig.client.do(41).at(16, "i") == 2
    assert rig.client.do(25).at(16, "I") == 0
    assert rig.client.do(1).at(20, "I") == 5


def test_unknown_commands_are_not_implemented(rig):
    for number in (9, 64, 99, 118, 5000, -5):
        rig.client.send_command(number, "3d", 1, 2, 3)
        reply = rig.client.receive()
        assert (reply.size, reply.at(8, "i"), reply.status) == (16, number, 2)


def test_compensations_are_listed(rig):
    assert rig.client.do(86).text(24, 64) == "factory"
    assert rig.client.do(123).at(668, "I") == 1
    rig.client.do(79, "i", rig.client.do(85).at(16, "i"))
    assert rig.client.ask(79, "i", 77).status == 56


def test_a_measurement_keeps_others_waiting_but_can_be_stopped(rig):
    client = rig.client
    client.prepare(time_ms=60_000)
    client.do(58, "3d", *rig.scene.reflectors["lamp"])
    client.do(49)
    assert client.do(2).at(16, "I") == 1
    assert client.ask(49).status == 1
    assert client.ask(40, "i", 7).status == 1
    client.do(130, "I", 0)
    assert client.ask(130, "I", 2).status == 4
    client.do(52)
    assert client.do(2).at(16, "I") == 2
    client.do(28, "iI", 100, 1)
    client.measure(types=(2,))


def test_last_status_is_remembered(rig):
    rig.client.ask(40, "i", 1)
    assert rig.client.do(122).at(16, "I") == 4


def test_second_client_is_refused_and_the_first_goes_on(rig):
    rig.client.do(2)
    second = rig.connect()
    refusal = second.receive()
    assert refusal.data == struct.pack("<iIiI", 16, 1, 64, 10011)
    with pytest.raises(EOFError):
        second.receive()
    second.close()
    rig.client.do(2)


def test_next_client_finds_the_tracker_as_the_last_left_it(rig):
    rig.client.prepare(mode=6)
    for _ in range(5):
        rig.client.close()
        rig.client = rig.connect()
        assert rig.client.do(25).at(16, "I") == 6
    assert rig.client.do(1).at(20, "I") == 5


def test_a_client_that_leaves_ends_its_measurement(rig):
    rig.client.prepare(mode=1)
    rig.client.do(58, "3d", *rig.scene.reflectors["lamp"])
    rig.client.do(49)
    rig.client.close()
    client = rig.connect()
    assert client.do(2).at(16, "I") == 2


def test_clients_that_reset_their_connection_do_no_harm(rig):
    rig.client.close()
    for _ in range(20):
        client = rig.connect()
        client._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        client.send(struct.pack("<iIi", 12, 0, 2))
        client.close()
    client = rig.connect()
    client.do(2)


def test_exit_says_good_bye(rig):
    rig.client.do(0)
    assert rig.client.receive_event(997)
    with pytest.raises(EOFError):
        rig.client.receive()


@pytest.mark.parametrize(
    "data",
    [
        struct.pack("<iIi", 11, 0, 1),
        struct.pack("<iIi", -1, 0, 1),
        struct.pack("<iIi", 70_000, 0, 1),
        struct.pack("<iIi", 12, 1, 1),
        struct.pack("<iIi", 12, 0, 5),
        struct.pack("<iIii", 16, 0, 1, 0),
    ],
)
def test_malformed_requests_end_the_connection(rig, data):
    rig.client.do(2)
    rig.client.send(data)
    with pytest.raises((EOFError, ConnectionResetError)):
        rig.client.receive()
    rig.connect().do(2)


def test_requests_may_come_in_pieces_or_together(rig):
    one = struct.pack("<iIi", 12, 0, 2)
    for byte in one:
        rig.client.send(bytes([byte]))
    assert rig.client.receive().number == 2
    rig.client.send(one * 5 + struct.pack("<iIi", 12, 0, 98))
    assert [rig.client.receive().number for _ in range(6)] == [2] * 5 + [98]


def test_closing_twice_is_fine_and_frees_the_port(rig):
    rig.server.close()
    rig.server.close()
    with pytest.raises((EOFError, ConnectionResetError)):
        rig.client.receive()
    with pytest.raises(ConnectionRefusedError):
        rig.connect()


def test_closing_during_a_stream_leaves_no_thread(rig):
    rig.client.prepare(mode=7)
    rig.client.do(58, "3d", *rig.scene.trk_from_tmac.translation)
    rig.client.do(49)
    rig.client.receive_data(5)
    rig.server.close()
    assert "simulated tracker" not in {thread.name for thread in threading.enumerate()}
    with pytest.raises((EOFError, ConnectionResetError)):
        rig.client.receive_until(lambda packet: packet.type == 0)


def test_search_takes_its_time_and_gives_up(make_rig):
    rig = make_rig(machine=replace(Machine(), initialize_s=0.01, slew_rad_per_s=1e3))
    rig.client.prepare()
    rig.client.do(43, "di", 0.3, 100)
    p_m = rig.scene.reflectors["lamp"]
    assert rig.client.ask(55, "3dI", *np.add(p_m, [0, 0, 0.1]), 1).status == 701
    rig.client.do(43, "di", 0.3, 5000)
    rig.client.do(55, "3dI", *np.add(p_m, [0, 0, 0.1]), 1)
    assert rig.client.do(124).floats(16) == pytest.approx(p_m, abs=1e-9)
