"""Figures 5 to 19 of the paper, drawn from a study, each with a caption in our own words.

Figures of the refined cores have the number of the paper's figure that they stand beside, and an r.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.poses import FloatArray
from tronlab.report.histograms import error_histograms
from tronlab.report.page import PageFigure
from tronlab.report.paper import DATASETS, PAPER_CORES, detector_of, is_refined
from tronlab.report.study.charts import (
    NO_RANK,
    Measure,
    error_over_perturbation,
    position_over_rotation,
)
from tronlab.report.study.results import StudyResults
from tronlab.report.style import (
    CoreStyle,
    core_styles,
    new_figure,
    save_chart,
    save_picture,
    style_context,
)
from tronlab.report.trajectory_scene import (
    ModelOutline,
    Points,
    PointsPanel,
    trajectory_figure,
)
from tronlab.score.perturbation import view_sentence

_DECIMALS = 6
"""Of metres, by which points are told apart."""
_MASK_COLOUR = (1.0, 0.83, 0.0)
_MASK_STRENGTH = 0.3


@dataclass(frozen=True, slots=True)
class MaskedView:
    """What a camera sees, and which part of it is the model."""

    image: NDArray[np.uint8]
    """Grey values, shape (rows, columns)."""
    mask: NDArray[np.bool_]
    """True where the model is seen, same shape."""
    told: str
    """From where, and how the image came about."""


@dataclass(frozen=True, slots=True)
class Scenery:
    """What figures need besides tables; whatever is not known stays out of them."""

    model: ModelOutline
    flown: Mapping[str, FloatArray] = field(default_factory=dict[str, FloatArray])
    """Camera positions of the whole trajectories by dataset, shape (n, 3), metres, trs."""
    taken: Mapping[str, FloatArray] = field(default_factory=dict[str, FloatArray])
    """Those of the shots that were taken, likewise."""
    first_pose: RigidTransform | None = None
    """``trs_from_cam`` at the first point of dataset 0."""
    first_view: MaskedView | None = None
    """From the first point of the nominal trajectory."""
    rejected: Mapping[str, int] = field(default_factory=dict[str, int])
    """Starts that no descent was found for, by dataset."""


@dataclass(frozen=True, slots=True)
class _Perturbation:
    """Panels of figure 19 that are drawn together."""

    stem: str
    """File name without ending."""
    measures: tuple[Measure, ...]
    what: str
    """As the caption has it."""


_PERTURBATIONS = (
    _Perturbation(
        "fig_19",
        (
            Measure("plane_distance_pct_los", "plane distance [% of LOS]"),
            Measure("horizontal_distance_pct_los", "horizontal distance [% of LOS]"),
        ),
        "plane distance (left) and horizontal distance (right), in percent of LOS,",
    ),
    _Perturbation(
        "fig_19_angle",
        (Measure("angle_difference_deg", "angle to the paired nominal pose [deg]"),),
        "the angle (which the paper does not show, since it looked alike)",
    ),
)


@dataclass(frozen=True, slots=True)
class Captioned:
    """A figure of the page and what is said below it."""

    figure: PageFigure
    caption: str


@dataclass(frozen=True, slots=True)
class Plate:
    """One figure of the paper: as it is there, and beside it that of the refined cores."""

    figures: Sequence[Captioned]


def draw_gallery(results: StudyResults, scenery: Scenery, folder: Path) -> list[Plate]:
    """Draw all figures for which there is something, in the paper's order, into a folder."""
    return [
        *_trajectory_plates(scenery, folder),
        *_histogram_plates(results, folder),
        *_scatter_plates(results, folder),
    ]


def mask_figure(view: MaskedView) -> Figure:
    """Draw the mask of a view, and its image with the mask laid over."""
    with style_context():
        figure = new_figure(7.6, 4.0)
        left, right = figure.subplots(1, 2)
        left.imshow(view.mask, cmap="gray", vmin=0, vmax=1, interpolation="nearest")
        left.set_title(f"mask: {100 * view.mask.mean():.1f} % of the image is usable", loc="left")
        right.imshow(_overlaid(view), interpolation="antialiased")
        right.set_title("laid over the image", loc="left")
        for axes in (left, right):
            _frame(axes)
    return figure


def _overlaid(view: MaskedView) -> FloatArray:
    grey = view.image / max(float(view.image.max()), 1.0)
    shown = np.repeat(grey[:, :, None], 3, axis=2)
    tinted = (1 - _MASK_STRENGTH) * shown + _MASK_STRENGTH * np.array(_MASK_COLOUR)
    return np.where(view.mask[:, :, None], tinted, shown)


def _frame(axes: Axes) -> None:
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines[:].set_visible(True)


def _trajectory_plates(scenery: Scenery, folder: Path) -> Iterator[Plate]:
    flown = [panel for panel in _flown_panels(scenery) if panel.points]
    if flown:
        yield _plate(
            trajectory_figure(flown, scenery.model),
            folder,
            "fig_05",
            "Figure 5: the trajectories before any point was left out: the straight line of dataset"
            " 0 with the camera's axes at its first point (red, green, blue: x, y, z), and the"
            " descents, nominal as blue circles, perturbed as red crosses. Axes of trs: black,"
            " magenta, cyan for X, Y, Z; grey: outline of the model.",
        )
    if scenery.first_view is not None:
        view = scenery.first_view
        path = save_picture(mask_figure(view), folder, "fig_06")
        caption = (
            "Figure 6: mask of the model (left) and laid over the image (right),"
            f" {view.told}. Of this image {100 * view.mask.mean():.1f} % is usable, in the paper"
            " about 5 %; only images above 20 % are used."
        )
        yield Plate([Captioned(PageFigure(path, alt=caption), caption)])
    taken = [panel for panel in _taken_panels(scenery) if panel.points]
    if taken:
        yield _plate(
            trajectory_figure(taken, scenery.model),
            folder,
            "fig_07",
            "Figure 7: the points of dataset 1 and of dataset 2 that images were taken from,"
            " nominal in blue, perturbed in red.",
        )


