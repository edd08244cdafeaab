"""Every fault of the simulated tracker, as it shows on the wire."""

import asyncio
import itertools
import struct
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

from drivers.leica.simulator.connection import Connection
from drivers.leica.simulator.faults import FAULTS
from drivers.leica.simulator.scene import StaticScene
from tronlab.errors import DeviceFaultError, DeviceTimeoutError, TrackingLostError
from tronlab.twin.state import ArmedFaults

TALKING = (2, 0, 0, 0, 1, 0, 0, 1, 0)
KEEPING = (2, 0, 0, 1, 1, 0, 0, 1, 0)
BROKEN = struct.pack("<iIiI", 16, 1, 64, 701)


@pytest.fixture
def ready(rig):
    """A tracker on the lamp's reflector, events on."""
    rig.client.prepare(settings=TALKING)
    rig.client.do(58, "3d", *rig.scene.reflectors["lamp"])
    rig.client.receive_event(27)
    return rig


@pytest.fixture
def ready_6d(rig):
    """A tracker on the T-MAC, events on."""
    rig.client.prepare(mode=6, settings=TALKING)
    rig.client.do(58, "3d", *rig.scene.trk_from_tmac.translation)
    rig.client.receive_event(27)
    return rig


def test_every_fault_has_a_description():
    assert set(FAULTS) == {
        f"tracker.{name}"
        for name in (
            "beam_broken",
            "beam_breaks",
            "warming_up",
            "busy",
            "pose_invalid",
            "probe_missing",
            "silent",
            "disconnect",
            "refuse_client",
            "split",
            "events",
            "wrong_reflector",
            "unknown_code",
            "error_packet",
        )
    }
    assert all(FAULTS.values())


def test_beam_broken_is_told_at_once_and_lasts(ready):
    ready.faults.arm("tracker.beam_broken")
    assert ready.client.receive_error().data == BROKEN
    ready.client.receive_event(25)
    assert ready.client.ask(49).status == 10004
    assert ready.client.ask(55, "3dI", *ready.scene.reflectors["lamp"], 1).status == 701
    ready.client.do(58, "3d", *ready.scene.reflectors["lamp"])
    assert ready.client.do(2).at(16, "I") == 0


def test_beam_must_be_pointed_again_after_it_was_broken(ready):
    ready.faults.arm("tracker.beam_broken")
    ready.client.receive_error()
    ready.faults.arm("tracker.beam_broken", times=0)
    assert 27 not in [packet.number for packet in ready.client.receive_for(0.4)]
    ready.client.do(58, "3d", *ready.scene.reflectors["lamp"])
    ready.client.receive_event(27)
    ready.client.measure(types=(2,))


def test_beam_comes_back_by_itself_when_the_head_keeps_its_position(ready):
    ready.client.do(47, "9I", *KEEPING)
    ready.faults.arm("tracker.beam_broken")
    ready.client.receive_error()
    assert ready.client.ask(49).status == 10004
    ready.faults.arm("tracker.beam_broken", times=0)
    ready.client.receive_event(27)
    ready.client.measure(types=(2,))


def test_beam_broken_during_a_measurement_gives_no_result(ready):
    ready.client.do(28, "iI", 60_000, 1)
    ready.client.do(49)
    ready.faults.arm("tracker.beam_broken")
    seen = ready.client.receive_event(25)
    assert BROKEN in [packet.data for packet in seen]
    assert 2 not in {packet.type for packet in seen}


def test_beam_broken_ends_a_stream(ready_6d):
    client = ready_6d.client
    client.do(24, "I", 7)
    client.do(49)
    client.receive_data(5)
    ready_6d.faults.arm("tracker.beam_broken")
    client.receive_error()
    client.receive_event(25)
    with pytest.raises(TimeoutError):
        client.receive(timeout_s=0.5)


def test_beam_breaks_during_one_measurement(ready):
    ready.faults.arm("tracker.beam_breaks", times=1)
    ready.client.do(49)
    assert ready.client.receive_error().data == BROKEN
    ready.client.receive_event(25)
    ready.client.do(58, "3d", *ready.scene.reflectors["lamp"])
    ready.client.measure(types=(2,))


