"""Where the camera was: figures 5 and 7 of the paper, in the frame of the terrain model.

The model stands upright, so the picture does: X of trs points down, Z out of the model.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.poses import FloatArray
from tronlab.report.style import AXIS_COLOURS, new_figure, style_context

if TYPE_CHECKING:
    from mpl_toolkits.mplot3d import Axes3D

NOMINAL_COLOUR = "#0000ff"
PERTURBED_COLOUR = "#ff0000"
TRS_COLOURS = {"x": "#000000", "y": "#ff00ff", "z": "#00ffff"}
"""Colours of the paper: nominal blue, perturbed red; axes of trs black, magenta, cyan."""
_AXIS_M = 0.7
"""How long axes of frames are drawn."""
_MODEL_COLOUR = "#b8b8b8"
_MARGIN_M = 0.2
_ZOOM = 0.88
"""So that the names of the axes are not cut off."""
_LARGEST_STRETCH = 3.0
"""A panel is at most so many times longer than high: what is farther is drawn closer."""


@dataclass(frozen=True, slots=True)
class ModelOutline:
    """The terrain model as a rectangle."""

    corner_trs_m: tuple[float, float, float]
    """Corner with the least X and Y; Z is its mean height."""
    size_m: tuple[float, float]
    """Along X and Y of trs."""


@dataclass(frozen=True, slots=True)
class Points:
    """Camera positions of one kind."""

    p_trs_m: FloatArray
    """Shape (n, 3)."""
    is_perturbed: bool = False


@dataclass(frozen=True, slots=True)
class PointsPanel:
    """One panel of camera positions."""

    title: str
    points: Sequence[Points]
    first_pose: RigidTransform | None = None
    """``trs_from_cam`` whose axes are drawn, red, green and blue."""


def trajectory_figure(panels: Sequence[PointsPanel], model: ModelOutline) -> Figure:
    """Draw camera positions side by side: nominal as blue circles, perturbed as red crosses.

    The axes of trs are black, magenta and cyan for X, Y and Z.

    Args:
        panels: At least one.
        model: What the camera flies to.
    """
    with style_context():
        figure = new_figure(4.8 * len(panels), 4.2)
        grid = figure.add_gridspec(1, len(panels))
        for i, panel in enumerate(panels):
            _draw_panel(_new_axes(figure, grid[0, i]), panel, model)
    return figure


def _new_axes(figure: Figure, place: SubplotSpec) -> "Axes3D":
    from mpl_toolkits.mplot3d import Axes3D

    axes = figure.add_subplot(place, axes_class=Axes3D)
    return cast("Axes3D", axes)


def _draw_panel(axes: "Axes3D", panel: PointsPanel, model: ModelOutline) -> None:
    _draw_model(axes, model)
    for colour, direction in zip(TRS_COLOURS.values(), np.eye(3), strict=True):
        _line(axes, np.zeros(3), _AXIS_M * direction, colour)
    for points in panel.points:
        _draw_points(axes, points)
    if panel.first_pose is not None:
        eye_m = panel.first_pose.translation
        directions = panel.first_pose.rotation.as_matrix().T
        for colour, direction in zip(AXIS_COLOURS.values(), directions, strict=True):
            _line(axes, eye_m, eye_m + _AXIS_M * direction, colour)
    _frame(axes, panel, model)
    axes.set_title(panel.title)


def _draw_points(axes: "Axes3D", points: Points) -> None:
    look: dict[str, Any] = (
        {"marker": "x", "color": PERTURBED_COLOUR, "markersize": 3.0, "markeredgewidth": 0.7}
        if points.is_perturbed
        else {"marker": "o", "color": NOMINAL_COLOUR, "markersize": 4.0, "fillstyle": "none"}
    )
    kind = "perturbed" if points.is_perturbed else "nominal"
    label = f"{kind}: {len(points.p_trs_m)}"
    axes.plot(*_shown(points.p_trs_m), linestyle="", label=label, **look)


def _draw_model(axes: "Axes3D", model: ModelOutline) -> None:
    x, y, z = model.corner_trs_m
    height, width = model.size_m
    steps = np.array([[0, 0, 0], [height, 0, 0], [height, width, 0], [0, width, 0], [0, 0, 0]])
    axes.plot(*_shown(np.array([x, y, z]) + steps), color=_MODEL_COLOUR, linewidth=2.0)


def _line(axes: "Axes3D", start_m: FloatArray, end_m: FloatArray, colour: str) -> None:
    axes.plot(*_shown(np.array([start_m, end_m])), color=colour, linewidth=2.2)


def _frame(axes: "Axes3D", panel: PointsPanel, model: ModelOutline) -> None:
    """Fit the axes around all there is, in true scale as far as the panel's shape allows."""
    corner = np.array(model.corner_trs_m)
    everything = np.concatenate(
        [
            *(points.p_trs_m for points in panel.points),
            [corner, corner + np.array([*model.size_m, 0.0]), np.zeros(3)],
        ]
    )
    low, high = everything.min(axis=0) - _MARGIN_M, everything.max(axis=0) + _MARGIN_M
    axes.set_xlim(low[2], high[2])
    axes.set_ylim(low[1], high[1])
    axes.set_zlim(high[0], low[0])
    extent = (high - low)[::-1]
    aspect = np.minimum(extent, _LARGEST_STRETCH * extent[2]).tolist()
    axes.set_box_aspect(aspect, zoom=cast("Any", _ZOOM))
    axes.view_init(elev=22.0, azim=-62.0)
    axes.set_xlabel("Z [m], out of the model")
    axes.set_ylabel("Y [m]")
    axes.set_zlabel("X [m], down")
    axes.tick_params(labelsize=7, pad=-1)
    axes.locator_params(nbins=5)
    axes.legend(fontsize=8, loc="upper left")


def _shown(points_trs_m: FloatArray) -> FloatArray:
    """Give the coordinates a picture has for points in trs, shape (3, n)."""
    return points_trs_m[:, ::-1].T
