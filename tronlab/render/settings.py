"""How an image is rendered: what a campaign or a rig file may say about it."""

from typing import Annotated, Literal, TypeAlias

from pydantic import Field

from tronlab.render.photometry import Lambert, PhotometryField
from tronlab.yaml_models import Model

RaysPerPixel: TypeAlias = Literal[1, 4]
Shadows: TypeAlias = Literal["map", "rays"]
DEFAULT_RENDERER = "heightfield"


class RenderOptions(Model):
    """How an image is rendered, whatever the surface is like."""

    rays_per_pixel: RaysPerPixel = 1
    """Rays cast through a pixel: 1 is faster, 4 has smooth edges."""
    shadows: Shadows = "map"
    """`map`: worked out once for a lamp that stands still. `rays`: by a ray to the lamp from every
    point seen; slower, for lamps that move."""
    prefilter: bool = True
    """Take the mean light of what a pixel covers, where that is more than one sample of the
    terrain; with false the light at a point, which speckles from afar."""
    ambient: Annotated[float, Field(ge=0)] = 0.0
    """Light from everywhere, in parts of the lamp's on a surface that faces it from 1 m."""
    vignetting_power: Annotated[float, Field(ge=0, le=8)] = 0.0
    """Images darken by this power of the cosine of the angle off the optical axis; 4 is the law of
    a simple lens."""


class RenderSettings(RenderOptions):
    """How an image is rendered."""

    photometry: PhotometryField = Lambert()
    """How the surface is taken to reflect light: a name, or a mapping with kind and parameters."""


class RendererChoice(Model):
    """Who renders images."""

    renderer: Annotated[str, Field(min_length=1)] = DEFAULT_RENDERER
    """Who renders them: `heightfield`, `reference`, `mitsuba`, `cycles`, or another installed."""
    every_n: Annotated[int, Field(ge=1, le=100)] = 1
    """Take every so many samples of the terrain alone: for renderers that keep a mesh of it."""


class RenderedImages(RendererChoice, RenderSettings):
    """Who renders images, and how."""
