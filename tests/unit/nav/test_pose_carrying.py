"""Views that carry no pose are refused with the reason; good ones are not."""

import numpy as np
import pytest
from pose_views import CAMERA, TRUTH, make_matches
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.uncertainty import perturb
from tronlab.nav.pose import (
    Correspondences,
    NoPoseError,
    check_agreement,
    check_view,
    cramer_rao_bound,
    find_agreeing,
    refine_pose,
)
from tronlab.nav.pose.ambiguity import other_pose
from tronlab.nav.settings import PoseSettings

TOLERANCE_PX = 4.0
FLAT = (2.4, 2.401)


def check(matches: Correspondences, pose: RigidTransform = TRUTH, **changes: float) -> np.ndarray:
    options = {"sigma_px": 0.5, "max_sigma_pct": 5.0} | changes
    return check_view(pose, matches, CAMERA, **options)


def test_good_view_is_not_refused_and_has_its_bound(rng: np.random.Generator) -> None:
    matches = make_matches(rng, 30, sigma_px=0.5)
    bound = check(matches)
    assert (bound == cramer_rao_bound(TRUTH, matches, CAMERA, sigma_px=0.5)).all()
    check_agreement(TRUTH, matches, CAMERA, tolerance_px=TOLERANCE_PX)


def test_matches_on_a_line(rng: np.random.Generator) -> None:
    matches = make_matches(rng, 40, half_y=0.003, depth_m=FLAT)
    with pytest.raises(NoPoseError, match=r"allowed are 5 %: 40 matches within .* all on a line"):
        check(matches)


def test_matches_in_a_small_part_of_the_image(rng: np.random.Generator) -> None:
    matches = make_matches(rng, 20, half_x=0.03, half_y=0.03, depth_m=FLAT)
    with pytest.raises(NoPoseError, match=r"within \d+ x \d+ px, a small part of the image"):
        check(matches)


def tilted_plane(rng: np.random.Generator, half: float, slope: float) -> Correspondences:
    """30 points of a plane that recedes by ``slope``, seen within ``half`` of the optical axis."""
    rays = rng.uniform(-half, half, (30, 2))
    p_cam = np.column_stack([rays, np.ones(30)]) * (2.4 / (1 - slope * rays[:, :1]))
    uv = CAMERA.project(p_cam) + rng.normal(0.0, 0.5, (30, 2))
    return Correspondences(uv, CAMERA.rays(uv), TRUTH.apply(p_cam), np.ones(30))


def test_small_view_of_a_plane_fits_it_tilted_to_either_side(rng: np.random.Generator) -> None:
    small = tilted_plane(rng, half=0.02, slope=0.5)
    with pytest.raises(NoPoseError, match=r"m away fits nearly as well, the points tilted.*30 mat"):
        check(small)
    other = other_pose(TRUTH, small, CAMERA, max_excess_px2=5.0)
    assert other is not None
    to_plane = TRUTH.apply([0, 0, 2.4]) - np.array([TRUTH.translation, other.translation])
    # The camera moves about the points, from one side of the normal to the other.
    np.testing.assert_allclose(np.linalg.norm(to_plane, axis=1), 2.4, rtol=0.02)
    normal = TRUTH.rotation.apply([-0.5, 0.0, 1.0]) / np.hypot(0.5, 1.0)
    across = to_plane - (to_plane @ normal)[:, None] * normal
    np.testing.assert_allclose(across[1], -across[0], atol=0.15)


def test_plane_that_fills_the_image_or_is_faced_has_one_pose(rng: np.random.Generator) -> None:
    check(tilted_plane(rng, half=0.3, slope=0.5))
    check(tilted_plane(rng, half=0.3, slope=0.0))


def test_noisy_or_few_matches(rng: np.random.Generator) -> None:
    with pytest.raises(NoPoseError, match=r"7 matches within \d+ x \d+ px, noise 30 px"):
        check(make_matches(rng, 7), sigma_px=30.0)
    with pytest.raises(NoPoseError, match="5 agreeing matches, at least 6 needed"):
        check(make_matches(rng, 5))


def test_points_that_are_one_point(rng: np.random.Generator) -> None:
    seen = make_matches(rng, 20)
    one = seen.take(np.zeros(20, np.intp))
    with pytest.raises(NoPoseError, match="m from the matched points, which cover 0 m"):
        check(Correspondences(seen.uv, seen.rays, one.p_trs_m, one.scale))
    two = seen.take(np.arange(20) % 2)
    with pytest.raises(NoPoseError, match=r"do not determine the pose.*20 matches within"):
        check(two)


def test_pose_behind_its_points_or_far_away(rng: np.random.Generator) -> None:
    matches = make_matches(rng, 20)
    turned = perturb(TRUTH, np.array([np.pi, 0, 0, 0, 0, 0]))
    with pytest.raises(NoPoseError, match="20 of 20 points behind the camera"):
        check(matches, turned)
    away = RigidTransform.from_components([1.1, 2.1, 5e3], TRUTH.rotation)
    with pytest.raises(NoPoseError, match=r"5e\+03 m from the matched points, which cover"):
        check(matches, away)


@pytest.mark.parametrize("n_right", [6, 12, 200])
def test_agreement_that_chance_cannot_explain(n_right: int, rng: np.random.Generator) -> None:
    matches = make_matches(rng, 2 * n_right, sigma_px=0.5, n_wrong=n_right)
    check_agreement(TRUTH, matches, CAMERA, tolerance_px=TOLERANCE_PX)


@pytest.mark.opencv
def test_best_pose_of_wrong_matches_is_refused() -> None:
    """Robust estimation finds what agrees most by chance, and least squares makes it more."""
    settings = PoseSettings(robust="usac")
    n_found = 0
    for seed in range(4):
        rng = np.random.default_rng(seed)
        matches = make_matches(rng, 300, n_wrong=300, half_x=0.1, half_y=0.1)
        try:
            pose, agrees = find_agreeing(matches, CAMERA, settings, seed=seed)
        except NoPoseError:
            continue
        n_found += 1
        poses = [pose]
        try:
            refined = refine_pose(pose, matches.take(agrees), CAMERA, gate_px=6.0)
            poses.append(refined.trs_from_cam)
        except NoPoseError:
            pass
        for one in poses:
            with pytest.raises(NoPoseError, match="of the image agree with the pose: chance"):
                check_agreement(one, matches, CAMERA, tolerance_px=TOLERANCE_PX)
    assert n_found > 2


def test_one_place_seen_often_is_one_match(rng: np.random.Generator) -> None:
    wrong = make_matches(rng, 60, n_wrong=60)
    right = make_matches(rng, 4)
    often = right.take(np.repeat(np.arange(4), 10))
    both = Correspondences(
        np.vstack([wrong.uv, often.uv]),
        np.vstack([wrong.rays, often.rays]),
        np.vstack([wrong.p_trs_m, often.p_trs_m]),
        np.ones(100),
    )
    with pytest.raises(NoPoseError, match="at 4 of 6"):
        check_agreement(TRUTH, both, CAMERA, tolerance_px=TOLERANCE_PX)
    three = right.take(np.repeat(np.arange(3), 10))
    with pytest.raises(NoPoseError, match="at 3 of 3 places"):
        check_agreement(TRUTH, three, CAMERA, tolerance_px=TOLERANCE_PX)


def test_tolerance_as_large_as_the_image_lets_anything_agree(rng: np.random.Generator) -> None:
    with pytest.raises(NoPoseError, match="chance explains fewer than"):
        check_agreement(TRUTH, make_matches(rng, 50), CAMERA, tolerance_px=700.0)
