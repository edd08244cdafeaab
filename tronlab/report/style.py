"""The look all figures share: sizes, fonts, one colour a core, and how they are saved."""

import re
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_pdf import FigureCanvasPdf
from matplotlib.figure import Figure

NORM_COLOUR = "#7f7f7f"
AXIS_COLOURS: Mapping[str, str] = MappingProxyType({"x": "#d62728", "y": "#2ca02c", "z": "#1f77b4"})
"""Red, green and blue for x, y and z, as in the paper; each panel names its axis as well."""

_CORE_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
"""Okabe and Ito, Color Universal Design (2008): told apart with any colour vision."""
_CORE_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
_CORE_LINES = ("-", "--", ":")
"""One after the other, whenever all colours are used up."""
_USUAL_CORES = ("akaze", "brisk", "akaze-refined", "brisk-refined")

_RC: dict[str, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    # A dollar sign in the name of a core is no formula.
    "text.parse_math": False,
    "pdf.fonttype": 42,
}
DPI = 130
_LEGEND_PT = 8.0
_LETTER_IN, _HANDLE_IN, _ROW_IN = 0.07, 0.45, 0.165
"""Sizes of a letter, of a handle with its margins and of a row of a legend in this font size."""


@dataclass(frozen=True, slots=True)
class CoreStyle:
    """How one core looks in every plot, and how its files are called."""

    colour: str
    marker: str
    line: str
    """Dashes, as matplotlib writes them."""
    slug: str
    """The core's name made fit for a file name."""


def core_styles(cores: Sequence[str]) -> dict[str, CoreStyle]:
    """Give each core its style; the paper's cores look alike in every report."""
    others = [core for core in cores if core not in _USUAL_CORES]
    order = [*_USUAL_CORES, *others]
    slugs = _unique_slugs(cores)
    return {core: _style(order.index(core), slugs[core]) for core in cores}


def slug_of(name: str) -> str:
    """Make a name fit for a file name."""
    return re.sub(r"[^A-Za-z0-9_-]+", "_", name) or "_"


def _style(i: int, slug: str) -> CoreStyle:
    return CoreStyle(
        colour=_CORE_COLOURS[i % len(_CORE_COLOURS)],
        marker=_CORE_MARKERS[i % len(_CORE_MARKERS)],
        line=_CORE_LINES[i // len(_CORE_COLOURS) % len(_CORE_LINES)],
        slug=slug,
    )


def _unique_slugs(cores: Sequence[str]) -> dict[str, str]:
    slugs: dict[str, str] = {}
    for core in cores:
        slug = slug_of(core)
        while slug in slugs.values():
            slug += "_"
        slugs[core] = slug
    return slugs


def new_figure(width_in: float, height_in: float) -> Figure:
    """Make an empty figure that no global state knows of."""
    with style_context():
        return Figure(figsize=(width_in, height_in), dpi=DPI, layout="constrained")


def style_context() -> AbstractContextManager[None]:
    """Give the context in which axes are made and figures saved."""
    return mpl.rc_context(cast("Any", _RC))


def note(axes: Axes, text: str) -> None:
    """Write into the middle of an empty panel why it is empty."""
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color="#666666")


def legend_above(figure: Figure, named: Mapping[str, Artist]) -> None:
    """Name what is drawn, above all panels, in as many columns as the names leave room for.

    The figure grows with the rows, so that many names, or long ones, take nothing from the panels.

    Args:
        figure: With a constrained layout.
        named: What is drawn by its name; nothing happens without any.
    """
    if not named:
        return
    width_in = _HANDLE_IN + _LETTER_IN * max(map(len, named))
    n_columns = min(max(int(figure.get_figwidth() / width_in), 1), len(named))
    n_rows = -(-len(named) // n_columns)
    figure.set_figheight(figure.get_figheight() + _ROW_IN * (n_rows - 1))
    figure.legend(
        list(named.values()),
        list(named),
        fontsize=_LEGEND_PT,
        ncols=n_columns,
        loc="outside upper left",
    )


def drawn_names(axes: Axes) -> dict[str, Artist]:
    """Give what is drawn in a panel by its name; of what has the same name, the last."""
    handles, labels = axes.get_legend_handles_labels()
    return dict(zip(labels, handles, strict=True))


# Canvases are told to print, since Figure.savefig draws everything twice.


def save_chart(figure: Figure, folder: Path, stem: str) -> Path:
    """Save a drawing as PNG for the page and as PDF for papers; give the PNG's path.

    No dates go into the files: the same scores make the same bytes.
    """
    path = folder / f"{stem}.png"
    with style_context():
        FigureCanvasAgg(figure).print_png(path, metadata={"Software": None})
        # The places found for the PNG hold for the PDF: finding them takes longer than drawing.
        figure.set_layout_engine("none")
        FigureCanvasPdf(figure).print_pdf(path.with_suffix(".pdf"), metadata={"CreationDate": None})
    return path


def save_picture(figure: Figure, folder: Path, stem: str) -> Path:
    """Save a figure that shows photographs as JPEG, a tenth of the size of a PNG; give its path."""
    path = folder / f"{stem}.jpg"
    with style_context():
        FigureCanvasAgg(figure).print_jpg(path, pil_kwargs={"quality": 85, "optimize": True})
    return path
