"""The page: one HTML file that needs nothing beside itself."""

import base64
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from tronlab.score.evaluation.export import Table

if TYPE_CHECKING:
    from tronlab.report.evaluation import Evaluation

_MEDIA_TYPES = {".png": "image/png", ".jpg": "image/jpeg"}


@dataclass(frozen=True, slots=True)
class PageFigure:
    """A picture of the page."""

    path: Path
    """PNG or JPEG file; its bytes go into the page."""
    alt: str
    """What is seen, for those who cannot see it."""
    anchor: str = ""
    """Where links within the page lead."""
    core: str = ""
    """The core whose worst shot this is."""
    note: str = ""
    """What is to be said below it."""

    @property
    def data_uri(self) -> str:
        """Get the file as a data URI."""
        payload = base64.b64encode(self.path.read_bytes()).decode("ascii")
        return f"data:{_MEDIA_TYPES[self.path.suffix]};base64,{payload}"


@dataclass(frozen=True, slots=True)
class CoreSection:
    """What the page shows of one core."""

    name: str
    anchor: str
    histograms: PageFigure
    shots: Table | None
    """None if there are too many for a page."""


@dataclass(frozen=True, slots=True)
class Page:
    """Everything the page says."""

    title: str
    paper: Table
    paper_source: str
    evaluation: "Evaluation"
    effort: Table
    cores: Sequence[CoreSection]
    """Those that are drawn."""
    not_drawn: str
    """What is to be said of the others; empty if there are none."""
    curves: Sequence[PageFigure]
    pictures: Sequence[PageFigure]
    pictures_missing: str
    """Why there are no pictures; empty if there are."""
    worst_shots: Table
    provenance: Sequence[tuple[str, str]]
    documents: Mapping[str, str]
    """Whole texts by name: campaign, rig and calibration."""

    @property
    def section_anchors(self) -> dict[str, str]:
        """Get where each core's histograms are."""
        return {core.name: core.anchor for core in self.cores}

    @property
    def worst_anchors(self) -> dict[str, str]:
        """Get where the picture of each core's worst shot is."""
        return {picture.core: picture.anchor for picture in self.pictures if picture.core}

    @property
    def worst_links(self) -> dict[str, str]:
        """Get where each core's name leads: to its worst shot, without pictures to their table."""
        return {core.name: self.worst_anchors.get(core.name, "worst") for core in self.cores}


def render_page(page: Page) -> str:
    """Write the page as HTML; every text is escaped."""
    return render_template("report.html.j2", page)


def render_template(name: str, page: object) -> str:
    """Fill a template of this package with what it calls ``page``; every text is escaped."""
    environment = Environment(
        loader=PackageLoader("tronlab.report", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["keep_units_whole"] = _keep_units_whole
    environment.filters["interval_below"] = _interval_below
    environment.filters["breakable"] = _breakable
    return environment.get_template(name).render(page=page)


def _keep_units_whole(heading: str) -> str:
    """Let no line end inside the unit of a heading."""
    return re.sub(r"\[.*?\]", lambda unit: unit.group().replace(" ", "\N{NO-BREAK SPACE}"), heading)


def _breakable(name: str) -> Markup:
    """Let a line end between the parts of a variant's name."""
    return Markup("<wbr>").join(re.split(r"(?<=[,@])(?=\S)", name))


def _interval_below(cell: str) -> Markup:
    """Put the interval of an estimate into a second line."""
    value, _, interval = cell.partition(" ")
    if not interval:
        return escape(value)
    return Markup("{}<br><small>{}</small>").format(value, interval)
