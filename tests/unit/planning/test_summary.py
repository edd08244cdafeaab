from dataclasses import replace
from datetime import datetime

import pytest
from planned import TOO_DARK, planned

from tronlab.planning.summary import (
    CHECK_LABELS,
    PART_LABELS,
    brief_summary,
    counts_by_check,
    duration_text,
    end_line,
    full_summary,
    verdict,
)

BEGUN = datetime(2026, 11, 22, 23, 50)


def test_full_summary_says_what_is_refused_why_and_what_could_be_done():
    lines = full_summary(planned(), begun=BEGUN).splitlines()
    assert lines[0] == "plan: 6 shots, 2 refused, 1 with a warning"
    rows = {line.rsplit(maxsplit=2)[0]: line.split()[-2:] for line in lines[2:12]}
    assert rows["usable part of the image"] == ["1", "-"]
    assert rows["reach of rail and arm"] == ["1", "-"]
    assert rows["light on the model"] == ["-", "2"]
    assert rows["collision"] == ["-", "-"]
    assert f"warned: shot 2: {TOO_DARK.text} (and 1 more warnings of this kind)" in lines, (
        "one line a kind"
    )
    at = lines.index("refused: shot 1: 12.0 % of the image shows the model, at least 20 % shall")
    assert lines[at + 1] == (
        "  nearest pose that can be taken: 50 mm and 0.0 deg away,"
        " camera at x y z 1.080 2.110 3.960 m"
    )
    assert lines[at + 3] == "  nearest pose that can be taken: none known"
    assert "3.0 % of what is seen" not in lines[at + 2], "a warning is no reason to refuse"


def test_times_of_the_parts_add_up_to_the_total():
    plan = planned()
    assert sum(plan.parts_s.values()) == pytest.approx(plan.total_s) == pytest.approx(36.0)
    assert set(PART_LABELS) == set(plan.parts_s), "every part has a name for people"
    text = full_summary(plan, begun=BEGUN)
    assert "motion            0:00:12   33 %" in text
    assert "total             0:00:36" in text


def test_labels_name_every_check():
    assert set(counts_by_check(planned())) == set(CHECK_LABELS)


def test_a_check_that_refuses_and_warns_of_a_shot_counts_once():
    plan = planned()
    both = (*plan.shots[0].findings, replace(plan.shots[0].findings[0], is_refusal=False))
    plan = replace(plan, shots=(replace(plan.shots[0], findings=both), *plan.shots[1:]))
    assert counts_by_check(plan)["usable"] == (1, 0)


def test_brief_summary_is_a_few_lines_however_many_shots_are_refused():
    plan = planned()
    plan = replace(plan, shots=(plan.shots[0],) * 400)
    lines = brief_summary(plan, begun=BEGUN).splitlines()
    assert len(lines) == 6
    assert lines[-2:] == [
        "refused: 397 more shots",
        "estimated time: none, no shot can be taken",
    ]


def test_brief_summary_tells_warnings_but_no_nearest_poses():
    text = brief_summary(planned(), begun=BEGUN)
    assert f"warned: shot 2: {TOO_DARK.text} (and 1 more" in text
    assert "nearest" not in text


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0, "0:00:00"), (59.6, "0:01:00"), (3599.7, "1:00:00"), (360061, "100:01:01")],
)
def test_durations_are_rounded_to_seconds(seconds: float, text: str):
    assert duration_text(seconds) == text


def test_the_day_is_named_if_the_run_ends_on_another_one():
    plan = replace(planned(), start_s=3600.0)
    assert end_line(plan, begun=BEGUN).endswith("begun at 23:50, done at Mon 23 Nov 00:50")
    assert end_line(planned(), begun=BEGUN).endswith("begun at 23:50, done at 23:50")


def test_verdict_on_every_outcome():
    plan = planned()
    assert verdict(replace(plan, shots=plan.shots[1:5]), leaves_out_refused=False)[0]
    can_run, text = verdict(plan, leaves_out_refused=False)
    assert not can_run
    assert "plan.on_refused: skip" in text
    can_run, text = verdict(plan, leaves_out_refused=True)
    assert can_run
    assert "4 are left" in text
    can_run, _ = verdict(replace(plan, shots=plan.shots[:1]), leaves_out_refused=True)
    assert not can_run, "there would be nothing to take"
