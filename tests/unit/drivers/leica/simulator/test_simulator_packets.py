"""Bytes of the simulated tracker against literal offsets of the emScon 3.6 header."""

import pytest

from drivers.leica.simulator.codes import Command, DataType
from drivers.leica.simulator.tables import DATA, REPLIES, REQUESTS, SAMPLES

GOLDEN = {
    "Initialize": ("0c000000 00000000 07000000", 7),
    "SetUnits": (
        "20000000 00000000 05000000 01000000 00000000 00000000 00000000 00000000",
        5,
    ),
    "SetStationaryModeParams": ("14000000 00000000 1c000000 d0070000 01000000", 28),
    "SetReflector": ("10000000 00000000 28000000 07000000", 40),
    "SetMeasurementMode": ("10000000 00000000 18000000 06000000", 24),
    "PointLaser": (
        "24000000 00000000 3a000000 000000000000f03f 0000000000000040 0000000000000840",
        58,
    ),
    "SetEnvironment": (
        "24000000 00000000 14000000 0000000000003440 0000000000aa8f40 0000000000004940",
        20,
    ),
}

REQUEST_SIZES = (
    {0: 12, 1: 12, 2: 12, 3: 16, 4: 12, 5: 32, 6: 12, 7: 12, 8: 12, 10: 12, 11: 16, 12: 60, 13: 12}
    | {14: 68, 15: 12, 20: 36, 21: 12, 22: 28, 23: 12, 24: 16, 25: 12, 26: 16, 27: 12, 28: 20}
    | {29: 12, 30: 28, 31: 12, 32: 32, 33: 12, 40: 16, 41: 12, 42: 12, 43: 24, 44: 12, 45: 28}
    | {46: 12, 47: 48, 48: 12, 49: 12, 51: 12, 52: 12, 53: 12, 54: 12, 95: 16, 55: 40, 56: 40}
    | {57: 28, 58: 36, 59: 36, 62: 12, 63: 20, 65: 44, 66: 12, 79: 16, 85: 12, 80: 20, 81: 12}
    | {86: 12, 123: 12, 87: 12, 90: 12, 98: 12, 101: 16, 102: 12, 103: 12, 104: 12, 105: 12}
    | {106: 12, 108: 12, 109: 16, 110: 12, 111: 12, 112: 16, 119: 12, 120: 20, 121: 16, 122: 12}
    | {124: 12, 125: 24, 126: 16, 130: 16, 132: 12, 134: 12, 135: 36, 139: 12, 142: 12}
)
REPLY_SIZES = (
    {1: 56, 2: 20, 4: 20, 6: 36, 13: 64, 15: 72, 21: 40, 23: 32, 25: 20, 27: 20, 29: 24, 31: 32}
    | {33: 36, 41: 20, 42: 100, 44: 28, 46: 32, 48: 52, 65: 32, 66: 32, 85: 20, 81: 24, 86: 412}
    | {123: 672, 87: 64, 90: 56, 98: 20, 102: 20, 103: 356, 104: 20, 108: 20, 110: 364, 111: 20}
    | {119: 72, 121: 24, 122: 24, 124: 40, 126: 28, 132: 164, 139: 92, 142: 80}
)
DATA_SIZES = {2: 156, 3: 48, 4: 376, 5: 68, 6: 40, 7: 36, 9: 204, 10: 48, 11: 108}
SAMPLE_SIZES = {3: 36, 5: 212, 10: 92}

PROBE_OFFSETS = {
    "status": 8,
    "mode": 12,
    "rotation_status": 24,
    "probe_id": 28,
    "field": 32,
    "tip_status": 36,
    "position": 48,
    "position_std": 72,
    "position_total": 96,
    "position_covariance": 104,
    "apriori_position_std": 128,
    "apriori_position_total": 152,
    "apriori_position_covariance": 160,
    "quaternion": 184,
    "angles": 216,
    "angles_std": 240,
    "angles_total": 264,
    "angles_covariance": 272,
    "apriori_angles_std": 296,
    "apriori_angles_total": 320,
    "apriori_angles_covariance": 328,
    "air": 352,
}
PROBE_SAMPLE_OFFSETS = {
    "rotation_status": 8,
    "time": 12,
    "position": 20,
    "position_std": 44,
    "position_total": 68,
    "position_covariance": 76,
    "quaternion": 100,
    "angles": 132,
    "angles_std": 156,
    "angles_total": 180,
    "angles_covariance": 188,
}


