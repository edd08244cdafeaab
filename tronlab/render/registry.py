"""Which renderers there are, by name."""

from collections.abc import Callable
from importlib.metadata import entry_points
from typing import Protocol

from tronlab.render.renderer import Renderer, RenderError
from tronlab.terrain.heightmap import HeightMap

GROUP = "tronlab.renderers"
"""Entry points of this group name callables that are an ``OpenRenderer``."""


class OpenRenderer(Protocol):
    """Makes a renderer of one terrain."""

    def __call__(
        self,
        heightmap: HeightMap,
        *,
        announce: Callable[[str], None] | None = None,
    ) -> Renderer:
        """Make it.

        Args:
            heightmap: The terrain.
            announce: Is told what takes time.

        Raises:
            RenderError: What it needs is not installed.
        """
        ...


def renderer_names() -> list[str]:
    """Give the names of the renderers known here, whether what they need is installed or not."""
    return sorted({point.name for point in entry_points(group=GROUP)})


def check_renderer(name: str) -> None:
    """Refuse a renderer that nobody knows.

    Raises:
        RenderError: There is none of that name.
    """
    known = renderer_names()
    if name not in known:
        raise RenderError(f"no renderer '{name}'; known renderers: {', '.join(known)}")


def open_renderer(
    name: str,
    heightmap: HeightMap,
    *,
    every_n: int = 1,
    announce: Callable[[str], None] | None = None,
) -> Renderer:
    """Make the renderer of that name; see ``OpenRenderer``.

    Args:
        name: Which.
        heightmap: The terrain.
        every_n: Take every n-th sample of it alone, for want of memory.
        announce: Is told what takes time.

    Raises:
        RenderError: There is no renderer of that name, or what it needs is not installed.
        TerrainError: ``every_n`` leaves nothing of the terrain.
    """
    check_renderer(name)
    (point, *_) = entry_points(group=GROUP, name=name)
    make: OpenRenderer = point.load()
    return make(heightmap.thinned(every_n), announce=announce)
