"""The storyboard of a plan: small renderings of what the camera will see."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tronlab.planning.assessment import ShotAssessment
from tronlab.planning.context import PlanContext
from tronlab.planning.summary import CHECK_LABELS
from tronlab.render.mask import model_mask
from tronlab.render.settings import RenderSettings
from tronlab.report.plan_charts import REFUSED_COLOUR, WARNED_COLOUR
from tronlab.report.style import new_figure, style_context

N_EVEN = 24
"""Shots shown, evenly over the plan."""
MOST_REFUSED = 24
"""Refused shots shown beyond those."""
_WIDTH_PX = 180
_COLUMNS = 6
_OUTLINE_COLOUR = "#ffd400"
_BRIGHTEST_PERCENTILE = 99.0


@dataclass(frozen=True, slots=True)
class PredictedView:
    """What is shown of one shot."""

    shot: ShotAssessment
    radiance: NDArray[np.float32]
    """Shape (rows, columns); 0 beside the terrain."""
    mask: NDArray[np.bool_]
    """True within the model's outline, same shape."""


def story_shots(shots: Sequence[ShotAssessment]) -> tuple[ShotAssessment, ...]:
    """Choose shots evenly over the plan, and refused ones up to a limit, in the order taken."""
    even = np.linspace(0, len(shots) - 1, min(N_EVEN, len(shots))).round().astype(int)
    refused = [i for i, shot in enumerate(shots) if shot.is_refused and i not in set(even)]
    if len(refused) > MOST_REFUSED:
        at = np.linspace(0, len(refused) - 1, MOST_REFUSED).round().astype(int)
        refused = [refused[i] for i in at]
    return tuple(shots[i] for i in sorted({*map(int, even), *refused}))


def predict_views(
    shots: Sequence[ShotAssessment],
    context: PlanContext,
    *,
    on_view: Callable[[int, int], None] | None = None,
) -> tuple[PredictedView, ...]:
    """Render what the camera will see from the nominal poses, small.

    The robot's own shadow is not in them. ``on_view`` is told (done, all).
    """
    camera, heightmap = context.camera, context.heightmap
    small = camera.scaled(min(_WIDTH_PX, camera.width_px))
    views: list[PredictedView] = []
    settings = RenderSettings(rays_per_pixel=4)
    for shot in shots:
        pose = shot.shot.trs_from_cam_nominal
        rendering = context.renderer.render(small, pose, context.lamp, settings)
        views.append(PredictedView(shot, rendering.radiance, model_mask(heightmap, small, pose)))
        if on_view is not None:
            on_view(len(views), len(shots))
    return tuple(views)


def storyboard(views: Sequence[PredictedView]) -> Figure:
    """Draw predicted views side by side; refused shots have a red frame and say why."""
    columns = min(_COLUMNS, len(views))
    n_rows = -(-len(views) // columns)
    rows_px, columns_px = views[0].radiance.shape
    brightest = _brightest(views)
    with style_context():
        width = 9.6 / _COLUMNS
        caption = 0.36 if any(view.shot.findings for view in views) else 0.24
        figure = new_figure(width * columns, n_rows * (width * rows_px / columns_px + caption))
        for i, view in enumerate(views):
            _draw(figure.add_subplot(n_rows, columns, i + 1), view, brightest)
    return figure


def _brightest(views: Sequence[PredictedView]) -> float:
    """Give the radiance shown as white, one for all views: dark ones shall look dark."""
    lit = np.concatenate([view.radiance[view.radiance > 0] for view in views])
    return float(np.percentile(lit, _BRIGHTEST_PERCENTILE)) if lit.size else 1.0


def _draw(axes: Axes, view: PredictedView, brightest: float) -> None:
    axes.imshow(view.radiance, cmap="gray", vmin=0.0, vmax=brightest, interpolation="antialiased")
    if view.mask.any() and not view.mask.all():
        axes.contour(view.mask, levels=[0.5], colors=[_OUTLINE_COLOUR], linewidths=0.7)
    axes.set_xticks([])
    axes.set_yticks([])
    shot, colour, width = view.shot, "black", 0.5
    text = f"{shot.shot.shot_id}: {_known(shot.range_los_m, '.2f')} m, "
    text += f"{_known(100 * shot.usable_fraction, '.0f')} %"
    if shot.findings:
        colour, width = (REFUSED_COLOUR, 2.5) if shot.is_refused else (WARNED_COLOUR, 1.8)
        text += f"\n{_first_check(shot)}"
    for spine in axes.spines.values():
        spine.set(visible=True, color=colour, linewidth=width)
    axes.set_title(text, fontsize=7, color=colour if shot.is_refused else "black", pad=3)


def _first_check(shot: ShotAssessment) -> str:
    """Name what matters most: a refusal rather than a warning."""
    findings = sorted(shot.findings, key=lambda finding: not finding.is_refusal)
    n_more = len({finding.check for finding in findings}) - 1
    return CHECK_LABELS[findings[0].check] + (f" + {n_more}" if n_more else "")


def _known(value: float, form: str) -> str:
    return format(value, form) if np.isfinite(value) else "?"
