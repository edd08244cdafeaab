"""HOST:PORT as people write it."""

from typing import Final

HIGHEST_PORT: Final = 65_535


def parse_address(text: str) -> tuple[str, int]:
    """Read host and port.

    Raises:
        ValueError: The text is no HOST:PORT.
    """
    host, _, port = text.rpartition(":")
    if not (host and port.isdecimal() and int(port) <= HIGHEST_PORT):
        raise ValueError("expected HOST:PORT, such as 127.0.0.1:10600")
    return host, int(port)