def test_warming_up(ready):
    ready.faults.arm("tracker.warming_up")
    ready.client.receive_event(25)
    assert ready.client.do(1).at(24, "I") == 2
    assert ready.client.ask(49).status == 10012
    assert ready.client.ask(7).status == 10012
    ready.faults.arm("tracker.warming_up", times=0)
    ready.client.receive_event(1)
    assert ready.client.do(1).at(24, "I") == 3
    ready.client.measure(types=(2,))


def test_busy_as_often_as_told(ready):
    ready.faults.arm("tracker.busy", times=2)
    assert [ready.client.ask(49).status for _ in range(2)] == [1, 1]
    ready.client.measure(types=(2,))


def test_invalid_pose_is_told_and_held_back(ready_6d):
    client, faults = ready_6d.client, ready_6d.faults
    faults.arm("tracker.pose_invalid")
    client.receive_event(99)
    assert client.do(2).at(16, "I") == 3
    client.do(49)
    assert client.receive_error().data == struct.pack("<iIiI", 16, 1, 49, 93)
    client.do(24, "I", 7)
    client.do(49)
    assert {packet.type for packet in client.receive_for(0.6)} <= {8}
    client.do(52)
    faults.arm("tracker.pose_invalid", times=0)
    client.receive_event(27)


def test_invalid_pose_is_shown_when_all_are_wanted(ready_6d):
    client = ready_6d.client
    client.do(120, "Ii", 2, 1)
    ready_6d.faults.arm("tracker.pose_invalid")
    client.do(49)
    status = client.receive_data(4).at(24, "i")
    assert status & 1
    assert status & 0b10
    client.do(24, "I", 7)
    client.do(49)
    assert client.receive_data(5).at(68 + 8, "i") & 0b10


def test_missing_probe(ready_6d):
    client = ready_6d.client
    ready_6d.faults.arm("tracker.probe_missing")
    client.receive_event(36)
    assert client.ask(49).status == 75
    assert client.ask(119).status == 75
    assert client.ask(104).status == 75
    assert not client.do(122).at(20, "i") & 128
    assert client.do(103).at(16, "i") == 1
    ready_6d.faults.arm("tracker.probe_missing", times=0)
    client.receive_event(36)
    client.measure(types=(4,))


def test_probe_missing_once(ready_6d):
    ready_6d.faults.arm("tracker.probe_missing", times=1)
    assert ready_6d.client.ask(49).status == 75
    ready_6d.client.measure(types=(4,))


def test_silence(ready):
    ready.faults.arm("tracker.silent")
    ready.client.send_command(2)
    with pytest.raises(TimeoutError):
        ready.client.receive(timeout_s=0.4)
    ready.faults.arm("tracker.silent", times=0)
    assert ready.client.do(98).at(16, "I") == 1


def test_silence_once(ready):
    ready.faults.arm("tracker.silent", times=1)
    ready.client.send_command(2)
    ready.client.send_command(98)
    assert ready.client.receive().number == 98


def test_silence_swallows_a_result(ready):
    ready.client.do(28, "iI", 300, 1)
    ready.client.do(49)
    ready.faults.arm("tracker.silent")
    assert {packet.type for packet in ready.client.receive_for(0.8)} <= {8}


def test_disconnect_at_the_next_command(ready):
    ready.faults.arm("tracker.disconnect", times=1)
    ready.client.send_command(2)
    with pytest.raises((EOFError, ConnectionResetError)):
        ready.client.receive()
    ready.connect().do(2)


def test_client_refused_once(rig):
    rig.client.do(2)
    rig.client.close()
    rig.faults.arm("tracker.refuse_client", times=1)
    refused = rig.connect()
    assert refused.receive().data == struct.pack("<iIiI", 16, 1, 64, 10011)
    with pytest.raises(EOFError):
        refused.receive()
    rig.connect().do(2)


