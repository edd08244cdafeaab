"""The simulator's reader of XML documents that follow each other on a stream."""

import pytest

from drivers.kuka.simulator.tags import BUFFER_BYTES, DocumentReader, MalformedError, document

ONE = b'<A X="1"><B Y="2" Z=\'-3.5e-1\'></B><C/></A>'
TWO = b'<A X="7"><B Y="8" Z="9"/></A>'
ONE_READ = {"A/@X": "1", "A/B/@Y": "2", "A/B/@Z": "-3.5e-1"}
TWO_READ = {"A/@X": "7", "A/B/@Y": "8", "A/B/@Z": "9"}


@pytest.mark.parametrize("size", [1, 2, 3, 7, 1000])
def test_documents_split_and_joined_anywhere_are_read(size):
    stream = ONE + b"\r\n " + TWO + ONE
    reader = DocumentReader()
    read = [
        values for i in range(0, len(stream), size) for values in reader.feed(stream[i : i + size])
    ]
    assert read == [ONE_READ, TWO_READ, ONE_READ]


def test_nothing_is_read_before_the_root_is_closed():
    reader = DocumentReader()
    assert list(reader.feed(ONE[:-1])) == []
    assert list(reader.feed(ONE[-1:])) == [ONE_READ]


@pytest.mark.parametrize(
    "stream",
    [
        b"hello",
        b"<A>text</A>",
        b"<A></B>",
        b"</A>",
        b"<A X=1></A>",
        b"<?xml version='1.0'?>",
        b"< A>",
    ],
)
def test_what_is_no_document_is_an_error(stream):
    with pytest.raises(MalformedError):
        list(DocumentReader().feed(stream))


def test_document_without_end_is_an_error_once_the_buffer_is_full():
    reader = DocumentReader()
    list(reader.feed(b"<A>"))
    with pytest.raises(MalformedError, match="no end"):
        list(reader.feed(b"<B></B>" * (BUFFER_BYTES // 7 + 1)))


def test_document_is_written_with_closing_tags():
    written = document("A", {"X": "1"}, B={"Y": "2"}, C={})
    assert written == b'<A X="1"><B Y="2"></B><C></C></A>'
