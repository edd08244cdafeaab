"""Everything that can be known of a plan before the robot moves, shot by shot."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.devices.protocols import MotionModel
from tronlab.devices.readings import Posture
from tronlab.planning.assessment import PlanAssessment, ShotAssessment, ShotDuration
from tronlab.planning.context import PlanContext
from tronlab.planning.duration import drift_checks_s, shot_duration
from tronlab.planning.examination import Exam, Examiner, check_postures
from tronlab.planning.feasible import nearest_feasible
from tronlab.planning.passage import check_clearance_along
from tronlab.planning.reach import Reach, check_reach_along
from tronlab.planning.shots import Plan, Shot

MAX_TRIES = 400
_TRIES_A_SHOT = (10, 60)
"""Least and most: where there are many refused shots, the last ones get none."""

_SAME_RAD = 1e-6
"""Axes that differ by no more than rounding stand alike."""

_NO_TIME = ShotDuration(
    move_s=0.0, settle_s=0.0, tracker_s=0.0, camera_s=0.0, confirm_s=0.0, read_s=0.0, write_s=0.0
)


def assess(
    plan: Plan,
    context: PlanContext,
    *,
    max_tries: int = MAX_TRIES,
    on_shot: Callable[[int, int], None] | None = None,
) -> PlanAssessment:
    """Hold a plan against everything that is known of the laboratory; nothing moves.

    Ways are checked, and timed, between shots that will be taken: refused ones are passed by. How
    long the way to the first shot takes is not known, for nobody knows where the robot stands.

    Args:
        plan: Shots in the order they would be taken.
        context: What it is held against.
        max_tries: How many poses may be tried instead of refused ones; 0: none.
        on_shot: Told (shots examined, shots in all) after each.
    """
    examiner = Examiner(context)
    exams: dict[int, Exam] = {}
    reaches = check_reach_along(plan.shots, context.robot)
    checks = check_postures([reach.posture for reach in reaches], context.scene)
    todo = zip(plan.shots, reaches, checks, strict=True)
    for n_done, (shot, reach, check) in enumerate(todo, start=1):
        exams[shot.shot_id] = examiner.examine(shot, _apart_from_way(reach), check)
        if on_shot is not None:
            on_shot(n_done, len(plan.shots))
    taken = _check_ways(plan.shots, exams, examiner)
    moves_s = _moves_s(taken, exams, context.motion)
    alternatives = _alternatives(plan.shots, taken, exams, examiner, max_tries=max_tries)
    timing, pace = context.timing, context.cell.pace

    def assessed(shot: Shot) -> ShotAssessment:
        exam, move_s = exams[shot.shot_id], moves_s.get(shot.shot_id)
        return ShotAssessment(
            shot=shot,
            posture=exam.reach.posture,
            findings=exam.findings,
            range_los_m=exam.view.range_los_m,
            usable_fraction=exam.view.usable_fraction,
            lit_fraction=exam.light.lit_fraction,
            robot_shadow=exam.light.robot_shadow,
            tmac_distance_m=exam.sight.distance_m,
            tmac_angle_rad=exam.sight.angle_rad,
            clearance_m=exam.clearance.least_m,
            duration=_NO_TIME if move_s is None else shot_duration(timing, pace, move_s=move_s),
            nearest=alternatives.get(shot.shot_id),
        )

    return PlanAssessment(
        shots=tuple(assessed(shot) for shot in plan.shots),
        drift_checks_s=drift_checks_s(timing, pace, n_shots=len(taken)) if taken else 0.0,
        start_s=pace.start_s,
    )


def _check_ways(
    shots: Sequence[Shot], exams: dict[int, Exam], examiner: Examiner
) -> tuple[Shot, ...]:
    """Find the shots that will be taken, and put what was found on the ways to them into exams.

    Whoever is refused is passed by, which makes another way, and may be another posture.
    """
    context = examiner.context
    taken = tuple(shot for shot in shots if not exams[shot.shot_id].is_refused)
    while taken:
        reaches = check_reach_along(taken, context.robot)
        ways = check_clearance_along([reach.posture for reach in reaches], context.scene)
        for shot, reach, way in zip(taken, reaches, ways, strict=True):
            exam = exams[shot.shot_id]
            if _stands_as(exam.reach.posture, reach.posture):
                exams[shot.shot_id] = replace(exam, reach=reach, clearance=way)
            else:
                exams[shot.shot_id] = examiner.examine(shot, reach, way)
        refused = [exams[shot.shot_id].is_refused for shot in taken]
        if not any(refused):
            break
        # After a refused shot the way is another one: whether that is free shows the next time.
        is_last_before_refused = (False, *refused[:-1])
        taken = tuple(
            shot
            for shot, is_refused, is_after in zip(
                taken, refused, is_last_before_refused, strict=True
            )
            if not is_refused or is_after
        )
    return taken


def _apart_from_way(reach: Reach) -> Reach:
    """Leave out what holds only if the shot before is taken."""
    findings = tuple(finding for finding in reach.findings if finding.check != "branch")
    return replace(reach, findings=findings)


def _stands_as(a: Posture | None, b: Posture | None) -> bool:
    if a is None or b is None:
        return a is b
    turns_rad = a.axes_rad - b.axes_rad  # whole turns bring every body to the same place
    return a.rail_m == b.rail_m and float(np.abs(np.sin(turns_rad / 2.0)).max()) < _SAME_RAD


def _moves_s(
    taken: Sequence[Shot], exams: Mapping[int, Exam], motion: MotionModel | None
) -> dict[int, float]:
    """Give how long the way to each shot that will be taken takes; 0 where nobody can tell."""
    moves_s = {shot.shot_id: 0.0 for shot in taken}
    for before, shot in pairwise(taken):
        start, end = (exams[s.shot_id].reach.posture for s in (before, shot))
        if motion is not None and start is not None and end is not None:
            moves_s[shot.shot_id] = motion.move_duration_s(start, end)
    return moves_s


def _alternatives(
    shots: Sequence[Shot],
    taken: Sequence[Shot],
    exams: Mapping[int, Exam],
    examiner: Examiner,
    *,
    max_tries: int,
) -> dict[int, RigidTransform]:
    """Look for a pose near each refused shot that could be taken in its place.

    None without a motion model, and none any more when all tries are used up.
    """
    motion = examiner.context.motion
    n_refused = len(shots) - len(taken)
    if not n_refused or motion is None:
        return {}
    tries_a_shot = int(np.clip(max_tries // n_refused, *_TRIES_A_SHOT))
    poses = [shot.trs_from_cam_nominal for shot in taken]
    found: dict[int, RigidTransform] = {}
    for shot, before, after in _refused_between(shots, taken):
        if max_tries < tries_a_shot:
            break
        max_tries -= tries_a_shot
        passes = partial(
            examiner.can_be_taken,
            motion=motion,
            before=None if before is None else exams[before.shot_id].reach.posture,
            after=None if after is None else after.robot_target,
        )
        nearest = nearest_feasible(
            shot.trs_from_cam_nominal, [*poses, *found.values()], passes, max_tries=tries_a_shot
        )
        if nearest is not None:
            found[shot.shot_id] = nearest
    return found


def _refused_between(
    shots: Sequence[Shot], taken: Sequence[Shot]
) -> Iterator[tuple[Shot, Shot | None, Shot | None]]:
    """Give each refused shot with the shots that will be taken before and after it."""
    n_taken = 0
    for shot in shots:
        after = taken[n_taken] if n_taken < len(taken) else None
        if shot is after:
            n_taken += 1
        else:
            yield shot, (taken[n_taken - 1] if n_taken else None), after
