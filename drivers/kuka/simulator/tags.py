"""EthernetKRL's view of XML: a document is a list of tags such as ``RobotCommand/Axis/@A1``.

The wire is documents one after another, with no length, end mark or XML declaration; TCP splits and
joins them anywhere. Only elements and attributes are known: no text, comments or entities.
"""

import re
from collections.abc import Iterator, Mapping
from typing import Final

BUFFER_BYTES: Final = 16384
"""The channel's buffer, ``BUFFSIZE`` by default."""

_TAG = re.compile(
    rb"""<(?P<close>/?)(?P<name>[A-Za-z_]\w*)(?P<attributes>(?:\s+\w+\s*=\s*(?:"[^"<]*"|'[^'<]*'))*)"""
    rb"""\s*(?P<empty>/?)>"""
)
_ATTRIBUTE = re.compile(rb"""(\w+)\s*=\s*(?:"([^"]*)"|'([^']*)')""")


class MalformedError(Exception):
    """The stream is not what the channel is configured for."""


class DocumentReader:
    """Cuts documents out of a stream."""

    def __init__(self) -> None:
        self._buffer = b""

    def feed(self, data: bytes) -> Iterator[dict[str, str]]:
        """Take some bytes and give the documents that they complete, each as tags and values.

        Raises:
            MalformedError: Not XML of this kind, or a document that does not end.
        """
        self._buffer += data
        while (cut := self._cut()) is not None:
            yield cut
        if len(self._buffer) > BUFFER_BYTES:
            raise MalformedError(f"no end of the document within {BUFFER_BYTES} bytes")

    def _cut(self) -> dict[str, str] | None:
        """Give the next whole document; None if it is not there yet."""
        values: dict[str, str] = {}
        path: list[str] = []
        at = 0
        while (start := self._buffer.find(b"<", at)) >= 0:
            self._check_blank(self._buffer[at:start])
            end = self._buffer.find(b">", start)
            if end < 0:
                return None
            at = end + 1
            _read_tag(self._buffer[start:at], path, values)
            if not path:
                self._buffer = self._buffer[at:]
                return values
        self._check_blank(self._buffer[at:])
        return None

    def _check_blank(self, text: bytes) -> None:
        if text.strip():
            raise MalformedError(f"text between tags: {text[:40]!r}")


def _read_tag(text: bytes, path: list[str], values: dict[str, str]) -> None:
    tag = _TAG.fullmatch(text)
    if tag is None:
        raise MalformedError(f"no tag: {text[:80]!r}")
    name = tag["name"].decode()
    if tag["close"]:
        if not path or path.pop() != name:
            raise MalformedError(f"{text[:80]!r} closes nothing")
        return
    path.append(name)
    for key, double, single in _ATTRIBUTE.findall(tag["attributes"]):
        values[f"{'/'.join(path)}/@{key.decode()}"] = (double or single).decode("latin-1")
    if tag["empty"]:
        path.pop()


def document(root: str, attributes: Mapping[str, str], **children: Mapping[str, str]) -> bytes:
    """Write a document; empty elements have a closing tag of their own, as EthernetKRL sends."""
    inside = "".join(_element(name, values, "") for name, values in children.items())
    return _element(root, attributes, inside).encode("ascii")


def _element(name: str, attributes: Mapping[str, str], inside: str) -> str:
    listed = "".join(f' {key}="{value}"' for key, value in attributes.items())
    return f"<{name}{listed}>{inside}</{name}>"
