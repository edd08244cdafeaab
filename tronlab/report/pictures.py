"""Photographs of shots with what the navigation core saw in them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tronlab.geometry.poses import FloatArray
from tronlab.report.style import new_figure, style_context

N_CONTACT_SHOTS = 12
_COLUMNS = 3
_MASK_COLOUR = "#ffd400"
_INLIER_COLOUR = "#00e5ff"
_BRIGHTEST_PERCENTILE = 99.5
"""Shown as white: a few glints must not darken the whole picture."""


@dataclass(frozen=True, slots=True)
class ShotPicture:
    """What is drawn of one shot and core."""

    image: NDArray[np.uint8] | NDArray[np.uint16]
    """Grey values, shape (rows, columns)."""
    mask: NDArray[np.bool_]
    """True where the model is seen, same shape."""
    uv_inliers: FloatArray
    """Image positions the pose rests on, shape (n, 2), pixels."""
    caption: str


def contact_sheet(pictures: Sequence[ShotPicture], title: str) -> Figure:
    """Draw shots side by side, each with the outline of its mask and its inliers."""
    n_rows = -(-len(pictures) // _COLUMNS)
    with style_context():
        figure = new_figure(9.0, 0.4 + 3.25 * n_rows)
        figure.suptitle(title, fontsize=10)
        for i, picture in enumerate(pictures):
            _draw(figure.add_subplot(n_rows, _COLUMNS, i + 1), picture, dot_size=1.4)
    return figure


def single_picture(picture: ShotPicture, title: str) -> Figure:
    """Draw one shot larger."""
    with style_context():
        figure = new_figure(5.6, 6.1)
        figure.suptitle(title, fontsize=10)
        _draw(figure.add_subplot(), picture, dot_size=3.0)
    return figure


def shot_caption(row: "pd.Series[Any]") -> str:
    """Say which shot it is, how far away, and how large its error; ``row`` is one of the scores."""
    text = f"shot {row['shot_id']}, {row['range_los_m']:.2f} m"
    if row["status"] != "ok":
        return f"{text}, {row['status']}"
    return f"{text}, error {row['position_error_pct_los']:.2g} % of LOS"


def shots_over_range(rows: pd.DataFrame, n_shots: int = N_CONTACT_SHOTS) -> list[int]:
    """Choose shots spread evenly over the sorted ranges of one core's rows, farthest first.

    Returns:
        At most ``n_shots`` shot ids, none twice.
    """
    ordered = rows.sort_values(["range_los_m", "shot_id"], ascending=[False, True])
    n = min(n_shots, len(ordered))
    at = np.unique(np.linspace(0, len(ordered) - 1, n).round().astype(int)) if n else []
    return [int(shot_id) for shot_id in ordered["shot_id"].to_numpy()[at]]


def _draw(axes: Axes, picture: ShotPicture, *, dot_size: float) -> None:
    rows, columns = picture.image.shape
    brightest = max(float(np.percentile(picture.image, _BRIGHTEST_PERCENTILE)), 1.0)
    axes.imshow(picture.image, cmap="gray", vmin=0.0, vmax=brightest, interpolation="antialiased")
    if picture.mask.any() and not picture.mask.all():
        axes.contour(picture.mask, levels=[0.5], colors=[_MASK_COLOUR], linewidths=0.9)
    u, v = picture.uv_inliers[:, 0], picture.uv_inliers[:, 1]
    axes.plot(u, v, "o", color=_INLIER_COLOUR, markersize=dot_size, markeredgewidth=0)
    axes.set_xlim(-0.5, columns - 0.5)
    axes.set_ylim(rows - 0.5, -0.5)
    axes.set_axis_off()
    axes.set_title(picture.caption, fontsize=8)