def _flown_panels(scenery: Scenery) -> tuple[PointsPanel, PointsPanel]:
    line = _points(scenery.flown, ["dataset_0"])
    descents = _points(scenery.flown, [name for name in DATASETS if name != "dataset_0"])
    return (
        PointsPanel("straight line (dataset 0)", line, scenery.first_pose),
        PointsPanel("powered descent (datasets 1 and 2)", descents),
    )


def _taken_panels(scenery: Scenery) -> tuple[PointsPanel, PointsPanel]:
    one, two = (
        _points(scenery.taken, [f"dataset_{number}_nominal", f"dataset_{number}_perturbed"])
        for number in (1, 2)
    )
    return PointsPanel("dataset 1", one), PointsPanel("dataset 2", two)


def _points(positions: Mapping[str, FloatArray], names: Sequence[str]) -> list[Points]:
    """Give the positions of some datasets, nominal ones last, so that none is hidden."""
    found: list[Points] = []
    for is_perturbed in (True, False):
        of_kind = [
            positions[name]
            for name in names
            if name in positions and DATASETS[name].is_perturbed == is_perturbed
        ]
        if of_kind:
            # Datasets may share points of a trajectory: each is drawn once.
            every_m = np.unique(np.concatenate(of_kind).round(_DECIMALS), axis=0)
            found.append(Points(every_m, is_perturbed))
    return found


def _histogram_plates(results: StudyResults, folder: Path) -> Iterator[Plate]:
    numbered = sorted(
        (number, dataset, detector)
        for dataset, published in DATASETS.items()
        for detector, number in published.figures.items()
        if dataset in results.datasets
    )
    for number, dataset, detector in numbered:
        cores = [core for core in results.cores if detector_of(core) == detector]
        figures = [
            _histograms(results, dataset, core, f"{number}{'r' * is_refined(core)}", folder)
            for core in sorted(cores, key=is_refined)
        ]
        if figures:
            yield Plate(figures)


def _histograms(
    results: StudyResults, dataset: str, core: str, number: str, folder: Path
) -> Captioned:
    has_angles = dataset == "dataset_0"
    title = DATASETS[dataset].title
    figure = error_histograms(results.datasets[dataset], core, has_angles=has_angles, of=title)
    caption = (
        f"Figure {number}: errors of {core} on {title}: norm of the position error (grey), position"
        " error along x (red), y (green), z (blue) of trs, real minus estimated"
    )
    if has_angles:
        caption += ", angle between real and estimated camera axis x (red), y (green), z (blue)"
    return _captioned(
        figure, folder, f"fig_{number.zfill(2 + number.endswith('r'))}", f"{caption}."
    )


def _scatter_plates(results: StudyResults, folder: Path) -> Iterator[Plate]:
    styles = core_styles(results.cores)
    paper = {core: style for core, style in styles.items() if core in PAPER_CORES}
    refined = {core: style for core, style in styles.items() if is_refined(core)}
    sets = {"": paper, "r": refined}
    yield Plate(
        [
            _captioned(
                position_over_rotation(results.scores, of_set),
                folder,
                f"fig_18{end}",
                f"Figure 18{end}: norm of the position error against the orientation error (angle"
                f" of the rotation between real and estimated attitude), {_listed(of_set)}.",
            )
            for end, of_set in sets.items()
            if of_set
        ]
    )
    if "perturbation" in results.tables:
        for kind in _PERTURBATIONS:
            yield Plate(list(_perturbation_figures(results, kind, sets, folder)))


def _perturbation_figures(
    results: StudyResults,
    kind: _Perturbation,
    sets: Mapping[str, Mapping[str, CoreStyle]],
    folder: Path,
) -> Iterator[Captioned]:
    rows = results.tables["perturbation"]
    rank = results.tables.get("rank", NO_RANK)
    for end, of_set in sets.items():
        if of_set:
            yield _captioned(
                error_over_perturbation(rows, rank, of_set, kind.measures),
                folder,
                f"{kind.stem}{end}",
                f"Figure 19{end}: norm of the position error against {kind.what} to the nominal"
                " pose paired by Z of trs; below: Spearman's rank correlation with its 95 %"
                f" interval and p, {_listed(of_set)}.{_of_view(rank, of_set, kind.measures)}",
            )


def _of_view(
    rank: pd.DataFrame, cores: Mapping[str, CoreStyle], measures: Sequence[Measure]
) -> str:
    """Say what is left of the correlations of a figure at the same range and usable fraction."""
    drawn = rank[
        rank["core"].isin(list(cores)) & rank["measure"].isin([m.column for m in measures])
    ]
    if drawn.empty or drawn["partial_p"].isna().all():
        return ""
    return f" {view_sentence(drawn)}"


def _plate(figure: Figure, folder: Path, stem: str, caption: str) -> Plate:
    return Plate([_captioned(figure, folder, stem, caption)])


def _captioned(figure: Figure, folder: Path, stem: str, caption: str) -> Captioned:
    path = save_chart(figure, folder, stem)
    return Captioned(PageFigure(path, alt=caption, anchor=stem.replace("_", "-")), caption)


def _listed(cores: Mapping[str, CoreStyle]) -> str:
    return " and ".join(cores)
