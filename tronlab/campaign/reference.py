"""The reference views: what the terrain looks like from some of the nominal poses.

They are rendered with the calibrated camera and the measured lamp: what a navigation database may
know, and never the truth of a shot.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.campaign.config import DatabaseConfig
from tronlab.dataset.records import ReferenceView
from tronlab.errors import PlanError
from tronlab.geometry.camera import CameraModel
from tronlab.render.mask import model_mask
from tronlab.render.renderer import Lamp, Renderer, Rendering
from tronlab.terrain.heightmap import HeightMap

BRIGHT_PERCENTILE = 99.0
BRIGHT_GREY = 220.0
"""The brightest per cent of the lit terrain is brighter than this, and may saturate."""


def render_references(
    poses: Sequence[RigidTransform],
    *,
    heightmap: HeightMap,
    renderer: Renderer,
    camera: CameraModel,
    lamp: Lamp,
    config: DatabaseConfig,
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
    for trs_from_cam in poses:
        renderings.append(
            renderer.render(
                camera,
                trs_from_cam,
                lamp,
                photometry=config.photometry,
                rays_per_pixel=config.rays_per_pixel,
            )
        )
        if on_view is not None:
            on_view(len(renderings), len(poses))
    grey_per_radiance = _grey_scale([rendering.radiance for rendering in renderings])
    return tuple(
        ReferenceView(
            view_id=view_id,
            trs_from_cam=trs_from_cam,
            image=_grey(rendering.radiance, grey_per_radiance),
            depth_m=rendering.depth_m,
            mask=model_mask(heightmap, camera, trs_from_cam) & np.isfinite(rendering.depth_m),
        )
        for view_id, (trs_from_cam, rendering) in enumerate(
            zip(poses, renderings, strict=True), start=1
        )
    )


def _grey_scale(radiances: Sequence[NDArray[np.float32]]) -> float:
    lit = np.concatenate([radiance[radiance > 0] for radiance in radiances])
    if lit.size == 0:
        raise PlanError(
            "no reference view shows lit terrain; check the trajectory, the terrain's origin_trs_m"
            " and the lamp of the calibration record"
        )
    return BRIGHT_GREY / float(np.percentile(lit, BRIGHT_PERCENTILE))


def _grey(radiance: NDArray[np.float32], grey_per_radiance: float) -> NDArray[np.uint8]:
    return np.clip(np.rint(radiance * grey_per_radiance), 0, 255).astype(np.uint8)
