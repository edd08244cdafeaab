"""The part of the report that judges: statistics with intervals, recall, bins, consistency."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from tronlab.errors import ScoreError
from tronlab.report.page import PageFigure
from tronlab.report.statistics_charts import consistency_chart, error_boxes, recall_curve
from tronlab.report.statistics_tables import (
    INTERVALS,
    bins_table,
    consistency_table,
    recall_table,
    seeds_table,
    statistics_table,
)
from tronlab.report.style import CoreStyle, save_chart
from tronlab.score.evaluation.bins import BINNED_BY, make_bins
from tronlab.score.evaluation.export import Table
from tronlab.score.evaluation.recall import THRESHOLDS, Threshold


@dataclass(frozen=True, slots=True)
class EvaluationSettings:
    """What a person may choose."""

    thresholds: tuple[Threshold, ...] = THRESHOLDS
    """Of the recall."""
    edges: Mapping[str, Sequence[float]] = field(default_factory=dict[str, Sequence[float]])
    """Between bins, by column; quantiles for columns that are not named."""


@dataclass(frozen=True, slots=True)
class Part:
    """The shots parted by one column."""

    label: str
    table: Table
    boxes: PageFigure


@dataclass(frozen=True, slots=True)
class Evaluation:
    """What the page shows."""

    statistics: Table
    seeds: Table | None
    """None with one seed a core."""
    recall: Table
    recall_curve: PageFigure
    parts: Sequence[Part]
    consistency: Table
    consistency_chart: PageFigure
    intervals_note: str = INTERVALS

    @property
    def tables(self) -> list[Table]:
        """Get all tables."""
        seeds = [] if self.seeds is None else [self.seeds]
        bins = [part.table for part in self.parts]
        return [self.statistics, *seeds, self.recall, *bins, self.consistency]


def evaluate(
    scores: pd.DataFrame,
    styles: Mapping[str, CoreStyle],
    *,
    settings: EvaluationSettings,
    folder: Path,
) -> Evaluation:
    """Make the tables, and draw the pictures into a folder.

    Raises:
        ScoreError: Bins are asked for by a column that is not known of any shot.
    """
    has_seeds = bool((scores.groupby("core")["seed"].nunique() > 1).any())
    curve = recall_curve(scores, styles, settings.thresholds)
    chart = consistency_chart(scores, styles)
    return Evaluation(
        statistics=statistics_table(scores),
        seeds=seeds_table(scores) if has_seeds else None,
        recall=recall_table(scores, settings.thresholds),
        recall_curve=PageFigure(
            save_chart(curve, folder, "recall"),
            alt="Share of answers within position and rotation thresholds that grow together",
        ),
        parts=_parts(scores, styles, settings.edges, folder),
        consistency=consistency_table(scores),
        consistency_chart=PageFigure(
            save_chart(chart, folder, "consistency"),
            alt="Distributions of error over the truth's sigma, error over the bound, and NEES",
        ),
    )


def _parts(
    scores: pd.DataFrame,
    styles: Mapping[str, CoreStyle],
    edges: Mapping[str, Sequence[float]],
    folder: Path,
) -> list[Part]:
    """Part the shots by each column in which they differ."""
    parts: list[Part] = []
    for column, label in BINNED_BY.items():
        if not np.isfinite(scores[column]).any():
            if column in edges:
                raise ScoreError(f"bins by {column}: it is not known of any shot; leave them out")
            continue
        bins = make_bins(scores, column, edges.get(column))
        if len(bins) == 1 and column not in edges:
            continue
        path = save_chart(error_boxes(scores, styles, column, bins), folder, f"boxes_{column}")
        figure = PageFigure(path, alt=f"Position error by {label}")
        parts.append(Part(label, bins_table(scores, column, bins), figure))
    return parts
