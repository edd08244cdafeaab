import pytest

from tronlab.devices.address import parse_address


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("127.0.0.1:10600", ("127.0.0.1", 10600)),
        ("laboratory:0", ("laboratory", 0)),
        ("::1:65535", ("::1", 65535)),
    ],
)
def test_host_and_port_are_read(text: str, address: tuple[str, int]):
    assert parse_address(text) == address


@pytest.mark.parametrize(
    "text", ["", ":", "here", "here:", ":1", "here:x", "here:-1", "here:65536"]
)
def test_anything_else_is_refused(text: str):
    with pytest.raises(ValueError, match=r"expected HOST:PORT, such as 127\.0\.0\.1:10600"):
        parse_address(text)
