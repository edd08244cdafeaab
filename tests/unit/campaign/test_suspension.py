from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tronlab.campaign.config import SuspendConfig
from tronlab.campaign.suspension import Patience, Suspension


@given(st.floats(0.01, 60.0), st.floats(0.1, 3600.0))
def test_pauses_grow_and_add_up_to_the_timeout(look_s: float, timeout_s: float):
    patience = Patience(SuspendConfig(look_s=look_s, timeout_s=timeout_s), 0.0)
    waited_s, pauses_s = 0.0, []
    while (pause_s := patience.next_pause_s(waited_s)) is not None:
        waited_s += pause_s
        pauses_s.append(pause_s)
    assert waited_s == pytest.approx(timeout_s)
    assert all(a <= b * (1 + 1e-12) for a, b in pairwise(pauses_s[:-1]))
    assert max(pauses_s) <= max(5.0, look_s)


def test_it_says_what_a_person_should_know():
    assert (
        str(Suspension("shot 7", "unsafe", "room: the door is open; close it"))
        == "waiting before shot 7: room: the door is open; close it; the run goes on by itself"
    )
