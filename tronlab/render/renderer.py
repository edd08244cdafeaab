"""What a renderer must do, and what it gives."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.devices.laboratory import LampSpec
from tronlab.errors import TronlabError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray, unit
from tronlab.render.settings import RenderSettings

PLAIN = RenderSettings()


class RenderError(TronlabError):
    """An image cannot be rendered as asked."""


@dataclass(frozen=True, slots=True)
class SpotCone:
    """The cone a spotlight lights: full inside the inner angle, dark outside the outer one."""

    axis_trs: FloatArray
    """Unit vector along the beam, shape (3,)."""
    inner_half_angle_rad: float
    outer_half_angle_rad: float


@dataclass(frozen=True, slots=True)
class Lamp:
    """A lamp of equal intensity in all directions, or in those of its cone."""

    p_trs_m: FloatArray
    """Centre, shape (3,)."""
    intensity: float
    """Radiant intensity over pi, so that a white Lambert surface facing the lamp at 1 m has this
    radiance."""
    radius_m: float = 0.0
    """Of the luminous sphere, which gives shadows their soft edges; 0: a point."""
    cone: SpotCone | None = None


def lamp_as_designed(spec: LampSpec, p_trs_m: FloatArray, *, intensity: float = 1.0) -> Lamp:
    """Give the lamp a rig file describes, where it was found to be.

    Args:
        spec: Size and cone of the lamp.
        p_trs_m: Centre of the light, shape (3,).
        intensity: Radiant intensity over pi.
    """
    cone = spec.cone and SpotCone(
        axis_trs=unit(spec.cone.axis_trs),
        inner_half_angle_rad=float(np.radians(spec.cone.inner_half_angle_deg)),
        outer_half_angle_rad=float(np.radians(spec.cone.outer_half_angle_deg)),
    )
    return Lamp(p_trs_m=p_trs_m, intensity=intensity, radius_m=spec.radius_m, cone=cone)


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
    """True where the point at the pixel centre faces the lamp and sees at least half of it."""


class Renderer(Protocol):
    """Renders a height map as a distorted pinhole camera sees it."""

    def render(
        self,
        camera: CameraModel,
        trs_from_cam: RigidTransform,
        lamp: Lamp,
        settings: RenderSettings = PLAIN,
    ) -> Rendering:
        """Render image, depth and points; lens distortion is applied at the ray.

        Raises:
            RenderError: A pose or lamp that is not finite, or what this renderer cannot do.
        """
        ...

    def render_batch(
        self,
        camera: CameraModel,
        trs_from_cams: Sequence[RigidTransform],
        lamp: Lamp,
        settings: RenderSettings = PLAIN,
    ) -> Iterator[Rendering]:
        """Render from many poses with one lamp, in their order, as they are ready."""
        ...
