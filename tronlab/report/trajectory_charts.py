"""Where a campaign's camera goes, and how powered descents fly."""

from collections.abc import Callable, Mapping, Sequence
from typing import TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.poses import FloatArray
from tronlab.report.style import drawn_names, legend_above, new_figure, style_context
from tronlab.report.trajectory_scene import (
    NOMINAL_COLOUR,
    PERTURBED_COLOUR,
    ModelOutline,
    Points,
    PointsPanel,
    trajectory_figure,
)
from tronlab.terrain.heightmap import HeightMap
from tronlab.trajectory.cone_programme import Flight
from tronlab.trajectory.descent import NOMINAL, DescentSet, tilt_rad

_LIMIT_COLOUR = "#7f7f7f"
_Curve: TypeAlias = Callable[[Flight], tuple[FloatArray, FloatArray]]


def pose_figure(
    poses: Mapping[int, Sequence[RigidTransform]],
    heightmap: HeightMap,
    *,
    nominal: Sequence[RigidTransform] = (),
) -> Figure:
    """Draw where the camera goes in the laboratory, as figure 5 of the paper.

    Args:
        poses: ``trs_from_cam`` by number of the trajectory; 0 is the nominal one.
        heightmap: The terrain model, of which the outline is drawn.
        nominal: Poses of the nominal trajectory, to be drawn also where it is not flown.
    """
    flown = [pose for number, group in poses.items() if number != NOMINAL for pose in group]
    shown = poses.get(NOMINAL, nominal)
    points = [
        Points(np.array([pose.translation for pose in group]), is_perturbed=group is flown)
        for group in (flown, shown)
        if group
    ]
    x_m, y_m, _ = heightmap.origin_trs_m
    outline = ModelOutline((x_m, y_m, heightmap.mean_height_trs_m), heightmap.size_m)
    first = next(iter(shown or flown))
    return trajectory_figure([PointsPanel("Camera in the laboratory", points, first)], outline)


def descent_states_figure(descents: DescentSet) -> Figure:
    """Draw the states of all descents at full scale: nominal blue, perturbed red.

    The lander's limits are dashed.
    """
    lander = descents.lander
    with style_context():
        figure = new_figure(9.6, 6.4)
        thrust, tilt, height, track = np.ravel(figure.subplots(2, 2))
        _draw(thrust, descents, lambda f: (f.time_s, np.linalg.norm(f.thrust_n, axis=1) / 1e3))
        _limit(thrust, [thrust_n / 1e3 for thrust_n in lander.thrust_n])
        _label(thrust, "Thrust", "time [s]", "thrust [kN]")
        _draw(tilt, descents, lambda f: (f.time_s, np.degrees(tilt_rad(f))))
        _limit(tilt, [lander.max_tilt_deg])
        _label(tilt, "Angle between thrust and vertical", "time [s]", "tilt [deg]")
        _draw(
            height,
            descents,
            lambda f: (np.linalg.norm(f.velocity_m_per_s, axis=1), f.position_m[:, 2]),
        )
        _label(height, "Height over speed", "speed [m/s]", "height [m]")
        _draw(track, descents, lambda f: (f.position_m[:, 0], f.position_m[:, 1]))
        track.plot(0.0, 0.0, "+", color="black", markersize=9, label="landing point")
        track.set_aspect("equal", adjustable="datalim")
        _label(track, "From above, local vertical frame", "x [m]", "y [m]")
        for axes in (thrust, tilt, height):
            axes.set_ylim(bottom=0.0)
            axes.set_xlim(left=0.0)
        legend_above(figure, drawn_names(thrust) | drawn_names(track))
    return figure


def _draw(axes: Axes, descents: DescentSet, curve: _Curve) -> None:
    perturbed = [other.flight for other in descents.trajectories if other is not descents.nominal]
    for flight in perturbed:
        axes.plot(
            *curve(flight), color=PERTURBED_COLOUR, linewidth=0.7, alpha=0.6, label="perturbed"
        )
    axes.plot(*curve(descents.nominal.flight), color=NOMINAL_COLOUR, linewidth=1.6, label="nominal")


def _limit(axes: Axes, values: Sequence[float]) -> None:
    for value in values:
        axes.axhline(value, color=_LIMIT_COLOUR, linestyle="--", linewidth=0.9, label="limit")


def _label(axes: Axes, title: str, x: str, y: str) -> None:
    axes.set_title(title)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid()
