"""Counting of frames by their block ids."""

import pytest

from drivers.gige.stream import BlockIds, StreamCounters


def ids_of(*block_ids: int) -> BlockIds:
    ids = BlockIds()
    for block_id in block_ids:
        ids.add(block_id)
    return ids


@pytest.mark.parametrize(
    ("block_ids", "n_missing"),
    [
        ((), 0),
        ((7,), 0),
        ((1, 2, 3), 0),
        ((1, 3, 6), 3),
        ((65534, 65535, 1, 2), 0),  # 0 is no block id
        ((65534, 2), 2),
        ((5, 7, 6, 8), 0),  # 6 was completed by a resend after 7 had come
        ((65535, 2, 1, 3), 0),
        ((2, 1, 3), 0),
        ((65534, 65535, 65536, 65537), 0),  # 64-bit ids go on
        ((2**40, 2**40 + 2), 1),
    ],
)
def test_missing_ids_are_counted(block_ids: tuple[int, ...], n_missing: int):
    ids = ids_of(*block_ids)
    assert (ids.n, ids.n_missing) == (len(block_ids), n_missing)


def test_ids_may_begin_anew_many_times():
    ids = BlockIds()
    for i in range(0, 3 * 65535, 5):
        ids.add(i % 65535 + 1)
    assert ids.n_missing == 4 * (ids.n - 1)


def test_incomplete_frames_are_not_lost_ones():
    counters = StreamCounters.of(ids_of(1, 2, 5, 6), n_incomplete=1)
    assert counters == StreamCounters(n_delivered=4, n_incomplete=1, n_lost=1)


def test_incomplete_frames_at_the_ends_do_not_make_losses_negative():
    assert StreamCounters.of(ids_of(2, 3), n_incomplete=2).n_lost == 0
