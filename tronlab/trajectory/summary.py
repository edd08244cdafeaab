"""What people are told of trajectories."""

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.trajectory.descent import NOMINAL, Descent, DescentSet

_HEADINGS = (
    "trajectory",
    "time [s]",
    "fuel [kg]",
    "max tilt [deg]",
    "path [m]",
    "points",
    "redrawn",
)


def describe_descents(descents: DescentSet) -> str:
    """Give a table of the trajectories, a line on each start drawn anew, and any doubt."""
    redrawn = Counter(start.number for start in descents.rejected)
    is_perturbed = all(descent.number != NOMINAL for descent in descents.trajectories)
    rows = [_row(descents.nominal, 0)] if is_perturbed else []
    rows += [_row(descent, redrawn[descent.number]) for descent in descents.trajectories]
    n_points = sum(len(descent.trs_from_cam) for descent in descents.trajectories)
    lines = [*_table(rows), f"{n_points} points of {_n_trajectories(descents)}"]
    if is_perturbed:
        lines[-1] += "; the nominal one is not flown"
    lines += describe_rejected(descents)
    everyone = {descent.number: descent for descent in (descents.nominal, *descents.trajectories)}
    lines += [
        f"warning: {_name(descent)}: the relaxation is not tight, thrust is"
        f" {100 * descent.relaxation_gap:.2g} % below its bound: the descent may not be the one of"
        " least fuel within thrust_n"
        for descent in everyone.values()
        if not descent.is_tight
    ]
    return "\n".join(lines)


def describe_rejected(descents: DescentSet) -> list[str]:
    """Give a line on each start that was drawn anew, since nobody could land from there."""
    return [
        f"trajectory {start.number}: drawn anew, no descent from {_vector(start.start.position_m)}"
        f" m with {_vector(start.start.velocity_m_per_s)} m/s: {start.reason}"
        for start in descents.rejected
    ]


def describe_poses(poses: Sequence[RigidTransform]) -> str:
    """Say how many poses there are, and where."""
    positions_m = np.array([pose.translation for pose in poses])
    low, high = positions_m.min(axis=0), positions_m.max(axis=0)
    spans = (f"{axis} {a:.3f} to {b:.3f}" for axis, a, b in zip("XYZ", low, high, strict=True))
    return f"{len(poses)} points, {', '.join(spans)} m of trs"


def poses_by_trajectory(
    poses: Sequence[RigidTransform], numbers: Sequence[int]
) -> Mapping[int, list[RigidTransform]]:
    """Sort poses by the trajectory they are of, in the order they are flown."""
    sorted_poses: dict[int, list[RigidTransform]] = {}
    for pose, number in zip(poses, numbers, strict=True):
        sorted_poses.setdefault(number, []).append(pose)
    return sorted_poses


def _n_trajectories(descents: DescentSet) -> str:
    n = len(descents.trajectories)
    return "1 trajectory" if n == 1 else f"{n} trajectories"


def _row(descent: Descent, n_redrawn: int) -> tuple[str, ...]:
    return (
        "nominal" if descent.number == NOMINAL else str(descent.number),
        f"{descent.flight_time_s:.1f}",
        f"{descent.fuel_kg:.1f}",
        f"{descent.max_tilt_deg:.1f}",
        f"{descent.path_m:.0f}",
        str(len(descent.trs_from_cam)),
        str(n_redrawn),
    )


def _table(rows: Sequence[Sequence[str]]) -> list[str]:
    columns = list(zip(_HEADINGS, *rows, strict=True))
    widths = [max(map(len, column)) for column in columns]
    return [
        "  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True))
        for row in (_HEADINGS, *rows)
    ]


def _name(descent: Descent) -> str:
    return "nominal trajectory" if descent.number == NOMINAL else f"trajectory {descent.number}"


def _vector(values: Sequence[float]) -> str:
    return f"({', '.join(f'{value:.1f}' for value in values)})"
