import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import pose_along_boresight
from tronlab.planning.view import View, view_findings, view_from
from tronlab.render.mask import model_mask
from tronlab.terrain.heightmap import HeightMap

MODEL = HeightMap(np.zeros((23, 43), np.float32), 0.1, np.zeros(3))
CAMERA = CameraModel(
    1024, 1024, 767.0, 766.0, 515.0, 508.0, (-0.1, 0.09, 4e-4, -3e-4, 0.0)
)  # as the lens of the paper


class FlatModel:
    """The plane of the model, within its outline."""

    def range_along_m(self, p_trs_m, direction_trs) -> float:
        distance = -p_trs_m[2] / direction_trs[2]
        x, y, _ = p_trs_m + distance * np.asarray(direction_trs)
        is_hit = distance > 0 and 0 <= x <= MODEL.size_m[0] and 0 <= y <= MODEL.size_m[1]
        return float(distance) if is_hit else float("nan")


def view_at(pose: RigidTransform, camera: CameraModel = CAMERA) -> View:
    return view_from(pose, heightmap=MODEL, camera=camera, range_finder=FlatModel())


def looking(place, boresight=(0.0, 0.0, -1.0)) -> RigidTransform:
    return pose_along_boresight(place, boresight=boresight, right=(0.0, 1.0, 0.0))


def test_a_model_within_the_image_fills_it_as_similar_triangles_say():
    pinhole = CameraModel(600, 600, 300.0, 300.0, 299.5, 299.5)
    view = view_at(looking((1.1, 2.1, 3.0)), pinhole)
    assert view.usable_fraction == pytest.approx((2.2 / 6.0) * (4.2 / 6.0), abs=2e-3)
    assert view.range_los_m == pytest.approx(3.0)


def test_the_usable_fraction_is_that_of_the_whole_mask():
    """Asked for are 0.5 % of the image; edges along rows of pixels are the worst case."""
    rng = np.random.default_rng(0)
    square_on = [looking((1.08, 2.08, z)) for z in np.linspace(4.0, 1.0, 8)]
    oblique = [
        looking(rng.uniform((0, 0, 0.8), (2, 4, 4)), (*rng.uniform(-0.4, 0.4, 2), -1.0))
        for _ in range(8)
    ]
    errors = [
        view_at(pose).usable_fraction - model_mask(MODEL, CAMERA, pose).mean()
        for pose in (*square_on, *oblique)
    ]
    assert np.abs(errors).max() < 1e-3


def test_looking_past_the_model_is_refused_once():
    view = view_at(looking((1.1, 2.1, 3.0), boresight=(0.0, 0.0, 1.0)))
    findings = view_findings(view, allowed_range_m=(0.3, 9.0), min_usable_fraction=0.0)
    assert [finding.check for finding in findings] == ["view"]
    assert "does not meet the ground" in findings[0].text


def test_beside_the_model_the_ground_is_the_plane_of_its_mean_height():
    """Straight down from 3 m, 1 m off the edge; and tilted by 30 degrees."""
    assert view_at(looking((-1.0, 2.1, 3.0))).range_los_m == pytest.approx(3.0)
    tilted = looking((-1.0, 2.1, 3.0), boresight=(0.0, -0.5, -np.cos(np.radians(30))))
    assert view_at(tilted).range_los_m == pytest.approx(3.0 / np.cos(np.radians(30)))


def test_findings_name_value_and_limit():
    findings = view_findings(View(4.5, 0.151), allowed_range_m=(0.3, 4.0), min_usable_fraction=0.2)
    assert [(finding.check, finding.text) for finding in findings] == [
        ("range", "range is 4.500 m, allowed 0.3 to 4 m"),
        ("usable", "the model fills 15.1 % of the image, at least 20 % is wanted"),
    ]
    assert all(finding.is_refusal for finding in findings)
    assert not view_findings(View(4.0, 0.2), allowed_range_m=(0.3, 4.0), min_usable_fraction=0.2)
