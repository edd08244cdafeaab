"""The page of a study: verdict and answers first, then worst shots, figures and tables."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from tronlab.report.page import render_template
from tronlab.report.study.gallery import Captioned, Plate
from tronlab.score.evaluation.export import Table


@dataclass(frozen=True, slots=True)
class Section:
    """A part of the page."""

    anchor: str
    heading: str
    summary: Sequence[str] = ()
    """What is said at the top of the page, too."""
    sentences: Sequence[str] = ()
    tables: Sequence[Table] = ()
    figures: Sequence[Captioned] = ()

    @property
    def said(self) -> tuple[str, ...]:
        """Get all sentences."""
        return (*self.summary, *self.sentences)


@dataclass(frozen=True, slots=True)
class WorstShot:
    """The worst shot of a core on a dataset, and where to see it."""

    dataset: str
    core: str
    shot_id: int
    error: str
    """As people read it; without a pose, that."""
    reason: str
    picture: str
    """Link to its picture; empty if there is none. Relative to the page, as ``page``."""
    page: str
    """Link to the dataset's own page; likewise."""


@dataclass(frozen=True, slots=True)
class StudyPage:
    """Everything the page says."""

    title: str
    verdict: str
    missing: Sequence[str]
    """What the study left out."""
    requirements: Table
    shortfalls: Sequence[str]
    """Why some of them are not met."""
    questions: Sequence[Section]
    """The paper's open questions."""
    worst: Sequence[WorstShot]
    published: Section
    """The paper's tables beside ours."""
    plates: Sequence[Plate]
    beyond: Sequence[Section]
    """What the paper does not have."""
    datasets: Sequence[tuple[str, str]]
    """Name and link of each dataset's own page."""
    provenance: Sequence[tuple[str, str]] = field(default_factory=list[tuple[str, str]])

    @property
    def tables(self) -> list[Table]:
        """Get all tables of the page."""
        sections = (self.published, *self.questions, *self.beyond)
        return [self.requirements, *(table for section in sections for table in section.tables)]


def render_study(page: StudyPage) -> str:
    """Write the page as HTML; every text is escaped."""
    return render_template("study.html.j2", page)
