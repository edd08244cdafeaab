"""What is kept from one scoring to the next: whole, bounded, and forgotten when damaged."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tronlab.score.rescoring.cache import AnswerCache
from tronlab.score.rescoring.packing import pack
from tronlab.score.rescoring.stage_files import StageFiles

PACKED = pack({"a": 1}, {"x": np.arange(100.0)})


def opened(folder: Path, said: list[str] | None = None, **fields: int) -> AnswerCache:
    return AnswerCache(folder, say=(said if said is not None else []).append, **fields)


def test_what_is_kept_is_found_by_another_process_at_the_same_time(tmp_path: Path) -> None:
    with opened(tmp_path) as one, opened(tmp_path) as two:
        one.keep({"a": PACKED, "b": PACKED})
        two.keep({f"{i}": PACKED for i in range(1200)})
        assert two.find(["a", "x", "b"]) == {"a": PACKED, "b": PACKED}
        assert len(one.find([f"{i}" for i in range(1300)])) == 1200


def test_a_killed_process_loses_nothing_that_it_had_kept(tmp_path: Path) -> None:
    program = (
        "import sys, time; from pathlib import Path\n"
        "from tronlab.score.rescoring.cache import AnswerCache\n"
        "cache = AnswerCache(Path(sys.argv[1]), say=print)\n"
        "from tronlab.score.rescoring.packing import pack\n"
        "for i in range(10**9):\n"
        "    cache.keep({str(i): pack({'i': i}, {})}); print(i, flush=True)\n"
    )
    command = [sys.executable, "-c", program, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        while int(child.stdout.readline()) < 20:
            pass
        child.kill()
        n = int((child.stdout.read().split() or ["20"])[-1])
    said: list[str] = []
    with opened(tmp_path, said) as cache:
        found = cache.find([str(i) for i in range(n + 1)])
    assert len(found) == n + 1
    assert said == []


def test_a_damaged_answer_is_forgotten_and_told(tmp_path: Path) -> None:
    with opened(tmp_path) as cache:
        cache.keep({"a": PACKED, "b": PACKED[:-1]})
        path = cache.path
    said: list[str] = []
    with opened(tmp_path, said) as cache:
        assert list(cache.find(["a", "b"])) == ["a"]
        cache.keep({"b": PACKED})
        assert list(cache.find(["a", "b"])) == ["a", "b"]
    assert said == [f"{path}: 1 kept answers are damaged and are computed anew"]


@pytest.mark.parametrize("damage", [b"no database", b"SQLite format 3\0" + bytes(200)])
def test_a_damaged_file_is_begun_anew_and_told(tmp_path: Path, damage: bytes) -> None:
    with opened(tmp_path) as cache:
        cache.keep({"a": PACKED})
        path = cache.path
    for beside in tmp_path.glob("*-*m") or ():
        beside.unlink()
    path.write_bytes(damage + path.read_bytes()[len(damage) :])
    said: list[str] = []
    with opened(tmp_path, said) as cache:
        assert cache.find(["a"]) == {}
        cache.keep({"a": PACKED})
        assert cache.find(["a"]) == {"a": PACKED}
    assert len(said) == 1
    assert "damaged and are forgotten" in said[0]


def test_damage_within_is_told_and_the_next_scoring_begins_anew(tmp_path: Path) -> None:
    with opened(tmp_path) as cache:
        cache.keep({f"{i:03}": PACKED for i in range(300)})
        path = cache.path
    content = bytearray(path.read_bytes())
    content[8192:-4096] = os.urandom(len(content) - 12288)
    path.write_bytes(content)
    said: list[str] = []
    with opened(tmp_path, said) as cache:
        cache.find([f"{i:03}" for i in range(300)])
        cache.keep({"a": PACKED})
        cache.find(["a"])
    assert said
    with opened(tmp_path) as cache:
        cache.keep({"a": PACKED})
        assert cache.find(["a"]) == {"a": PACKED}


def test_a_folder_that_cannot_be_had_keeps_nothing_and_says_so_once(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    said: list[str] = []
    with opened(tmp_path / "file" / "cache", said) as cache:
        cache.keep({"a": PACKED})
        assert cache.find(["a"]) == {}
    assert len(said) == 1
    assert "no answers are kept" in said[0]


def test_a_full_disk_ends_the_keeping_but_not_the_scoring(tmp_path: Path) -> None:
    said: list[str] = []
    with opened(tmp_path, said) as cache:
        cache.keep({"a": PACKED})
        assert cache._database is not None
        cache._database.execute("pragma max_page_count = 1")  # SQLite's "disk is full"
        cache.keep({f"{i}": bytes(5000) for i in range(50)})
        cache.keep({"b": PACKED})
    assert len(said) == 1
    assert "full" in said[0]
    with opened(tmp_path) as cache:
        assert cache.find(["a"]) == {"a": PACKED}


def test_the_oldest_answers_go_when_there_are_too_many(tmp_path: Path) -> None:
    most = 20 * len(PACKED)
    with opened(tmp_path, most_bytes=most) as cache:
        for i in range(100):
            cache.keep({f"{i}": PACKED})
            assert cache.find(["0"])  # used again and again
        found = cache.find([f"{i}" for i in range(100)])
        assert 10 < len(found) <= 20
        assert {"0", "99", "98"} <= set(found)
        size = cache.path.stat().st_size
    assert size < 4 * most


def test_stages_come_back_or_are_not_there(tmp_path: Path) -> None:
    store = StageFiles(tmp_path)
    assert store.load("features", "ab" * 20) is None
    arrays = {"uv": np.random.default_rng(1).normal(size=(9, 2)), "time_s": np.array(0.25)}
    store.save("features", "ab" * 20, arrays)
    back = StageFiles(tmp_path).load("features", "ab" * 20)
    assert back is not None
    for name, array in arrays.items():
        np.testing.assert_array_equal(back[name], array)
    assert store.load("matches", "ab" * 20) is None
    (path,) = tmp_path.rglob("*.bin")
    path.write_bytes(path.read_bytes()[:-3])
    assert store.load("features", "ab" * 20) is None
    assert not path.exists()


def test_stages_that_cannot_be_kept_are_no_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    store = StageFiles(tmp_path / "file")
    store.save("features", "abc", {"x": np.zeros(3)})
    assert store.load("features", "abc") is None


def test_the_oldest_stages_and_what_was_abandoned_go(tmp_path: Path) -> None:
    n_bytes = len(pack({}, {"x": np.zeros(1000)}))
    store = StageFiles(tmp_path, most_bytes=10 * n_bytes)
    store.save("features", "aa-old", {"x": np.zeros(1000)})
    (old,) = tmp_path.rglob("*.bin")
    os.utime(old, (1.0, 1.0))
    part = old.with_name("left.part")
    part.write_bytes(b"")
    os.utime(part, (1.0, 1.0))
    for i in range(30):
        store.save("features", f"bb{i}", {"x": np.zeros(1000)})
    assert not old.exists()
    assert not part.exists()
    assert 5 <= len(list(tmp_path.rglob("*.bin"))) <= 11
    assert store.load("features", "bb29") is not None
