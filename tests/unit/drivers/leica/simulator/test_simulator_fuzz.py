"""Nothing a client sends ends the simulated tracker: it drops the client and takes the next."""

import struct

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.leica.simulator.scene import StaticScene
from drivers.leica.simulator.server import TrackerServer
from drivers.leica.simulator.tables import REQUESTS
from drivers.leica.simulator.tracker import Machine
from tronlab.twin.state import ArmedFaults

INSTANT = Machine(initialize_s=0.0, slew_rad_per_s=1e9, face_turn_s=0.0, search_m_per_s=1e9)
RELAXED = settings(
    max_examples=60,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
NOT_ANSWERED = {0}
"""ExitApplication ends the connection."""

numbers = st.one_of(
    st.integers(-(2**31), 2**31 - 1).map(lambda n: struct.pack("<i", n)),
    st.integers(-3, 12).map(lambda n: struct.pack("<i", n)),
    st.floats(width=64).map(lambda x: struct.pack("<d", x)),
    st.floats(-4, 4).map(lambda x: struct.pack("<d", x)),
)
commands = st.sampled_from(sorted(set(REQUESTS) - NOT_ANSWERED))


@pytest.fixture
def server(caplog):
    server = TrackerServer(StaticScene(np.random.default_rng(0)), ArmedFaults({}), machine=INSTANT)
    yield server
    server.close()
    assert not [record.getMessage() for record in caplog.records if record.levelname == "ERROR"]


@RELAXED
@given(data=st.binary(max_size=200))
def test_garbage(server, new_client, data):
    with new_client(server.address) as client:
        client.send(data)
    with new_client(server.address) as client:
        assert client.do(98).at(16, "I") in (1, 2)


@RELAXED
@given(
    size=st.integers(-(2**31), 2**31 - 1) | st.integers(0, 40),
    kind=st.integers(0, 12),
    command=st.integers(-5, 150),
    body=st.binary(max_size=60),
)
def test_requests_of_any_size(server, new_client, size, kind, command, body):
    with new_client(server.address) as client:
        client.send(struct.pack("<iIi", size, kind, command) + body)
    with new_client(server.address) as client:
        assert client.do(98).at(16, "I") in (1, 2)


@RELAXED
@given(asked=st.lists(st.tuples(commands, st.lists(numbers, min_size=12, max_size=12)), max_size=8))
def test_known_commands_with_any_values_are_answered(server, new_client, asked):
    """Each is answered, whatever it says; the connection stays."""
    with new_client(server.address) as client:
        for command, values in asked:
            size = REQUESTS[command].size
            body = b"".join(values)[: size - 12]
            client.send(struct.pack("<iIi", size, 0, command) + body)
            reply = client.receive_until(
                lambda packet, command=command: packet.type == 0 and packet.number == command
            )[-1]
            assert reply.status == 0 or reply.size == 16
            client.do(52)
