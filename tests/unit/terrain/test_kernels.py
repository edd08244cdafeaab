import logging

import numpy as np
import pytest

from tronlab.terrain import kernels
from tronlab.terrain.kernels import compiled, n_cores, run_interleaved


def mark(out, part, n_parts):
    for i in range(part, out.size, n_parts):
        out[i] += 1


@pytest.mark.parametrize("n_threads", [1, 2, 5])
def test_every_part_runs_once(n_threads):
    out = np.zeros(1000, dtype=np.int64)
    run_interleaved(mark, out, n_threads=n_threads)
    assert np.all(out == 1)


def test_a_failing_part_is_not_lost():
    def fail(part, n_parts):
        if part == n_parts - 1:
            raise ZeroDivisionError("part")

    with pytest.raises(ZeroDivisionError):
        run_interleaved(fail, n_threads=2)


def test_the_log_says_why_the_first_run_takes_long(caplog):
    kernel = compiled(mark)
    with caplog.at_level(logging.INFO, logger="tronlab.terrain.kernels"):
        run_interleaved(kernel, np.zeros(16), n_threads=2)
        run_interleaved(kernel, np.zeros(16), n_threads=2)
    assert caplog.text.count("preparing mark") == 1


def test_without_a_folder_to_cache_in_a_kernel_is_compiled_all_the_same(monkeypatch):
    real_njit = kernels.njit

    def njit(*, cache=False, **options):
        if cache:
            raise RuntimeError("cannot cache function: no locator available")
        return real_njit(**options)

    monkeypatch.setattr(kernels, "njit", njit)
    out = np.zeros(10)
    compiled(mark)(out, 0, 1)
    assert np.all(out == 1)


def test_at_least_one_core():
    assert n_cores() >= 1
