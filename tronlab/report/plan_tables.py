"""The tables of a plan, and all that is known of it as JSON."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.poses import xyz_quat_from_pose
from tronlab.planning.assessment import PlanAssessment, ShotAssessment
from tronlab.planning.summary import (
    CHECK_LABELS,
    PART_LABELS,
    counts_by_check,
    nearest_text,
)
from tronlab.score.evaluation.export import Cell, Column, Table

FORMAT = "tronlab-plan-1"
"""Layout of the JSON document."""
_POSE = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
_PERCENT = 100.0
_DEG = float(np.degrees(1.0))


def shots_table(shots: Sequence[ShotAssessment]) -> Table:
    """Give one row a shot, in the order taken."""
    columns = (
        Column("shot_id", "shot"),
        Column("range_los_m", "range [m]", ".2f"),
        Column("usable_pct", "usable [%]", ".1f"),
        Column("lit_pct", "lit [%]", ".1f"),
        Column("robot_shadow_pct", "robot's shadow [%]", ".1f"),
        Column("tmac_distance_m", "T-MAC [m]", ".2f"),
        Column("tmac_angle_deg", "T-MAC [deg]", ".1f"),
        Column("clearance_m", "clearance [m]", ".2f"),
        Column("move_s", "move [s]", ".1f"),
        Column("total_s", "in all [s]", ".1f"),
        Column("state", "state"),
        Column("findings", "findings"),
    )
    return Table(
        "shots", "Every shot, in the order taken", columns, tuple(_shot_row(s) for s in shots)
    )


def refused_table(refused: Sequence[ShotAssessment]) -> Table:
    """Give refused shots, why, and the nearest pose that can be taken."""
    return Table(
        "refused",
        "Refused shots",
        (
            Column("shot_id", "shot"),
            Column("reasons", "why"),
            Column("nearest", "nearest pose that can be taken"),
        ),
        tuple(
            (
                shot.shot.shot_id,
                "; ".join(finding.text for finding in shot.findings if finding.is_refusal),
                nearest_text(shot),
            )
            for shot in refused
        ),
    )


def checks_table(assessment: PlanAssessment) -> Table:
    """Give how many shots each check refuses and warns of."""
    return Table(
        "checks",
        "Shots by check",
        (Column("check", "check"), Column("n_refused", "refused"), Column("n_warned", "warned")),
        tuple(
            (CHECK_LABELS[name], n_refused, n_warned)
            for name, (n_refused, n_warned) in counts_by_check(assessment).items()
        ),
    )


def plan_document(assessment: PlanAssessment, facts: Sequence[tuple[str, str]]) -> dict[str, Any]:
    """Give everything that is known of a plan as values for JSON; what is not known is null.

    Args:
        assessment: The plan.
        facts: What it was made from, by name.
    """
    return {
        "format": FORMAT,
        "facts": dict(facts),
        "n_shots": len(assessment.shots),
        "n_refused": len(assessment.refused),
        "checks": {
            name: {"n_refused": n_refused, "n_warned": n_warned}
            for name, (n_refused, n_warned) in counts_by_check(assessment).items()
        },
        "total_s": _number(assessment.total_s),
        "parts_s": _numbers(assessment.parts_s),
        "shots": [_shot_document(shot) for shot in assessment.shots],
    }


def _shot_row(shot: ShotAssessment) -> tuple[Cell, ...]:
    return (
        shot.shot.shot_id,
        shot.range_los_m,
        _PERCENT * shot.usable_fraction,
        _PERCENT * shot.lit_fraction,
        _PERCENT * shot.robot_shadow,
        shot.tmac_distance_m,
        _DEG * shot.tmac_angle_rad,
        shot.clearance_m,
        math.nan if shot.is_refused else shot.duration.move_s,
        math.nan if shot.is_refused else shot.duration.total_s,
        state_of(shot),
        "; ".join(finding.text for finding in shot.findings),
    )


def state_of(shot: ShotAssessment) -> str:
    """Give ok, warned or refused."""
    if shot.is_refused:
        return "refused"
    return "warned" if shot.findings else "ok"


def _shot_document(shot: ShotAssessment) -> dict[str, Any]:
    duration = shot.duration
    return {
        "shot_id": shot.shot.shot_id,
        "is_refused": shot.is_refused,
        "findings": [
            {"check": f.check, "is_refusal": f.is_refusal, "text": f.text} for f in shot.findings
        ],
        "trs_from_cam_nominal": _pose(shot.shot.trs_from_cam_nominal),
        "nearest_trs_from_cam": None if shot.nearest is None else _pose(shot.nearest),
        "rail_m": None if shot.posture is None else _number(shot.posture.rail_m),
        "axes_rad": None
        if shot.posture is None
        else [_number(axis) for axis in shot.posture.axes_rad],
        **_numbers(
            {
                name: getattr(shot, name)
                for name in (
                    "range_los_m",
                    "usable_fraction",
                    "lit_fraction",
                    "robot_shadow",
                    "tmac_distance_m",
                    "tmac_angle_rad",
                    "clearance_m",
                )
            }
        ),
        "duration_s": _numbers(
            {
                name.removesuffix("_s"): getattr(duration, name)
                for name in PART_LABELS
                if hasattr(duration, name)
            }
        ),
    }


def _pose(pose: RigidTransform) -> dict[str, float]:
    return dict(zip(_POSE, map(float, xyz_quat_from_pose(pose)), strict=True))


def _numbers(values: Mapping[str, float]) -> dict[str, float | None]:
    return {name: _number(value) for name, value in values.items()}


def _number(value: float) -> float | None:
    """JSON has no word for what is not a number."""
    return float(value) if math.isfinite(value) else None
