"""Whether matches carry a pose: do more agree than by chance, and do they hold the camera?"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import RigidTransform
from scipy.special import bdtrc

from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray
from tronlab.nav.pose.ambiguity import other_pose
from tronlab.nav.pose.bound import cramer_rao_bound
from tronlab.nav.pose.correspondences import MIN_POINTS, Correspondences, NoPoseError, need
from tronlab.nav.pose.projection import points_in_cam

MAX_FALSE_ALARMS = 1e-4
"""Poses that as many wrong matches would agree with, expected in one image."""
MAX_DISTANCE_EXTENTS = 100.0
"""Largest distance to the points, in sizes of the area they cover: they fill a few pixels then."""
MIN_CHI_SQUARE = 2.0 * float(np.log(1e4))
"""By so much the other pose of a plane must fit worse: it is 10 000 times less likely then."""
SEEN_LARGE = 0.5
"""Size of the area of the points, in distances to it, from which perspective tells its tilt: by
pixels for a degree, so that there is no second pose to look for."""

_SAMPLE = 3
_POSES_OF_SAMPLE = 4
"""Three matches give up to four poses (Gao et al., TPAMI 25, 2003)."""
_RING = 8.0
"""Outer over inner radius of the ring in which the density of landmarks is counted."""
_LINE = 0.05
_SMALL = 0.1


def check_agreement(
    trs_from_cam: RigidTransform,
    matches: Correspondences,
    camera: CameraModel,
    *,
    tolerance_px: float,
) -> None:
    """Refuse a pose that no more matches agree with than would with a wrong one.

    A-contrario test (Moisan and Stival, IJCV 57, 2004): of all poses that three matches can give,
    how many would have so many wrong matches within the tolerance by chance? How likely one is
    comes from the density of the landmarks around each image position. Several matches at one place
    of the image count as one. Otherwise wrong matches are taken to be independent: terrain that
    repeats itself over a part of the image can pass.

    Args:
        trs_from_cam: The pose.
        matches: All that it was sought among, found by descriptor alone: matches sought where a
            pose puts them agree with any.
        camera: Intrinsics.
        tolerance_px: Largest distance of a match that agrees, pixels at the centre of the image.

    Raises:
        NoPoseError: Chance explains the agreement; the text says how many it would take.
    """
    need(len(matches), MIN_POINTS, "matches")
    agrees, chance = _agreement(trs_from_cam, matches, camera, tolerance_px=tolerance_px)
    cell = np.floor(matches.rays * camera.fx_px / (2 * tolerance_px))
    place = np.unique(cell, axis=0, return_inverse=True)[1].ravel()
    n, n_agree = int(place.max()) + 1, len(np.unique(place[agrees]))
    n_needed = _n_needed(n, 1.0 - (1.0 - chance) ** (len(matches) / n))
    if n_agree < n_needed:
        raise NoPoseError(
            f"matches at {n_agree} of {n} places of the image agree with the pose: chance explains"
            f" fewer than {n_needed}"
        )


def check_view(
    trs_from_cam: RigidTransform,
    matches: Correspondences,
    camera: CameraModel,
    *,
    sigma_px: float,
    max_sigma_pct: float,
) -> FloatArray:
    """Refuse a pose that its matches do not hold.

    Args:
        trs_from_cam: The pose.
        matches: The ones that agree with it.
        camera: Intrinsics.
        sigma_px: Standard deviation of one coordinate of a position with ``scale`` 1.
        max_sigma_pct: Largest standard deviation of the position, per cent of the median distance
            of the points.

    Returns:
        The Cramer-Rao bound at the pose, shape (6, 6), rad and m.

    Raises:
        NoPoseError: Too few matches, points behind the camera or very far, the position is less
            certain than allowed, or another one fits as well; the text says what the matches look
            like.
    """
    need(len(matches), MIN_POINTS, "agreeing matches")
    p_cam = points_in_cam(trs_from_cam, matches)
    if n_behind := int((~(p_cam[:, 2] > 0)).sum()):
        raise NoPoseError(f"the pose has {n_behind} of {len(matches)} points behind the camera")
    distance_m = float(np.median(np.linalg.norm(p_cam, axis=1)))
    extent_m = float(np.linalg.norm(np.ptp(p_cam, axis=0)))
    if distance_m > MAX_DISTANCE_EXTENTS * extent_m:
        raise NoPoseError(
            f"the pose is {distance_m:.3g} m from the matched points, which cover {extent_m:.3g} m"
        )
    try:
        bound = cramer_rao_bound(trs_from_cam, matches, camera, sigma_px=sigma_px)
    except NoPoseError as error:
        raise NoPoseError(f"{error}; {_look(matches, camera)}") from error
    if extent_m < SEEN_LARGE * distance_m:
        _check_is_only_one(
            trs_from_cam, matches, camera, sigma_px, max_sigma_pct / 100 * distance_m
        )
    sigma_pct = 100.0 * float(np.sqrt(np.trace(bound[3:, 3:]))) / distance_m
    if sigma_pct > max_sigma_pct:
        raise NoPoseError(
            f"the matches fix the position only to {sigma_pct:.2g} % of the distance, allowed are"
            f" {max_sigma_pct:g} %: {_look(matches, camera)}, noise {sigma_px:.2g} px"
        )
    return bound


def _check_is_only_one(
    trs_from_cam: RigidTransform,
    matches: Correspondences,
    camera: CameraModel,
    sigma_px: float,
    max_sigma_m: float,
) -> None:
    """Refuse a pose if one elsewhere fits nearly as well: points near a plane, seen small."""
    limit_px2 = MIN_CHI_SQUARE * sigma_px**2
    other = other_pose(trs_from_cam, matches, camera, max_excess_px2=limit_px2)
    if other is None:
        return
    apart_m = float(np.linalg.norm(other.translation - trs_from_cam.translation))
    if apart_m > max_sigma_m:
        raise NoPoseError(
            f"a pose {apart_m:.3g} m away fits nearly as well, the points tilted the other way:"
            f" {_look(matches, camera)}, noise {sigma_px:.2g} px"
        )


def _agreement(
    trs_from_cam: RigidTransform,
    matches: Correspondences,
    camera: CameraModel,
    *,
    tolerance_px: float,
) -> tuple[NDArray[np.bool_], float]:
    """Give which matches agree, and the share of wrong ones that would by chance.

    The chance comes from how dense the projections are in a ring around each image position: those
    within the tolerance are mostly the landmark itself, found in several reference views.
    """
    p_cam = points_in_cam(trs_from_cam, matches)
    in_front = p_cam[:, 2] > 0
    seen = matches.rays * camera.fx_px
    projected = p_cam[in_front, :2] / p_cam[in_front, 2:] * camera.fx_px
    agrees = np.zeros(len(matches), np.bool_)
    agrees[in_front] = np.linalg.norm(seen[in_front] - projected, axis=1) <= tolerance_px
    chance = tolerance_px**2 * np.pi / (camera.width_px * camera.height_px)
    if in_front.any():
        radii = [tolerance_px, _RING * tolerance_px]
        inside, outside = KDTree(seen).count_neighbors(KDTree(projected), radii)
        n_pairs = len(seen) * len(projected)
        chance = max(chance, float(outside - inside) / n_pairs / (_RING**2 - 1))
    return agrees, min(chance, 1.0)


def _n_needed(n: int, chance: float) -> int:
    """Give how many of ``n`` must agree for chance not to explain it; more than ``n``: never."""
    if n <= _SAMPLE:
        return n + 1
    n_poses = _POSES_OF_SAMPLE * n * (n - 1) * (n - 2) / 6
    n_more = np.arange(n - _SAMPLE + 1)
    n_false = n_poses * bdtrc(n_more - 1, n - _SAMPLE, chance)
    return _SAMPLE + int(np.count_nonzero(n_false >= MAX_FALSE_ALARMS))


def _look(matches: Correspondences, camera: CameraModel) -> str:
    """Say what keeps matches from holding a camera: number, a line, a small part of the image."""
    centred = matches.uv - matches.uv.mean(axis=0)
    axes = np.linalg.svd(centred, full_matrices=False)[2]
    long_px, short_px = np.ptp(centred @ axes.T, axis=0)
    what = f"{len(matches)} matches within {long_px:.0f} x {short_px:.0f} px"
    if long_px < _SMALL * max(camera.shape):
        return f"{what}, a small part of the image"
    if short_px < _LINE * long_px:
        return f"{what}, all on a line"
    return what
