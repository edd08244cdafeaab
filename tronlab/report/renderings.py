"""Contact sheet of rendered images."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from tronlab.report.style import new_figure, save_picture, style_context

MOST_IMAGES = 36
"""More are shown evenly over the whole."""
_COLUMNS = 6
_WIDTH_IN = 1.6
_CAPTION_IN = 0.24


def save_contact_sheet(images: Mapping[str, Path], folder: Path, *, title: str) -> Path:
    """Draw images side by side into ``folder``; give the file.

    Args:
        images: Grey images of one size, by what is written over them.
        folder: It exists.
        title: Over all of them.
    """
    at = np.linspace(0, len(images) - 1, min(len(images), MOST_IMAGES)).round().astype(int)
    items = list(images.items())
    return save_picture(_contact_sheet([items[i] for i in at], title), folder, "contact_sheet")


def _contact_sheet(images: list[tuple[str, Path]], title: str) -> Figure:
    import cv2

    pictures: list[Any] = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for _, path in images]
    n_rows_px, n_columns_px = pictures[0].shape
    columns = min(_COLUMNS, len(images))
    n_rows = -(-len(images) // columns)
    height_in = n_rows * (_WIDTH_IN * n_rows_px / n_columns_px + _CAPTION_IN)
    with style_context():
        figure = new_figure(_WIDTH_IN * columns, height_in + _CAPTION_IN)
        figure.suptitle(title, fontsize=8)
        for i, ((caption, _), picture) in enumerate(zip(images, pictures, strict=True)):
            axes = figure.add_subplot(n_rows, columns, i + 1)
            axes.imshow(picture, cmap="gray", vmin=0, vmax=255, interpolation="antialiased")
            axes.set_axis_off()
            axes.set_title(caption, fontsize=7, pad=3)
    return figure
