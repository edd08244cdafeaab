"""Mapped files: what is in memory of them is let go, and read again when it is needed."""

import time
from pathlib import Path

import numpy as np
import pytest

from tronlab.terrain import mapped
from tronlab.terrain.mapped import map_floats

pytestmark = pytest.mark.skipif(
    not Path("/proc/self/smaps_rollup").exists(), reason="memory is told by Linux only"
)


def resident_kb(path):
    """How much of a file this process has in memory."""
    lines = iter(Path("/proc/self/smaps").read_text().splitlines())
    for line in lines:
        if line.endswith(path.name):
            return next(int(rest.split()[1]) for rest in lines if rest.startswith("Rss:"))
    return None


@pytest.fixture
def floats(tmp_path):
    values = np.random.default_rng(1).random(500_000, dtype=np.float32)
    values.tofile(tmp_path / "values.f32")
    return tmp_path / "values.f32", values


def test_a_small_map_stays(floats):
    path, values = floats
    found = map_floats(path, (1000, 499), offset=4)
    np.testing.assert_array_equal(found.ravel(), values[1:499_001])
    assert resident_kb(path) > 1900


def test_pages_of_a_large_map_are_let_go_and_read_again(floats, monkeypatch):
    monkeypatch.setattr(mapped, "MAX_SAMPLES_IN_MEMORY", 1000)
    monkeypatch.setattr(mapped, "RESIDENT_BYTES", 0)
    path, values = floats
    found = map_floats(path, values.shape)
    np.testing.assert_array_equal(found, values)
    end = time.monotonic() + 20
    while resident_kb(path) > 0 and time.monotonic() < end:
        time.sleep(0.01)
    assert resident_kb(path) == 0
    np.testing.assert_array_equal(found, values)


def test_the_watch_ends_with_the_last_map(floats, monkeypatch):
    monkeypatch.setattr(mapped, "MAX_SAMPLES_IN_MEMORY", 1000)
    path, values = floats
    found = map_floats(path, values.shape)
    assert mapped._keeper._is_running
    del found
    end = time.monotonic() + 20
    while mapped._keeper._is_running and time.monotonic() < end:
        time.sleep(0.01)
    assert not mapped._keeper._is_running
