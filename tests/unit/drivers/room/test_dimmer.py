"""The dimmer: bytes of the widget's messages, and levels in channels."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.room.dimmer import Dimmer, MessageReader, WidgetMessage
from drivers.room.options import DimmerOptions
from tronlab.errors import DeviceTimeoutError, LimitError, NotConnectedError

GOLDEN = bytes.fromhex("7e 06 19 00 00 ff 10") + bytes(22) + bytes.fromhex("e7")
"""24 channels, 255 in the first and 16 in the second; captured from DMXEnttecPro 0.4."""

MESSAGES = st.builds(WidgetMessage, st.integers(0, 255), st.binary(max_size=600))


def test_a_message_has_the_golden_bytes():
    assert bytes(WidgetMessage(6, bytes((0, 255, 16)) + bytes(22))) == GOLDEN


@settings(deadline=None)
@given(messages=st.lists(MESSAGES, max_size=4), size=st.integers(1, 50))
def test_messages_survive_pieces_of_any_size(messages: list[WidgetMessage], size: int):
    stream = b"".join(bytes(message) for message in messages)
    reader = MessageReader()
    found = [
        message
        for start in range(0, len(stream), size)
        for message in reader.feed(stream[start : start + size])
    ]
    assert found == messages


@settings(deadline=None)
@given(noise=st.binary(max_size=40).filter(lambda noise: b"\x7e" not in noise), message=MESSAGES)
def test_noise_before_a_message_is_skipped(noise: bytes, message: WidgetMessage):
    assert MessageReader().feed(noise + bytes(message)) == [message]


@settings(deadline=None)
@given(noise=st.binary(max_size=300))
def test_no_noise_breaks_the_reader(noise: bytes):
    reader = MessageReader()
    reader.feed(noise)
    whole = bytes(WidgetMessage(3, b"\x00\x01"))
    for _ in range(400):  # a false beginning can claim 600 bytes of what follows
        if WidgetMessage(3, b"\x00\x01") in reader.feed(whole):
            return
    pytest.fail("the reader never recovers")


def channels_sent(level: float, **options: int) -> bytes:
    """Give the DMX channels of a level, from 1 on."""
    dimmer = Dimmer(DimmerOptions(path="x", **options), device="here")
    return dimmer._channels(level)


@pytest.mark.parametrize(("level", "value"), [(0.0, 0), (0.5, 128), (0.999, 255), (1.0, 255)])
def test_eight_bits_go_to_one_channel(level: float, value: int):
    channels = channels_sent(level, channel=3)
    assert channels == bytes((0, 0, value)) + bytes(21)


@settings(deadline=None)
@given(level=st.floats(0.0, 1.0))
def test_sixteen_bits_are_that_exact(level: float):
    channels = channels_sent(level, channel=30, fine_channel=29)
    assert len(channels) == 30
    value = channels[29] * 256 + channels[28]
    assert value / 65535 == pytest.approx(level, abs=0.5001 / 65535)


@pytest.mark.parametrize("level", [-0.1, 1.01, float("nan")])
def test_a_level_beyond_its_range_is_refused(level: float):
    dimmer = Dimmer(DimmerOptions(path="x"), device="here")
    with pytest.raises(LimitError, match="allowed 0 to 1"):
        dimmer.set_level(level)


def test_nothing_is_set_without_a_connection():
    dimmer = Dimmer(DimmerOptions(path="x"), device="here")
    with pytest.raises(NotConnectedError, match="dimmer at x: not connected"):
        dimmer.set_level(1.0)
    assert dimmer.level is None


def test_serial_number_and_firmware(lab):
    dimmer = Dimmer(lab.options.dimmer, device="here")
    dimmer.connect()
    identity = dimmer.identify()
    dimmer.close()
    assert (identity.serial, identity.firmware) == ("07654321", "1.44")
    assert dimmer.level is None


def test_a_silent_widget_is_seen_when_connecting(lab, faults):
    faults.arm("room.dimmer_silent")
    dimmer = Dimmer(lab.options.dimmer, device="here")
    with pytest.raises(DeviceTimeoutError, match="no answer from the dimmer"):
        dimmer.connect()
    dimmer.close()
