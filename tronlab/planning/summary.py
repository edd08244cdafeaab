"""What a plan comes to, as lines for a person: before a run, and after ``tronlab plan``."""

from collections import Counter
from collections.abc import Iterator, Mapping
from datetime import datetime, timedelta
from types import MappingProxyType
from typing import get_args

import numpy as np

from tronlab.geometry.poses import rotation_angle_rad
from tronlab.planning.assessment import CheckName, PlanAssessment, ShotAssessment

PART_LABELS: Mapping[str, str] = MappingProxyType(
    {
        "start_s": "start",
        "move_s": "motion",
        "settle_s": "settling",
        "tracker_s": "tracker",
        "camera_s": "camera",
        "confirm_s": "confirmation",
        "read_s": "robot and room",
        "write_s": "writing",
        "drift_checks_s": "drift checks",
    }
)
"""What the parts of ``PlanAssessment.parts_s`` are called, in the order a run has them."""
CHECK_LABELS: Mapping[CheckName, str] = MappingProxyType(
    {
        "reach": "reach of rail and arm",
        "branch": "configuration of the arm",
        "singularity": "singular axes",
        "collision": "collision",
        "sight": "sight of the T-MAC",
        "view": "view of the terrain",
        "usable": "usable part of the image",
        "range": "range",
        "light": "light on the model",
    }
)
N_LISTED = 20
"""More refused shots are in the report and in its tables, not on the terminal."""
_N_BRIEF = 3
"""Refused shots that a run's own summary names."""


def full_summary(assessment: PlanAssessment, *, begun: datetime) -> str:
    """Give what ``tronlab plan`` prints: counts, table by check, times and refused shots.

    Args:
        assessment: The plan.
        begun: When the run would begin; the summary says when it would be done.
    """
    blocks = [
        [f"plan: {count_line(assessment)}"],
        list(_check_rows(assessment)),
        [*_time_rows(assessment), end_line(assessment, begun=begun)],
        [
            *_warned_rows(assessment),
            *_refused_rows(assessment, most=N_LISTED, names_nearest=True),
        ],
    ]
    return "\n\n".join("\n".join(block) for block in blocks if block)


def brief_summary(assessment: PlanAssessment, *, begun: datetime) -> str:
    """Give the few lines that stand before a run."""
    return "\n".join(
        [
            f"plan: {count_line(assessment)}",
            *_warned_rows(assessment),
            *_refused_rows(assessment, most=_N_BRIEF, names_nearest=False),
            end_line(assessment, begun=begun),
        ]
    )


def verdict(assessment: PlanAssessment, *, leaves_out_refused: bool) -> tuple[bool, str]:
    """Tell whether a run would begin, and say it in one sentence.

    Args:
        assessment: The plan.
        leaves_out_refused: Whether the campaign wants refused shots left out instead of no run.
    """
    n_all, n_refused = len(assessment.shots), len(assessment.refused)
    if not n_refused:
        return True, "The campaign can run."
    if n_refused == n_all:
        return False, "The campaign cannot run: every shot is refused."
    if leaves_out_refused:
        return True, (
            f"The campaign can run without the {n_refused} refused shots, {n_all - n_refused} are"
            " left (plan.on_refused: skip)."
        )
    return False, (
        "The campaign cannot run: change the refused shots, or have them left out with"
        " plan.on_refused: skip."
    )


def count_line(assessment: PlanAssessment) -> str:
    """Say how many shots there are, and how many are refused or warned of."""
    n_refused = len(assessment.refused)
    n_warned = sum(bool(shot.findings) and not shot.is_refused for shot in assessment.shots)
    parts = [
        f"{len(assessment.shots)} shots",
        f"{n_refused} refused" if n_refused else "none refused",
        *([f"{n_warned} with a warning"] if n_warned else []),
    ]
    return ", ".join(parts)


