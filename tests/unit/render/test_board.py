import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import pose_along_boresight
from tronlab.render.board import render_board
from tronlab.render.bow import FLAT, Bow
from tronlab.render.renderer import RenderError

CAMERA = CameraModel(640, 512, 480.0, 481.0, 322.0, 250.0, (-0.15, 0.06, 0.0008, -0.0005, 0.0))
SQUARE_M = 0.03
BOW = Bow(centre_m=(0.18, 0.135), half_m=(0.12, 0.075), terms_m=(0.001, -0.0015, 0.0012))
TEXEL_M = 0.0005
N_X, N_Y = 9, 6
CAM = RigidTransform.from_components([0.3, -0.2, 0.5], Rotation.from_euler("xyz", [0.2, 0.1, 0.4]))


def checkerboard():
    """Give N_X x N_Y inner corners with a white border of one square."""
    per_square = round(SQUARE_M / TEXEL_M)
    i, j = np.indices((N_Y + 1, N_X + 1))
    squares = np.pad(((i + j) % 2 * 255).astype(np.uint8), 1, constant_values=255)
    return np.kron(squares, np.ones((per_square, per_square), np.uint8))


def corners_board(bow=FLAT):
    x, y = np.meshgrid((np.arange(N_X) + 2) * SQUARE_M, (np.arange(N_Y) + 2) * SQUARE_M)
    return np.c_[x.ravel(), y.ravel(), height(bow, x.ravel(), y.ravel())]


def height(bow, x, y):
    a = (x - bow.centre_m[0]) / bow.half_m[0]
    b = (y - bow.centre_m[1]) / bow.half_m[1]
    sag_x, sag_y, twist = bow.terms_m
    return sag_x * (1 - a**2) + sag_y * (1 - b**2) + twist * a * b


def board_pose(distance_m, *, tilt_deg=(0.0, 0.0, 0.0), offset_m=(0.0, 0.0)):
    middle = np.array([(N_X + 3) / 2, (N_Y + 3) / 2, 0.0]) * SQUARE_M
    turn = Rotation.from_euler("xyz", tilt_deg, degrees=True)
    place = np.array([*offset_m, distance_m]) - turn.apply(middle)
    return CAM * RigidTransform.from_components(place, turn)


@pytest.mark.opencv
@pytest.mark.parametrize("rays_per_pixel", [1, 4])
@pytest.mark.parametrize(
    ("distance_m", "tilt_deg", "offset_m", "bow"),
    [
        (0.6, (0, 0, 0), (0, 0), FLAT),
        (0.7, (30, 10, 20), (0.03, 0.02), FLAT),
        (0.7, (30, 10, 20), (0.03, 0.02), BOW),
        (0.8, (-20, 35, 45), (0, 0), FLAT),
        (0.8, (-20, 35, 45), (0, 0), BOW),
        (1.2, (10, -30, 100), (0.1, -0.1), FLAT),
    ],
)
def test_found_corners_are_the_projected_ones(distance_m, tilt_deg, offset_m, bow, rays_per_pixel):
    import cv2

    pose = board_pose(distance_m, tilt_deg=tilt_deg, offset_m=offset_m)
    albedo, _ = render_board(checkerboard(), TEXEL_M, CAMERA, pose, CAM, rays_per_pixel, bow=bow)
    expected = CAMERA.project((CAM.inv() * pose).apply(corners_board(bow)))
    assert expected.min() > 15
    # An edge one pixel wide, sharper than any lens makes it, is too sharp for cornerSubPix: even on
    # images averaged over 36 rays a pixel it is off by up to 0.1 px.
    image = np.round(cv2.GaussianBlur(albedo, None, 1.2) * 250).astype(np.uint8)
    start = expected + np.random.default_rng(1).uniform(-1, 1, expected.shape)
    found = cv2.cornerSubPix(
        image,
        np.ascontiguousarray(start, dtype=np.float32).reshape(-1, 1, 2),
        (6, 6),
        (-1, -1),
        (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4),
    )[:, 0]
    error = np.linalg.norm(found - expected, axis=1)
    assert error.max() < 0.05
    assert np.abs((found - expected).mean(axis=0)).max() < 0.01


