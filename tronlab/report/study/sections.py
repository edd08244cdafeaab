"""What the page of a study says in sentences, tables and pictures, section by section."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from tronlab.report.page import PageFigure
from tronlab.report.paper import DATASETS, SOURCE, TABLE_1, TABLE_2
from tronlab.report.statistics_charts import error_boxes
from tronlab.report.statistics_tables import INTERVALS, bins_table
from tronlab.report.study.ablation_charts import cost_chart
from tronlab.report.study.answers import (
    larger_terrain_answer,
    load_answer,
    perturbation_answer,
    selection_answer,
    selection_details,
)
from tronlab.report.study.charts import (
    NO_RANK,
    larger_terrain_chart,
    load_chart,
    selection_chart,
)
from tronlab.report.study.comparisons import (
    compare_cores,
    compare_terrains,
    cores_table,
    larger_table,
)
from tronlab.report.study.gallery import Captioned, Scenery
from tronlab.report.study.limits_charts import limits_chart, shares_chart
from tronlab.report.study.limits_text import cost_sentences, limit_sentences
from tronlab.report.study.page import Section
from tronlab.report.study.results import StudyResults, select
from tronlab.report.study.tables import (
    bound_table,
    counts_table,
    errors_table,
    parted,
    published_table,
    straight_line_table,
)
from tronlab.report.style import CoreStyle, core_styles, save_chart
from tronlab.score.evaluation.export import Column, Table, frame_table

_LARGER = "Would a larger terrain lower the error?"
_LOAD = "What does localisation cost in time and memory?"
_SELECTION = "What does a better choice of features and matches gain?"
_LIMITS = "What limits accuracy: view geometry, truth, terrain model or estimator?"

_OF_PROBABILITIES = (
    "Intervals draw whole trajectories; p takes the shots of a trajectory as independent, so it is"
    " rather too small."
)


@dataclass(frozen=True, slots=True)
class Studio:
    """What sections are made from, and where their pictures go."""

    results: StudyResults
    folder: Path
    styles: Mapping[str, CoreStyle]

    @classmethod
    def of(cls, results: StudyResults, folder: Path) -> "Studio":
        """Give every core of a study its style."""
        return cls(results, folder, core_styles(results.cores))

    def drawn(self, figure: Figure, stem: str, caption: str) -> Captioned:
        """Save a chart and caption it."""
        return Captioned(PageFigure(save_chart(figure, self.folder, stem), alt=caption), caption)


def published_section(results: StudyResults, scenery: Scenery) -> Section:
    """Set the paper's tables beside ours."""
    scores = results.datasets
    planned = {name: len(p_trs_m) for name, p_trs_m in scenery.flown.items()}
    tables = [
        published_table("table_1", "Table 1: nominal trajectory", scores, TABLE_1),
        published_table("table_2", "Table 2: perturbed trajectories", scores, TABLE_2),
        counts_table(scores, planned, scenery.rejected),
    ]
    if "dataset_0" in scores:
        tables.insert(0, straight_line_table(scores["dataset_0"]))
    notes = (f"{SOURCE}. Of poses found; LOS: range along the optical axis to the terrain.",)
    sentences = (*notes, f"{INTERVALS}.")
    return Section("published", "The paper's tables", sentences=sentences, tables=tables)


def question_sections(studio: Studio) -> list[Section]:
    """Answer the paper's open questions, (a) to (d)."""
    return [_larger(studio), _load(studio), _selection(studio), _limits(studio)]


def beyond_sections(studio: Studio) -> list[Section]:
    """Show what the paper does not have."""
    results = studio.results
    scores = results.datasets
    comparisons = compare_cores(scores)
    rank = results.tables.get("rank", NO_RANK)
    return [
        Section("errors", "Every dataset and core", tables=[errors_table(scores)]),
        Section(
            "bound",
            "Error over Cramer-Rao bound",
            [
                "Bound: root of the trace of the position's covariance, which no unbiased estimator"
                " undercuts with these landmarks and this noise. The core's own sigma: the same of"
                " the covariance that it states. Of errors as large as stated, the median over"
                " either is 0.7 to 0.9.",
                "The bound knows pixel noise alone. An error is estimate minus truth, so the sigma"
                " of the truth, with the registration of the terrain model, adds to it as squares:"
                " error over both together tells what the estimator itself loses. The requirements"
                " give both.",
            ],
            tables=[bound_table(scores)],
        ),
        Section(
            "perturbation",
            "Error against the perturbation (figure 19)",
            perturbation_answer(rank),
            [] if rank.empty else [_OF_PROBABILITIES],
            tables=[] if rank.empty else [_plain("rank", "Rank correlations", rank)],
        ),
        _parts(studio),
        Section("cores", "Cores against one another", tables=[cores_table(comparisons)]),
        *_effort(results),
    ]


