"""The report of one scored dataset: figures, tables and the page, written and put in place."""

import json
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import pandas as pd

from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import Provenance
from tronlab.errors import DatasetError, IntegrityError
from tronlab.report.curves import error_against_range, error_distribution
from tronlab.report.histograms import error_histograms
from tronlab.report.page import CoreSection, Page, PageFigure, render_page
from tronlab.report.paper import SOURCE
from tronlab.report.pictures import (
    ShotPicture,
    contact_sheet,
    shots_over_range,
    single_picture,
)
from tronlab.report.style import CoreStyle, core_styles, save_chart, save_picture
from tronlab.report.tables import (
    Table,
    cores_of,
    paper_table,
    shots_table,
    statistics_table,
    to_csv,
    to_latex,
    worst_first,
    worst_shots_table,
)
from tronlab.score.results import ScoreResults, load_results

PAGE_NAME = "report.html"
MAX_PAGE_SHOTS = 2000
"""More shots of a core than this are not listed on the page, which must stay quick to open."""
_OWN_FILES = ("figures/histograms_*", "figures/worst_*", "figures/contact_sheet*")
"""Files of an earlier report that the new one may no longer have."""


def build_report(directory: Path, *, announce: Callable[[str], None] | None = None) -> Path:
    """Write ``figures/``, ``tables/`` and ``report.html`` into a directory that holds scores.

    Everything is made beside the old report first; only then is each file replaced, the page last.

    Args:
        directory: Where ``tronlab score`` wrote its results.
        announce: Told what is being made.

    Returns:
        The path of the page.

    Raises:
        ScoreError: The directory holds no scores, or they cannot be read.
        IntegrityError: The dataset lacks a shot that was scored.
    """
    say = announce or _keep_quiet
    results = load_results(directory)
    with TemporaryDirectory(prefix=".report-", dir=directory) as staging, _recording(
        results
    ) as recording:
        folder = Path(staging)
        (folder / "figures").mkdir()
        (folder / "tables").mkdir()
        page = _make_page(results, recording, folder, say)
        (folder / PAGE_NAME).write_text(render_page(page), encoding="utf-8")
        _put_in_place(folder, directory)
    return directory / PAGE_NAME
