from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tronlab.dataset.journal import Journal, journal_path, read_journal
from tronlab.errors import DatasetError


def test_entries_come_back_in_their_order(tmp_path: Path) -> None:
    path = tmp_path / "dataset.h5"
    assert read_journal(path) == ()
    Journal(path).write("note", "lamp µ\nflickers", author="Ann")
    Journal(path).write("skipped", "shot 7: not settled", shot_id=7)
    first, second = read_journal(path)
    assert (first.kind, first.text, first.fields) == ("note", "lamp µ\nflickers", {"author": "Ann"})
    assert (second.kind, second.fields) == ("skipped", {"shot_id": 7})
    assert first.time_utc <= second.time_utc
    assert len(journal_path(path).read_text(encoding="utf-8").splitlines()) == 2


@pytest.mark.parametrize("torn", [b'{"time_utc": "2026', b"\xff\xfe\x00", b'["a"]', b'{"kind": 1}'])
def test_a_torn_line_harms_no_other(tmp_path: Path, torn: bytes) -> None:
    path = tmp_path / "dataset.h5"
    Journal(path).write("note", "before")
    with journal_path(path).open("ab") as file:
        file.write(torn)
    Journal(path).write("note", "after")
    assert [entry.text for entry in read_journal(path)] == ["before", "after"]


def test_several_write_whole_lines(tmp_path: Path) -> None:
    """Each entry opens the file anew, so that threads are to it what processes are."""
    path = tmp_path / "dataset.h5"

    def write(letter: str) -> None:
        for k in range(8):
            Journal(path).write("note", letter * 500, k=k)

    with ThreadPoolExecutor() as pool:
        list(pool.map(write, "ab"))
    entries = read_journal(path)
    assert len(entries) == 16
    for letter in "ab":
        told = [entry.fields["k"] for entry in entries if entry.text == letter * 500]
        assert told == list(range(8))


def test_a_journal_that_cannot_be_written_is_one_clear_error(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"dataset\.journal\.jsonl: cannot be written: No such"):
        Journal(tmp_path / "nowhere/dataset.h5").write("note", "x")
