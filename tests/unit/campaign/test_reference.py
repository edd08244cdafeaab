from collections.abc import Iterator, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.campaign.reference import render_references
from tronlab.dataset.records import ReferenceView
from tronlab.errors import PlanError
from tronlab.geometry.camera import CameraModel
from tronlab.render.photometry import Lambert
from tronlab.render.renderer import Lamp, Rendering
from tronlab.render.settings import RenderedImages, RenderSettings
from tronlab.terrain.heightmap import HeightMap

CAMERA = CameraModel(width_px=20, height_px=20, fx_px=15.0, fy_px=15.0, cx_px=9.5, cy_px=9.5)
LAMP = Lamp(p_trs_m=np.array([0.0, 0.0, 5.0]), intensity=1.0)
DOWN = RigidTransform.from_matrix(np.diag([1.0, -1.0, -1.0, 1.0]))


class Scripted:
    """Gives prepared radiances, and remembers how it was asked."""

    def __init__(self, *radiances: NDArray[np.float32]) -> None:
        self._radiances = list(radiances)
        self.asked: list[tuple[str, int]] = []

    def render_batch(
        self,
        camera: CameraModel,
        trs_from_cams: Sequence[RigidTransform],
        lamp: Lamp,
        settings: RenderSettings,
    ) -> Iterator[Rendering]:
        assert lamp is LAMP
        for _ in trs_from_cams:
            self.asked.append((settings.photometry.kind, settings.rays_per_pixel))
            radiance = self._radiances.pop(0)
            depth = np.ones(camera.shape, np.float32)
            depth[0, 0] = np.nan
            points = np.zeros((*camera.shape, 3), np.float32)
            yield Rendering(radiance, depth, points, radiance > 0)


def references(renderer: Scripted, n_views: int) -> tuple[ReferenceView, ...]:
    return render_references(
        [RigidTransform.from_translation([0, 0, 1.0 + i]) * DOWN for i in range(n_views)],
        heightmap=HeightMap(np.zeros((5, 5), np.float32), 0.5, np.array([-1.0, -1.0, 0.0])),
        renderer=renderer,  # pyright: ignore[reportArgumentType]
        camera=CAMERA,
        lamp=LAMP,
        config=RenderedImages(rays_per_pixel=4, photometry=Lambert()),
    )


def test_one_grey_scale_serves_all_views() -> None:
    dim, bright = (np.full(CAMERA.shape, v, np.float32) for v in (0.01, 0.04))
    views = references(Scripted(dim, bright), 2)
    assert [view.view_id for view in views] == [1, 2]
    np.testing.assert_array_equal(views[1].image, 220)
    np.testing.assert_array_equal(views[0].image, 55)


def test_few_glaring_pixels_saturate_and_do_not_darken_the_rest() -> None:
    radiance = np.full(CAMERA.shape, 0.02, np.float32)
    radiance[5, 5] = 100.0
    view = references(Scripted(radiance), 1)[0]
    assert view.image[5, 5] == 255
    assert view.image[6, 6] == 220


def test_shadows_do_not_count_for_the_scale_and_stay_black() -> None:
    radiance = np.zeros(CAMERA.shape, np.float32)
    radiance[:2] = 0.02
    view = references(Scripted(radiance), 1)[0]
    assert set(np.unique(view.image)) == {0, 220}


def test_mask_is_the_outline_where_there_is_depth() -> None:
    near, far = references(
        Scripted(*(np.full(CAMERA.shape, 0.02, np.float32) for _ in range(2))), 2
    )
    assert not near.mask[0, 0]  # no depth there
    assert near.mask.sum() == near.mask.size - 1  # the plane of 2 m fills the view from 1 m
    # From 2 m the plane has 2 m * 15 px / 2 m = 15 px.
    assert abs(int(far.mask.sum()) - 15**2) <= 2 * 15 + 1


def test_asks_for_what_the_campaign_says() -> None:
    renderer = Scripted(np.ones(CAMERA.shape, np.float32))
    references(renderer, 1)
    assert renderer.asked == [("lambert", 4)]


def test_dark_views_are_an_error() -> None:
    with pytest.raises(PlanError, match="no view shows lit terrain"):
        references(Scripted(np.zeros(CAMERA.shape, np.float32)), 1)
