"""The reference views: what the terrain looks like from some of the nominal poses.

They are rendered with the calibrated camera and the measured lamp: what a navigation database may
know, and never the truth of a shot.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.calib.record import CalibrationRecord
from tronlab.campaign.config import CalibratedPhotometry, DatabaseConfig
from tronlab.dataset.records import ReferenceView
from tronlab.errors import PlanError
from tronlab.geometry.camera import CameraModel
from tronlab.render.mask import model_mask
from tronlab.render.registry import open_renderer
from tronlab.render.renderer import Lamp, Renderer, Rendering
from tronlab.render.settings import DEFAULT_RENDERER, RenderedImages
from tronlab.terrain.heightmap import HeightMap

BRIGHT_PERCENTILE = 99.0
BRIGHT_GREY = 220.0
"""The brightest per cent of the lit terrain is brighter than this, and may saturate."""


def database_images(config: DatabaseConfig, calibration: CalibrationRecord) -> RenderedImages:
    """Say how reference views are rendered: with the photometric function that was calibrated, too.

    Raises:
        CalibrationError: It shall be the calibrated one, and the record has none.
    """
    function = config.photometry
    if isinstance(function, CalibratedPhotometry):
        function = calibration.photometry
    others = config.model_dump(include=set(RenderedImages.model_fields) - {"photometry"})
    return RenderedImages(photometry=function, **others)


def render_references(
    poses: Sequence[RigidTransform],
    *,
    heightmap: HeightMap,
    renderer: Renderer,
    camera: CameraModel,
    lamp: Lamp,
    config: RenderedImages,
    on_view: Callable[[int, int], None] | None = None,
) -> tuple[ReferenceView, ...]:
    """Render the terrain at poses ``trs_from_cam``.

    One grey scale serves all views, so that the same ground looks the same in all of them.

    Args:
        poses: ``trs_from_cam`` of each view.
        heightmap: The terrain, for the outline of the model.
        renderer: Renders that terrain.
        camera: The calibrated camera.
        lamp: The lamp where it was measured.
        config: How to render.
        on_view: Told (views done, views in all) after each.

    Raises:
        PlanError: No view shows any lit terrain.
    """
    renderings: list[Rendering] = []
    for rendering in renderer.render_batch(camera, poses, lamp, config):
        renderings.append(rendering)
        if on_view is not None:
            on_view(len(renderings), len(poses))
    scale = GreyScale.of([rendering.radiance for rendering in renderings])
    return tuple(
        ReferenceView(
            view_id=view_id,
            trs_from_cam=trs_from_cam,
            image=scale.grey(rendering.radiance),
            depth_m=rendering.depth_m,
            mask=model_mask(heightmap, camera, trs_from_cam) & np.isfinite(rendering.depth_m),
        )
        for view_id, (trs_from_cam, rendering) in enumerate(
            zip(poses, renderings, strict=True), start=1
        )
    )


def database_renderer(
    config: RenderedImages,
    heightmap: HeightMap,
    *,
    at_hand: Renderer,
    announce: Callable[[str], None],
) -> Renderer:
    """Give who renders the reference views: the usual renderer, unless another one is asked for.

    Args:
        config: Says which.
        heightmap: The terrain.
        at_hand: The usual renderer of that terrain, which others use too.
        announce: Told of slow steps.

    Raises:
        RenderError: There is no renderer of that name, or what it needs is not installed.
    """
    if (config.renderer, config.every_n) == (DEFAULT_RENDERER, 1):
        return at_hand
    return open_renderer(config.renderer, heightmap, every_n=config.every_n, announce=announce)


@dataclass(frozen=True, slots=True)
class GreyScale:
    """How radiance becomes grey values of 8 bit, the same in all images of a set."""

    grey_per_radiance: float

    @classmethod
    def of(cls, radiances: Sequence[NDArray[np.float32]]) -> "GreyScale":
        """Choose it so that only the brightest of what is lit may saturate.

        Raises:
            PlanError: Nothing is lit.
        """
        lit = np.concatenate([radiance[radiance > 0] for radiance in radiances])
        if lit.size == 0:
            raise PlanError(
                "no view shows lit terrain; check the trajectory, the terrain's origin_trs_m and"
                " the lamp of the calibration record"
            )
        return cls(BRIGHT_GREY / float(np.percentile(lit, BRIGHT_PERCENTILE)))

    def grey(self, radiance: NDArray[np.float32]) -> NDArray[np.uint8]:
        """Give the image of a radiance; what is brighter than 255 is 255."""
        return np.clip(np.rint(radiance * self.grey_per_radiance), 0, 255).astype(np.uint8)