def test_packets_written_in_small_pieces_are_the_same_packets():
    """What a socket receives may have been joined again, so look at what is written."""
    faults = ArmedFaults({"tracker.split": -1})
    written: list[bytes] = []

    async def drain() -> None:
        pass

    async def send_two() -> None:
        writer = SimpleNamespace(write=written.append, drain=drain)
        connection = Connection(asyncio.StreamReader(), writer, faults)
        connection.send(bytes(range(200)))
        connection.send(b"12345")
        pump = asyncio.create_task(connection.pump())
        await connection.flush()
        pump.cancel()

    asyncio.run(send_two())
    assert b"".join(written) == bytes(range(200)) + b"12345"
    assert {len(piece) for piece in written} <= set(range(1, 8))
    assert len(written) > 30


def test_a_client_that_reads_well_does_not_mind_pieces(ready):
    ready.faults.arm("tracker.split")
    packet = ready.client.measure(types=(2,))
    assert packet.size == 156
    assert packet.floats(20) == pytest.approx(ready.scene.reflectors["lamp"], abs=1e-4)


def test_events_between_request_and_reply(ready):
    ready.faults.arm("tracker.events")
    ready.client.send_command(98)
    seen = ready.client.receive_until(lambda packet: packet.type == 0)
    assert {packet.type for packet in seen} == {0, 7, 8}
    result = ready.client.measure(types=(2,))
    assert result.size == 156


def test_wrong_reflector_stays(ready):
    ready.faults.arm("tracker.wrong_reflector")
    ready.client.do(40, "i", 2)
    assert ready.client.do(41).at(16, "i") == 7
    ready.faults.arm("tracker.wrong_reflector", times=0)
    ready.client.do(40, "i", 2)
    assert ready.client.do(41).at(16, "i") == 2


def test_unknown_code(ready):
    ready.faults.arm("tracker.unknown_code", times=1)
    assert ready.client.ask(49).status == 31999
    ready.client.measure(types=(2,))


def test_error_packet_in_place_of_a_result(ready):
    ready.faults.arm("tracker.error_packet", times=1)
    ready.client.do(49)
    assert ready.client.receive_error().data == struct.pack("<iIiI", 16, 1, 49, 10009)
    ready.client.receive_event(27)
    ready.client.measure(types=(2,))


class ScriptedScene(StaticScene):
    """A scene whose rig file lets the n-th call fail."""

    errors: ClassVar = {
        "lost": TrackingLostError("broken", device="tracker"),
        "timeout": DeviceTimeoutError("silent", device="tracker"),
        "fault": DeviceFaultError("fault", device="tracker", code=900),
    }

    def __init__(self, *script: tuple[str, str]) -> None:
        super().__init__(np.random.default_rng(3))
        self.script = list(script)
        self.calls: list[str] = []

    def begin(self, call: str) -> None:
        self.calls.append(call)
        if self.script and self.script[0][0] == call:
            raise self.errors[self.script.pop(0)[1]]


def test_scripted_faults_of_measurements_reach_the_wire(make_rig):
    scene = ScriptedScene(
        ("measure_point", "lost"), ("measure_point", "timeout"), ("measure_pose", "fault")
    )
    rig = make_rig(scene=scene)
    client = rig.client
    client.prepare()
    client.do(58, "3d", *scene.reflectors["lamp"])
    client.do(49)
    assert client.receive_error().data == BROKEN
    client.do(58, "3d", *scene.reflectors["lamp"])
    client.send_command(49)
    with pytest.raises(TimeoutError):
        client.receive(timeout_s=0.4)
    client.measure(types=(2,))
    client.do(24, "I", 6)
    client.do(58, "3d", *scene.trk_from_tmac.translation)
    client.do(49)
    assert client.receive_error().data == struct.pack("<iIiI", 16, 1, 49, 900)
    client.measure(types=(4,))
    counted = [call for call, _ in itertools.groupby(scene.calls)]
    assert counted == ["connect", "measure_point", "measure_pose"]
    assert scene.calls.count("measure_point") == 3


def test_scripted_faults_of_connect(make_rig):
    scene = ScriptedScene(("connect", "fault"), ("connect", "timeout"))
    rig = make_rig(scene=scene)
    assert rig.client.receive_error().data == struct.pack("<iIiI", 16, 1, 64, 900)
    rig.client.close()
    silent = rig.connect()
    silent.send_command(2)
    with pytest.raises(TimeoutError):
        silent.receive(timeout_s=0.4)
    silent.close()
    rig.connect().do(2)
