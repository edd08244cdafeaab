"""What a renderer must do, and what it gives."""

from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.errors import TronlabError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray

Photometry: TypeAlias = Literal["lambert", "lunar_lambert"]
RaysPerPixel: TypeAlias = Literal[1, 4]


class RenderError(TronlabError):
    """An image cannot be rendered as asked."""


@dataclass(frozen=True, slots=True)
class Lamp:
    """A point lamp of equal intensity in all directions."""

    p_trs_m: FloatArray
    """Shape (3,)."""
    intensity: float
    """Radiant intensity over pi, so that a white Lambert surface facing the lamp at 1 m has this
    radiance."""


@dataclass(frozen=True, slots=True)
class Rendering:
    """What a camera sees of the terrain."""

    radiance: NDArray[np.float32]
    """Mean over the rays of a pixel, shape (rows, columns); 0 where no terrain is seen."""
    depth_m: NDArray[np.float32]
    """Depth along the optical axis at the pixel centre, shape (rows, columns); NaN: no terrain."""
    points_trs_m: NDArray[np.float32]
    """Point of the terrain at the pixel centre, shape (rows, columns, 3); NaN: no terrain."""
    is_lit: NDArray[np.bool_]
    """True where the point at the pixel centre faces the lamp and is not in shadow."""


class Renderer(Protocol):
    """Renders a height map as a distorted pinhole camera sees it."""

    def render(
        self,
        camera: CameraModel,
        trs_from_cam: RigidTransform,
        lamp: Lamp,
        *,
        photometry: Photometry = "lambert",
        rays_per_pixel: RaysPerPixel = 1,
    ) -> Rendering:
        """Render image, depth and points; lens distortion is applied at the ray."""
        ...
