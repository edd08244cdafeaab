"""Draw ``docs/images/photometry.png``: python docs/draw_photometry.py [PICTURE.png]."""

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tronlab.geometry.poses import FloatArray
from tronlab.render.photometry import (
    Hapke,
    Lambert,
    LommelSeeliger,
    LunarLambert,
    Photometry,
    reflected,
)

ROOT = Path(__file__).resolve().parents[1]
FUNCTIONS: dict[str, tuple[Photometry, str, str]] = {
    "Lambert": (Lambert(), "#1f4fd8", "-"),
    "Lommel-Seeliger": (LommelSeeliger(), "#e08a00", "-"),
    "lunar-Lambert": (LunarLambert(), "#2ca02c", "--"),
    "Hapke": (Hapke(), "#d62728", "-"),
}
SPHERE_PHASES_DEG = (2, 60)


def draw(path: Path) -> None:
    """Draw the picture."""
    mpl.rcParams.update({"font.size": 11, "font.family": "DejaVu Sans"})
    figure = Figure(figsize=(13, 8.6), facecolor="white")
    draw_face_on(figure.add_axes((0.07, 0.56, 0.40, 0.37)))
    draw_opposition(figure.add_axes((0.56, 0.56, 0.40, 0.37)))
    for row, phase_deg in enumerate(SPHERE_PHASES_DEG):
        bottom = 0.245 - 0.235 * row
        text = f"phase {phase_deg}°\n\neach to its\nown maximum"
        figure.text(0.07, bottom + 0.11, text, va="center", color="0.25")
        for column, (name, (function, _, _)) in enumerate(FUNCTIONS.items()):
            axes = figure.add_axes((0.14 + 0.21 * column, bottom, 0.20, 0.225))
            axes.imshow(sphere(function, np.radians(phase_deg)), cmap="gray", vmin=0, vmax=1)
            axes.axis("off")
            if row == 0:
                axes.set_title(name, fontsize=11)
    figure.savefig(path, dpi=100)


def draw_face_on(axes: Axes) -> None:
    """Draw what a surface sends straight up while the lamp goes down."""
    phase_deg = np.linspace(0, 90, 500)
    phase = np.radians(phase_deg)
    for name, (function, colour, dashes) in FUNCTIONS.items():
        factor = reflected(function, np.cos(phase), 1.0, phase)
        axes.plot(phase_deg, factor / factor[0], color=colour, ls=dashes, label=name)
    axes.set_title("Seen from above (e = 0, i = g)", loc="left")
    axes.set_xlabel("phase angle in degrees")
    axes.set_ylabel("radiance factor, 1 at phase 0")
    axes.set_xlim(0, 90)
    axes.set_ylim(0, 1.02)
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)


def draw_opposition(axes: Axes) -> None:
    """Draw how bright the middle of the disk and its edge are with the lamp behind the eye."""
    angle_deg = np.linspace(0, 89.9, 500)
    cosine = np.cos(np.radians(angle_deg))
    for function, colour, dashes in FUNCTIONS.values():
        factor = reflected(function, cosine, cosine, 0.0)
        axes.plot(angle_deg, factor / factor[0], color=colour, ls=dashes)
    axes.set_title("The lamp behind the eye (g = 0, i = e)", loc="left")
    axes.set_xlabel("angles of incidence and emission in degrees")
    axes.set_ylabel("radiance factor, 1 face on")
    axes.set_xlim(0, 90)
    axes.set_ylim(0, 1.1)
    axes.grid(alpha=0.3)


def sphere(function: Photometry, phase_rad: float) -> FloatArray:
    """Give an image of a sphere lit from the left, 1 where it is brightest."""
    x, y = np.meshgrid(np.linspace(-1.05, 1.05, 300), np.linspace(-1.05, 1.05, 300))
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    cos_incidence = np.cos(phase_rad) * z - np.sin(phase_rad) * x
    factor = reflected(function, np.where(z > 0, cos_incidence, -1.0), z, phase_rad)
    # As a screen shows light: without this gamma all would look darker than they are.
    return (factor / factor.max()) ** (1 / 2.2)


if __name__ == "__main__":
    draw(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs/images/photometry.png")
