from pathlib import Path

from tronlab.errors import (
    ConfigError,
    DeviceFaultError,
    DeviceTimeoutError,
    IntegrityError,
    ProtocolError,
)


def test_a_config_error_says_file_line_and_key():
    error = ConfigError("not a number", path=Path("campaigns/a.yaml"), line=6, key="seed")
    assert str(error) == "campaigns/a.yaml:6: seed: not a number"


def test_a_config_error_without_a_place_is_its_message():
    assert str(ConfigError("no driver")) == "no driver"


def test_a_device_error_names_its_device_and_code():
    assert (
        str(DeviceFaultError("servo off", device="robot", code=41)) == "robot: servo off (code 41)"
    )


def test_a_device_timeout_is_a_timeout_to_everyone():
    assert isinstance(DeviceTimeoutError("no frame in 2 s", device="camera"), TimeoutError)


def test_a_protocol_error_shows_the_bytes():
    error = ProtocolError("bad length", device="tracker", sent=b"\x01\x02", received=b"\xff")
    assert str(error) == "tracker: bad length (sent 01 02; received ff)"


def test_an_integrity_error_lists_every_finding():
    assert str(IntegrityError("2 findings", items=["a", "b"])) == "2 findings\n  - a\n  - b"
