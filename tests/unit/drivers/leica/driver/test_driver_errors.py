"""Which error each status number of a tracker becomes, and that nonsense never is a traceback."""

import numpy as np
import pytest
from hypothesis import HealthCheck, event, given, settings
from hypothesis import strategies as st

from drivers.leica.status import error_of, meaning_of
from tronlab.errors import (
    AccessDeniedError,
    DeviceError,
    DeviceFaultError,
    LimitError,
    NotReadyError,
    ProtocolError,
    TrackingLostError,
)

GET_AIR, START = 21, 49
NUMBERS = st.floats(1e-6, 1e-3) | st.sampled_from([0.0, 1e-9, -1.0, 1e7, 1e200, np.inf, np.nan])


@pytest.mark.parametrize(
    ("status", "expected", "text"),
    [
        (1, NotReadyError, "busy"),
        (2, DeviceFaultError, "not implemented"),
        (4, DeviceFaultError, "parameter 1 is wrong"),
        (10, DeviceFaultError, "parameter 7 is wrong"),
        (11, LimitError, "parameter 1 adjusted to its range"),
        (12, LimitError, "parameter 1 is out of range"),
        (21, LimitError, "parameter 6 adjusted to its range"),
        (22, LimitError, "parameter 6 is out of range"),
        (23, DeviceFaultError, "wrong reflector"),
        (37, TrackingLostError, "distance is not known"),
        (39, NotReadyError, "not initialised"),
        (47, DeviceFaultError, "parameter 8 is wrong"),
        (55, DeviceFaultError, "parameter 16 is wrong"),
        (75, DeviceFaultError, "probe missing"),
        (76, DeviceFaultError, "probe missing"),
        (93, TrackingLostError, "6-D result is bad"),
        (701, TrackingLostError, "beam is broken"),
        (10004, NotReadyError, "not ready to measure"),
        (10011, AccessDeniedError, "another client"),
        (10012, NotReadyError, "not warmed up"),
        (10013, NotReadyError, "not stable"),
        (10014, NotReadyError, "system not ready"),
        (24020, DeviceFaultError, "does not know"),
        (4_294_967_295, DeviceFaultError, "does not know"),
    ],
)
def test_status_becomes_its_error(status: int, expected: type[DeviceError], text: str):
    error = error_of(status, "measure_pose", device="left")
    assert type(error) is expected
    assert str(error).startswith("left: measure_pose: ")
    assert text in str(error)
    assert f"code {status}" in str(error)
    if isinstance(error, DeviceFaultError):
        assert error.code == status


def test_meanings_of_different_numbers_differ():
    known = [n for n in range(1, 11_000) if "does not know" not in meaning_of(n)]
    assert len(known) > 60
    assert len({meaning_of(n) for n in known}) == len(known)


@settings(
    max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(nonsense=st.binary(min_size=1, max_size=500), command=st.sampled_from([GET_AIR, START]))
def test_nonsense_is_always_a_device_error(peer, make, nonsense: bytes, command: int):
    """Whatever comes, the call ends with an error of the tree, and a new connection works."""
    tracker = make(timeout_s=0.2)
    peer.answers.pop(command, None)
    tracker.connect()
    peer.answers[command] = nonsense
    with pytest.raises(DeviceError, match=r"^tracker: (weather|measure_pose): "):
        tracker.weather() if command == GET_AIR else tracker.measure_pose(window_s=0.1)
    tracker.close()


@settings(
    max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(changed=st.dictionaries(st.integers(0, 40), NUMBERS, max_size=3))
def test_any_numbers_in_a_result_are_a_sound_reading_or_a_protocol_error(
    peer, tracker, changed: dict[int, float]
):
    packet = bytearray(peer.pose())
    for i, value in changed.items():
        peer.put(packet, 48 + 8 * i, "d", value)
    peer.answers[START] = peer.reply(START) + packet
    try:
        reading = tracker.measure_pose(window_s=0.1)
    except ProtocolError:
        event("refused")
    else:
        event("accepted")
        assert np.isfinite(reading.trk_from_tmac.as_matrix()).all()
        assert np.linalg.eigvalsh(reading.covariance).min() > 0.0
    assert tracker.weather().pressure_pa == pytest.approx(98_750.0)
