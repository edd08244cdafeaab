from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tronlab.errors import CalibrationError
from tronlab.geometry.camera import CameraModel

CAMERA = CameraModel(
    width_px=1024,
    height_px=768,
    fx_px=744.0,
    fy_px=745.5,
    cx_px=515.2,
    cy_px=380.1,
    distortion=(-0.11, 0.06, 4e-4, -3e-4, -0.01),
)

RATIONAL = replace(CAMERA, distortion=(0.4, -0.1, 4e-4, -3e-4, 0.02, 0.5, -0.05, 0.01))

in_image = st.tuples(st.floats(-0.5, 1023.5), st.floats(-0.5, 767.5))


@given(in_image, st.sampled_from([CAMERA, RATIONAL]))
def test_rays_and_pixels_are_inverse(uv, camera):
    np.testing.assert_allclose(camera.pixels(camera.rays(uv)), uv, atol=1e-8)


@given(in_image, st.floats(0.1, 50))
def test_a_point_on_a_ray_projects_to_its_pixel(uv, depth_m):
    x, y = CAMERA.rays(uv)
    np.testing.assert_allclose(
        CAMERA.project([x * depth_m, y * depth_m, depth_m])[0], uv, atol=1e-7
    )


@pytest.mark.opencv
@pytest.mark.parametrize("camera", [CAMERA, RATIONAL], ids=["brown", "rational"])
def test_projection_equals_opencvs(camera):
    cv2 = pytest.importorskip("cv2")
    points = np.random.default_rng(1).uniform([-2, -1.5, 2], [2, 1.5, 5], size=(500, 3))
    expected, _ = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.distortion)
    )
    np.testing.assert_allclose(camera.project(points), expected[:, 0], atol=1e-9)


def test_points_behind_the_camera_have_no_pixel():
    uv = CAMERA.project([[0, 0, 1], [0, 0, -1], [0, 0, 0]])
    assert np.isfinite(uv[0]).all()
    assert np.isnan(uv[1:]).all()


def test_a_crop_sees_the_same_rays():
    crop = CAMERA.cropped(left_px=100, top_px=50, width_px=640, height_px=480)
    np.testing.assert_allclose(crop.rays([10.0, 20.0]), CAMERA.rays([110.0, 70.0]), atol=1e-12)
    assert crop.shape == (480, 640)


def test_larger_pixels_see_as_far_as_the_small_ones_did():
    small = CAMERA.scaled(100)
    assert small.shape == (round(100 * CAMERA.height_px / CAMERA.width_px), 100)
    borders = [
        camera.rays([[-0.5, -0.5], [camera.width_px - 0.5, camera.height_px - 0.5]])
        for camera in (small, CAMERA)
    ]
    np.testing.assert_allclose(*borders, atol=1e-12)


def test_the_ray_table_is_the_ray_of_every_pixel_centre():
    small = replace(CAMERA, width_px=5, height_px=4)
    table = small.ray_table(du_px=0.25, dv_px=-0.25)
    assert table.shape == (4, 5, 2)
    np.testing.assert_allclose(table[2, 3], small.rays([3.25, 1.75]), atol=1e-12)


def test_the_field_of_view_is_that_of_the_outer_pixel_borders():
    ideal = CameraModel(
        width_px=1024, height_px=1024, fx_px=773.5, fy_px=773.5, cx_px=511.5, cy_px=511.5
    )
    assert np.degrees(ideal.horizontal_fov_rad) == pytest.approx(67.0, abs=0.05)


def test_a_model_survives_its_plain_form():
    assert CameraModel.from_dict(RATIONAL.to_dict()) == RATIONAL


@pytest.mark.parametrize("n", [0, 4, 5])
def test_coefficients_left_out_are_zero(n):
    short = {**RATIONAL.to_dict(), "distortion": RATIONAL.distortion[:n]}
    assert CameraModel.from_dict(short).distortion == (*RATIONAL.distortion[:n], *[0.0] * (8 - n))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fx": 1.0}, "missing or unknown: fx"),
        ({"distortion": [0.0] * 9}, "9 distortion coefficients, at most 8"),
        ({"fx_px": "wide"}, "could not convert"),
    ],
)
def test_a_damaged_plain_form_is_refused(change, message):
    with pytest.raises(CalibrationError, match=message):
        CameraModel.from_dict({**CAMERA.to_dict(), **change})


def test_a_distortion_that_folds_the_image_is_refused():
    folded = replace(CAMERA, distortion=(-2.0, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(CalibrationError, match="cannot be inverted"):
        folded.rays([0.0, 0.0])


@given(st.floats(-1.5, -0.3), st.floats(0, 1023))
def test_a_ray_is_never_taken_from_beyond_the_fold(k1, u):
    camera = replace(CAMERA, distortion=(k1, 0.0, 0.0, 0.0, 0.0))
    try:
        x, y = camera.rays([u, camera.cy_px])
    except CalibrationError:
        return
    assert 1 + 3 * k1 * (x * x + y * y) > 0  # the radial map still grows outward