def test_requests_have_the_sizes_of_the_header():
    assert {number: layout.size for number, layout in REQUESTS.items()} == REQUEST_SIZES


def test_replies_have_the_sizes_of_the_header():
    assert {number: layout.size for number, layout in REPLIES.items()} == REPLY_SIZES


def test_data_packets_have_the_sizes_of_the_header():
    assert {kind: layout.size for kind, layout in DATA.items()} == DATA_SIZES
    assert {kind: layout.size for kind, layout in SAMPLES.items()} == SAMPLE_SIZES


@pytest.mark.parametrize(
    ("layout", "offsets"),
    [
        (DATA[DataType.PROBE_STATIONARY], PROBE_OFFSETS),
        (SAMPLES[DataType.PROBE_CONTINUOUS], PROBE_SAMPLE_OFFSETS),
    ],
)
def test_6d_fields_lie_where_the_header_says(layout, offsets):
    assert {name: layout.fields[name][0] for name in offsets} == offsets


@pytest.mark.parametrize("tables", [REQUESTS, REPLIES, DATA, SAMPLES])
def test_no_fields_overlap_and_none_leaves_its_packet(tables):
    import struct

    for number, layout in tables.items():
        end = 0
        for offset, code in sorted(layout.fields.values()):
            assert offset >= end, f"{number}: offset {offset}"
            end = offset + struct.calcsize(f"<{code}")
        assert end <= layout.size, f"{number}"


@pytest.mark.parametrize("tables", [REQUESTS, REPLIES])
def test_fields_leave_no_gap_before_the_end(tables):
    import struct

    for number, layout in tables.items():
        ends = [offset + struct.calcsize(f"<{code}") for offset, code in layout.fields.values()]
        assert max(ends, default=12) == layout.size, f"{number}"


def test_pack_wants_every_field():
    with pytest.raises(ValueError, match="expected"):
        REPLIES[Command.GET_FACE].pack({"face": 1, "nose": 2})


@pytest.mark.parametrize("name", GOLDEN)
def test_golden_requests_are_accepted(rig, name):
    data, number = GOLDEN[name]
    rig.client.prepare()
    rig.client.send(bytes.fromhex(data))
    reply = rig.client.receive()
    assert reply.data == bytes.fromhex(f"10000000 00000000 {number:02x}000000 00000000")


def test_golden_start_measurement_is_accepted_once_something_is_there_to_measure(rig):
    rig.client.prepare()
    rig.client.do(58, "3d", *rig.scene.reflectors["lamp"])
    rig.client.send(bytes.fromhex("0c000000 00000000 31000000"))
    assert rig.client.receive().data == bytes.fromhex("10000000 00000000 31000000 00000000")
    assert rig.client.receive().type == 2


def test_golden_find_reflector_searches_along_the_beam(rig):
    rig.scene.reflectors["ahead"] = [0.01, 2.5, 0.0]
    rig.client.prepare()
    rig.client.send(bytes.fromhex("14000000 00000000 3f000000 0000000000000440"))
    assert rig.client.receive().data == bytes.fromhex("10000000 00000000 3f000000 00000000")


def test_golden_event_and_error(rig):
    rig.client.prepare(settings=(2, 0, 0, 0, 1, 0, 0, 1, 0))
    rig.client.do(58, "3d", *rig.scene.reflectors["lamp"])
    ready = rig.client.receive_event(27)[-1]
    assert ready.data == bytes.fromhex("0c000000 08000000 1b000000")
    rig.faults.arm("tracker.beam_broken")
    broken = rig.client.receive_error()
    assert broken.data == bytes.fromhex("10000000 01000000 40000000 bd020000")
