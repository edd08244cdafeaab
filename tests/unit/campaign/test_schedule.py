import pytest

from tronlab.campaign.schedule import Schedule
from tronlab.planning.shots import Plan


def take(schedule: Schedule, *, ids: str = "") -> list[int]:
    """Take all that is left; those of ``ids`` are skipped."""
    taken: list[int] = []
    while schedule.has_next:
        taken.append(schedule.begin_next().shot_id)
        if str(taken[-1]) in ids:
            schedule.skip("why")
        else:
            schedule.note_stored()
    return taken


def test_shots_come_in_the_order_of_the_plan(plan: Plan) -> None:
    schedule = Schedule(plan)
    assert take(schedule, ids="23") == [1, 2, 3, 4]
    assert (schedule.stored, dict(schedule.skipped)) == ({1, 4}, {2: "why", 3: "why"})
    assert (schedule.n_commits, schedule.n_left) == (2, 0)


def test_retaken_shots_come_first_and_once(plan: Plan) -> None:
    schedule = Schedule(plan)
    for _ in range(3):
        schedule.begin_next()
        schedule.note_stored()
    schedule.retake([3, 1, 3])
    schedule.retake([1])
    assert (schedule.n_left, schedule.n_retakes) == (3, 2)
    assert take(schedule) == [1, 3, 4]
    assert (schedule.n_commits, schedule.n_retakes) == (6, 2)


def test_a_skipped_shot_that_is_stored_later_is_no_longer_skipped(plan: Plan) -> None:
    schedule = Schedule(plan)
    take(schedule, ids="1234")
    assert schedule.n_skipped_in_row == 4
    schedule.retake([2])
    assert schedule.n_retakes == 0
    assert take(schedule) == [2]
    assert dict(schedule.skipped) == {1: "why", 3: "why", 4: "why"}
    assert schedule.n_skipped_in_row == 0


def test_a_retake_that_is_skipped_leaves_what_is_stored(plan: Plan) -> None:
    schedule = Schedule(plan)
    take(schedule)
    schedule.retake([2])
    take(schedule, ids="2")
    assert (schedule.stored, dict(schedule.skipped)) == ({1, 2, 3, 4}, {})


def test_nothing_is_stored_or_skipped_without_a_shot_in_hand(plan: Plan) -> None:
    schedule = Schedule(plan)
    with pytest.raises(RuntimeError, match="no shot is in hand"):
        schedule.note_stored()
    with pytest.raises(RuntimeError, match="no shot is in hand"):
        schedule.skip("why")