@pytest.mark.parametrize("tilt_deg", [(0, 0, 0), (30, 10, 20), (-20, 35, 45)])
def test_pixels_are_the_mean_over_their_area(tilt_deg):
    n = 6
    fine = CameraModel(
        CAMERA.width_px * n,
        CAMERA.height_px * n,
        CAMERA.fx_px * n,
        CAMERA.fy_px * n,
        (CAMERA.cx_px + 0.5) * n - 0.5,
        (CAMERA.cy_px + 0.5) * n - 0.5,
        CAMERA.distortion,
    )
    pose = board_pose(0.7, tilt_deg=tilt_deg)
    texture = checkerboard()
    fine_albedo, _ = render_board(texture, TEXEL_M, fine, pose, CAM, 1)
    expected = fine_albedo.reshape(CAMERA.height_px, n, CAMERA.width_px, n).mean(axis=(1, 3))
    for rays_per_pixel, rms in ((1, 0.012), (4, 0.003)):
        albedo, _ = render_board(texture, TEXEL_M, CAMERA, pose, CAM, rays_per_pixel)
        assert np.sqrt(np.mean((albedo - expected) ** 2)) < rms


def test_the_outline_is_exact_at_pixel_centres():
    pose = board_pose(0.8, tilt_deg=(20, -25, 30))
    texture = np.full((90, 120), 128, np.uint8)
    _, is_seen = render_board(texture, 0.002, CAMERA, pose, CAM, 1)
    board_from_cam = pose.inv() * CAM
    rays = np.dstack([CAMERA.ray_table(), np.ones(CAMERA.shape)])
    directions = rays @ board_from_cam.rotation.as_matrix().T
    depth = -board_from_cam.translation[2] / directions[..., 2]
    x, y, _ = np.moveaxis(board_from_cam.translation + depth[..., None] * directions, -1, 0)
    expected = (depth > 0) & (x >= 0) & (x <= 0.24) & (y >= 0) & (y <= 0.18)
    assert 0.03 < expected.mean() < 0.9
    np.testing.assert_array_equal(is_seen, expected)


def test_the_outline_of_a_bowed_board_is_exact_at_pixel_centres():
    """The rays are followed in steps until they are behind the surface: slow and plain."""
    pose = board_pose(0.8, tilt_deg=(20, -25, 30))
    bow = Bow(centre_m=(0.12, 0.09), half_m=(0.1, 0.07), terms_m=(0.02, -0.015, 0.03))
    texture = np.full((90, 120), 128, np.uint8)
    _, is_seen = render_board(texture, 0.002, CAMERA, pose, CAM, 1, bow=bow)
    board_from_cam = pose.inv() * CAM
    rays = np.dstack([CAMERA.ray_table(), np.ones(CAMERA.shape)])[::4, ::4]
    directions = rays @ board_from_cam.rotation.as_matrix().T
    low, high = np.full(rays.shape[:2], 0.5), np.full(rays.shape[:2], 1.1)
    for _ in range(40):
        middle = (low + high) / 2
        x, y, z = np.moveaxis(board_from_cam.translation + middle[..., None] * directions, -1, 0)
        is_behind = z > height(bow, x, y)
        low, high = np.where(is_behind, low, middle), np.where(is_behind, middle, high)
    expected = (x >= 0) & (x <= 0.24) & (y >= 0) & (y <= 0.18)
    assert 0.03 < expected.mean() < 0.9
    flat = render_board(texture, 0.002, CAMERA, pose, CAM, 1)[1][::4, ::4]
    assert (flat != expected).mean() > 0.005
    np.testing.assert_array_equal(is_seen[::4, ::4], expected)


