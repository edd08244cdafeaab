from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tronlab.campaign.pace import Pace, describe_split
from tronlab.dataset.records import ShotTiming

SHOT = ShotTiming(
    move_s=4.0, settle_s=1.0, tracker_s=1.0, camera_s=0.5, confirm_s=0.25, read_s=0.25, lost_s=0.0
)
"""Seven seconds, and half a second to write it."""


class Run:
    """Shots one after the other, by a clock that whoever waits sees as well."""

    def __init__(self) -> None:
        self.pace = Pace(start_s=1000.0)
        self.now_s = 1000.0
        self.n_shots = 0

    def take(self, timing: ShotTiming = SHOT, *, passed_s: float = 7.5) -> None:
        self.n_shots += 1
        self.now_s += passed_s + timing.lost_s
        self.pace.learn(self.n_shots, timing, write_s=0.5, now_s=self.now_s)


def test_nothing_is_estimated_before_the_first_shot() -> None:
    assert Pace(start_s=0.0).left_s(10) is None


def test_steady_run_has_its_time_left_from_the_first_shot_on() -> None:
    run = Run()
    for n_left in range(20, -1, -1):
        run.take()
        assert run.pace.left_s(n_left) == pytest.approx(7.5 * n_left)


def test_one_long_suspension_changes_nothing_about_the_rest() -> None:
    run = Run()
    for i in range(10):
        run.take(replace(SHOT, lost_s=36_000.0) if i == 4 else SHOT)
    assert run.pace.left_s(10) == pytest.approx(75.0)
    assert run.pace.split_s["lost"] == 36_000.0


def test_delays_that_come_often_are_expected_to_come_again() -> None:
    run = Run()
    for i in range(100):
        run.take(replace(SHOT, lost_s=6.0 if i % 3 == 0 else 0.0))
    assert run.pace.left_s(100) == pytest.approx(100 * 7.5 + 33 * 6.0, rel=0.06)


def test_moves_left_are_those_of_the_plan_by_how_they_came_true() -> None:
    run = Run()
    run.pace.expect(dict.fromkeys(range(1, 11), 2.0) | dict.fromkeys(range(11, 16), 20.0))
    for _ in range(10):
        run.take()  # 4 s instead of 2 s
    assert run.pace.left_s(5) == pytest.approx(5 * (3.5 + 40.0))
    assert run.pace.left_s(3) == pytest.approx(3 * (3.5 + 40.0))  # two were skipped
    assert run.pace.left_s(7) == pytest.approx(5 * (3.5 + 40.0) + 2 * 7.5)  # two are taken again


def test_simulated_laboratory_takes_as_long_as_whoever_waits_sees() -> None:
    run = Run()
    for i in range(10):  # 7.5 s and an hour of simulated time in 50 ms
        lost_s = 3600.0 if i in {3, 6} else 0.0
        run.now_s -= lost_s
        run.take(replace(SHOT, lost_s=lost_s), passed_s=0.05)
    assert run.pace.left_s(100) == pytest.approx(5.0)
    assert run.pace.split_s["other"] == 0.0


def test_time_that_belongs_to_no_shot_is_shown_and_expected_again() -> None:
    run = Run()
    for i in range(40):
        run.take(passed_s=7.5 + (30.0 if i % 20 == 19 else 0.0))  # a drift check
    assert run.pace.split_s["other"] == pytest.approx(60.0)
    assert run.pace.left_s(20) == pytest.approx(20 * 7.5 + 30.0)


@given(
    st.lists(
        st.tuples(st.floats(0, 100), st.floats(0, 10), st.floats(0, 1e5)), min_size=1, max_size=30
    )
)
def test_parts_add_up_to_what_has_passed(shots: list[tuple[float, float, float]]) -> None:
    run = Run()
    for move_s, other_s, lost_s in shots:
        timing = replace(SHOT, move_s=move_s, lost_s=lost_s)
        run.take(timing, passed_s=move_s + 3.5 + other_s)
    assert sum(run.pace.split_s.values()) == pytest.approx(run.now_s - 1000.0)
    left_s = run.pace.left_s(10)
    assert left_s is not None
    assert 0 <= left_s < 10 * (run.now_s - 1000.0) + 1


def test_split_is_said_in_seconds_and_percent() -> None:
    run = Run()
    run.take(replace(SHOT, lost_s=2.5, read_s=0.0))
    assert describe_split(run.pace) == (
        "motion 4.0 s (40%), settle 1.0 s (10%), tracker 1.0 s (10%), camera 0.5 s (5%),"
        " confirm/read 0.2 s (2%), write 0.5 s (5%), lost 2.5 s (25%), other 0.2 s (2%)"
    )
    assert describe_split(Pace(start_s=0.0)) == "none"