def _larger(studio: Studio) -> Section:
    results = studio.results
    normal, larger = results.datasets, results.larger
    comparisons = compare_terrains(normal, larger)
    first, *others = larger_terrain_answer(normal, larger, comparisons)
    if not comparisons:
        return Section("larger", _LARGER, [first])
    figure = studio.drawn(
        larger_terrain_chart(comparisons, studio.styles),
        "larger_terrain",
        "Position error of each pose with the larger terrain against that with the usual one; below"
        " the line the larger one is better.",
    )
    table = larger_table(normal, larger, comparisons)
    return Section("larger", _LARGER, [first], others, [table], [figure])


def _load(studio: Studio) -> Section:
    load = studio.results.tables.get("load")
    if load is None or load.empty:
        return Section("load", _LOAD, ["The computational load was not measured."])
    figure = studio.drawn(
        load_chart(load, {**core_styles(_cores(load)), **studio.styles}),
        "load",
        "Time of one image by stage, and the most memory its process held, against image size,"
        " number of features and number of landmarks; the other two stay as they are.",
    )
    table = _plain("load", "Computational load, medians over images", load)
    return Section("load", _LOAD, load_answer(load), tables=[table], figures=[figure])


def _selection(studio: Studio) -> Section:
    selection = studio.results.tables.get("selection")
    if selection is None or selection.empty:
        return Section(
            "selection", _SELECTION, ["No way of choosing features and matches was tried."]
        )
    titles = {name: published.title for name, published in DATASETS.items()}
    figure = studio.drawn(
        selection_chart(selection, titles | {"all": "all datasets"}),
        "selection",
        "Gain of each choice of features and matches over its base, paired by shot, with 95 %"
        " intervals; grey: the interval includes zero.",
    )
    table = _plain("selection", "Choices of features and matches", selection)
    answer, details = selection_answer(selection), selection_details(selection)
    return Section("selection", _SELECTION, answer, details, [table], [figure])


def _limits(studio: Studio) -> Section:
    tables = studio.results.tables
    if not {"ablation", "shares", "limits"} <= set(tables):
        return Section("limits", _LIMITS, ["No sources of error were switched off."])
    ablation, shares, limits = (tables[name] for name in ("ablation", "shares", "limits"))
    answers = [limit_sentences(select(limits, core=core), shares) for core in _cores(limits)]
    verdicts = [answer[0] for answer in answers]
    sentences = [*(text for answer in answers for text in answer[1:]), *cost_sentences(ablation)]
    figures = [
        studio.drawn(
            cost_chart(ablation),
            "ablation",
            "What each source of dissimilarity costs: mean error with all sources minus that"
            " without this one, over the same shots, with 95 % intervals.",
        ),
        studio.drawn(
            limits_chart(limits),
            "limits",
            "Median error of each core beside its Cramer-Rao bound, the sigma of the truth, and"
            " both together.",
        ),
        studio.drawn(
            shares_chart(shares),
            "shares",
            "What makes the typical error of each core: shares of its square.",
        ),
    ]
    shown = [
        _plain("ablation", "What each source costs", ablation),
        _plain("limits", "Errors, bounds and truth", limits),
    ]
    return Section("limits", _LIMITS, verdicts, sentences, shown, figures)


def _parts(studio: Studio) -> Section:
    tables: list[Table] = []
    figures: list[Captioned] = []
    for part in parted(studio.results.scores):
        if len(part.bins) < 2:
            continue
        tables.append(bins_table(part.scores, part.column, part.bins, label=part.label))
        chart = error_boxes(
            part.scores,
            studio.styles,
            part.column,
            part.bins,
            label=part.label,
            counted=part.counted,
        )
        caption = f"Position error of all datasets by {part.label}."
        figures.append(studio.drawn(chart, f"boxes_{part.column}", caption))
    heading = "Error against range, usable area and inliers"
    return Section("parts", heading, tables=tables, figures=figures)


def _effort(results: StudyResults) -> Iterator[Section]:
    steps = pd.DataFrame(results.info.get("steps", []))
    wanted = ["name", "seconds", "peak_memory_mb"]
    if set(wanted) <= set(steps.columns):
        table = _plain("steps", "Steps of the study", steps[wanted])
        minutes = float(steps["seconds"].sum()) / 60.0
        text = f"All {len(steps)} steps together took {minutes:.1f} minutes."
        yield Section("effort", "What the study took", [text], tables=[table])


def _plain(name: str, caption: str, frame: pd.DataFrame) -> Table:
    """Give a table with the columns of a file, and headings without its underscores."""
    table = frame_table(name, caption, frame)
    columns = tuple(
        Column(c.name, c.name.replace("_", " "), ".3g" if _is_real(frame, c.name) else "")
        for c in table.columns
    )
    return Table(name, caption, columns, table.rows)


def _is_real(frame: pd.DataFrame, column: str) -> bool:
    return pd.api.types.is_float_dtype(frame[column])


def _cores(frame: pd.DataFrame) -> Sequence[str]:
    return list(dict.fromkeys(map(str, frame["core"])))