@pytest.mark.parametrize("rays_per_pixel", [1, 4])
def test_a_uniform_texture_stays_uniform_and_fades_over_the_edge_pixels(rays_per_pixel):
    pose = board_pose(0.8, tilt_deg=(20, -25, 30))
    texture = np.full((90, 120), 200, np.uint8)
    albedo, is_seen = render_board(texture, 0.002, CAMERA, pose, CAM, rays_per_pixel)
    assert albedo.dtype == np.float32
    assert albedo.max() == pytest.approx(200 / 255)
    assert np.mean(albedo[is_seen] > 0.99 * 200 / 255) > 0.97
    assert np.all(albedo >= 0)
    assert np.all(albedo[is_seen] > 0.15)
    assert np.mean(albedo[~is_seen] > 0) < 0.02


def test_fine_stripes_far_away_become_grey():
    texture = np.tile(np.array([0, 255], np.uint8), (900, 600))
    pose = board_pose(1.5)
    albedo, is_seen = render_board(texture, 0.0002, CAMERA, pose, CAM, 4)
    inside = albedo[is_seen & (albedo > 0.25)]
    assert inside.mean() == pytest.approx(0.5, abs=0.02)
    assert np.quantile(np.abs(inside - 0.5), 0.9) < 0.1


def test_columns_of_the_texture_run_along_x_and_rows_along_y():
    texture = np.zeros((40, 60), np.uint8)
    texture[:20, 30:] = 255
    pose = RigidTransform.from_translation([-0.15, -0.1, 1.0])
    albedo, _ = render_board(texture, 0.005, CAMERA, pose, RigidTransform.identity(), 1)
    bright = np.argwhere(albedo > 0.5).mean(axis=0)
    assert bright[1] > CAMERA.cx_px + 10, "to the right"
    assert bright[0] < CAMERA.cy_px - 10, "above"


def test_the_back_and_what_lies_behind_the_camera_are_not_seen():
    texture = checkerboard()
    behind = CAM * RigidTransform.from_translation([-0.1, -0.1, -0.8])
    turned = board_pose(0.8, tilt_deg=(180, 0, 0))
    for pose in (behind, turned):
        albedo, is_seen = render_board(texture, TEXEL_M, CAMERA, pose, CAM, 4)
        assert not is_seen.any()
        assert np.all(albedo == 0)


def test_a_board_edge_on_is_not_seen():
    edge_on = pose_along_boresight((0, 0, 1.0), boresight=(1, 0, 0), right=(0, 1, 0))
    texture = np.full((50, 50), 255, np.uint8)
    camera = CameraModel(64, 64, 60.0, 60.0, 31.5, 31.5)
    _, is_seen = render_board(texture, 0.01, camera, edge_on, RigidTransform.identity(), 1)
    assert not is_seen.any()


@pytest.mark.parametrize(
    ("texture", "texel_m", "rays", "message"),
    [
        (np.zeros((4, 4)), 0.001, 1, r"is float64 of shape \(4, 4\), expected uint8"),
        (np.zeros((4, 4, 3), np.uint8), 0.001, 1, r"uint8 of shape \(4, 4, 3\)"),
        (np.zeros((0, 4), np.uint8), 0.001, 1, r"shape \(0, 4\)"),
        (np.zeros((4, 4), np.uint8), 0.0, 1, "texel_m is 0.0, must be positive"),
        (np.zeros((4, 4), np.uint8), 0.001, 3, "rays_per_pixel is 3, must be 1 or 4"),
    ],
)
def test_what_cannot_be_rendered_is_refused(texture, texel_m, rays, message):
    with pytest.raises(RenderError, match=message):
        render_board(texture, texel_m, CAMERA, board_pose(0.8), CAM, rays)


def test_a_bow_over_nothing_is_refused():
    with pytest.raises(RenderError, match=r"half_m is \(0.1, 0.0\), must be positive"):
        Bow(centre_m=(0.0, 0.0), half_m=(0.1, 0.0), terms_m=(0.001, 0.0, 0.0))