def end_line(assessment: PlanAssessment, *, begun: datetime) -> str:
    """Say how long the run takes, and when it would be done."""
    n_left = len(assessment.shots) - len(assessment.refused)
    if not n_left:
        return "estimated time: none, no shot can be taken"
    done = begun + timedelta(seconds=assessment.total_s)
    of_shots = f" of the {n_left} shots that can be taken" if assessment.refused else ""
    day = "" if done.date() == begun.date() else f"{done:%a %d %b} "
    return (
        f"estimated time{of_shots}: {duration_text(assessment.total_s)},"
        f" begun at {begun:%H:%M}, done at {day}{done:%H:%M}"
    )


def duration_text(seconds: float) -> str:
    """Give a time as h:mm:ss."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}"


def counts_by_check(assessment: PlanAssessment) -> dict[CheckName, tuple[int, int]]:
    """Give, for each check, how many shots it refuses and how many it only warns of."""
    refusing: Counter[CheckName] = Counter()
    warning: Counter[CheckName] = Counter()
    for shot in assessment.shots:
        found: set[CheckName] = {finding.check for finding in shot.findings}
        refused: set[CheckName] = {finding.check for finding in shot.findings if finding.is_refusal}
        refusing.update(refused)
        warning.update(found - refused)
    names: tuple[CheckName, ...] = get_args(CheckName)
    return {name: (refusing[name], warning[name]) for name in names}


def nearest_text(shot: ShotAssessment) -> str:
    """Say where the nearest pose that can be taken is, and how far."""
    if shot.nearest is None:
        return "none known"
    wanted = shot.shot.trs_from_cam_nominal
    shift_mm = 1e3 * float(np.linalg.norm(shot.nearest.translation - wanted.translation))
    turn_deg = float(np.degrees(rotation_angle_rad(wanted, shot.nearest)))
    place = " ".join(f"{value:.3f}" for value in shot.nearest.translation)
    return f"{shift_mm:.0f} mm and {turn_deg:.1f} deg away, camera at x y z {place} m"


def _check_rows(assessment: PlanAssessment) -> Iterator[str]:
    width = max(map(len, CHECK_LABELS.values()))
    yield f"{'check':<{width}}  refused   warned"
    for name, (n_refused, n_warned) in counts_by_check(assessment).items():
        yield f"{CHECK_LABELS[name]:<{width}}  {n_refused or '-':>7}  {n_warned or '-':>7}"


def _time_rows(assessment: PlanAssessment) -> Iterator[str]:
    parts_s, total_s = assessment.parts_s, assessment.total_s
    width = max(map(len, PART_LABELS.values()))
    yield f"{'time':<{width}}  {'h:mm:ss':>9}   part"
    for name, label in PART_LABELS.items():
        share = 100 * parts_s[name] / total_s if total_s > 0 else 0.0
        yield f"{label:<{width}}  {duration_text(parts_s[name]):>9}  {share:3.0f} %"
    yield f"{'total':<{width}}  {duration_text(total_s):>9}"


def _warned_rows(assessment: PlanAssessment) -> Iterator[str]:
    """Give the first warning of each check: the others of it are of the same kind."""
    for name in CHECK_LABELS:
        texts = [
            f"shot {shot.shot.shot_id}: {finding.text}"
            for shot in assessment.shots
            for finding in shot.findings
            if finding.check == name and not finding.is_refusal
        ]
        if texts:
            more = f" (and {len(texts) - 1} more warnings of this kind)" if texts[1:] else ""
            yield f"warned: {texts[0]}{more}"


def _refused_rows(assessment: PlanAssessment, *, most: int, names_nearest: bool) -> Iterator[str]:
    refused = assessment.refused
    for shot in refused[:most]:
        reasons = [finding.text for finding in shot.findings if finding.is_refusal]
        yield f"refused: shot {shot.shot.shot_id}: {'; '.join(reasons)}"
        if names_nearest:
            yield f"  nearest pose that can be taken: {nearest_text(shot)}"
    if len(refused) > most:
        yield f"refused: {len(refused) - most} more shots"
