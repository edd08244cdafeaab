# pyright: basic
# ruff: noqa: PLR0917 - kernels work on plain numbers
"""Compiled: each landmark is compared with the features near the place where it should be seen."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tronlab.nav.matching.hamming_kernel import are_apart, n_different
from tronlab.terrain.kernels import inlined, kernel


class Prediction(NamedTuple):
    """A camera whose pose is known so well."""

    cam_from_trs: NDArray[np.float64]
    """Rotation, shape (3, 3)."""
    eye_trs_m: NDArray[np.float64]
    covariance: NDArray[np.float64]
    """See ``geometry.uncertainty``, shape (6, 6)."""
    is_uncertain: bool
    """False if the covariance is zero."""
    focal_px: NDArray[np.float64]
    """Along u and v."""
    centre_px: NDArray[np.float64]
    distortion: NDArray[np.float64]
    """The eight coefficients of ``geometry.camera``."""
    nearest_ray: NDArray[np.float64]
    """Least (x, y) of a ray that may still be in the image."""
    farthest_ray: NDArray[np.float64]
    noise_px: float
    """Standard deviation of where a landmark is seen, were the pose known exactly."""
    gate: float
    """Largest distance in standard deviations."""
    size_factor: float
    """A feature may be so many times larger or smaller than the landmark should look."""


class FeatureGrid(NamedTuple):
    """Features sorted into square cells of the image, row by row."""

    uv: NDArray[np.float64]
    """Shape (n, 2)."""
    size_px: NDArray[np.float64]
    size_range_px: NDArray[np.float64]
    """Smallest and largest."""
    feature: NDArray[np.int32]
    """Which feature is at each place of the order."""
    cell_px: float
    starts: NDArray[np.int32]
    """Where each cell begins, shape (rows, columns + 1)."""


@kernel
def search_near(prediction, landmarks, places, is_used, features, grid, found):
    """Find, for each feature, the nearest of the landmarks that should be seen where it is.

    Args:
        prediction: ``Prediction``.
        landmarks: ``Words``.
        places: Their ``Places``.
        is_used: Which views count, shape (views,).
        features: ``Words``.
        grid: ``FeatureGrid``.
        found: ``Nearest``, filled in.
    """
    smallest = grid.size_range_px[0] / prediction.size_factor
    largest = grid.size_range_px[1] * prediction.size_factor
    for i in range(len(places.size_m)):
        if not is_used[places.seen_from[i]]:
            continue
        arm = _arm(prediction, places.p_trs_m, i)
        depth = _depth(prediction, arm)
        # Most landmarks look too small or too large for any feature: that is cheap to see.
        length = places.size_m[i] * prediction.focal_px[0]
        if smallest * depth <= length <= largest * depth:
            x, y = _ray(prediction, arm, depth)
            if _is_near_image(prediction, x, y):
                xd, yd, slopes = _distorted(prediction.distortion, x, y)
                u = xd * prediction.focal_px[0] + prediction.centre_px[0]
                v = yd * prediction.focal_px[1] + prediction.centre_px[1]
                spread = _spread(prediction, arm, (x, y, depth), slopes)
                ellipse = (u, v, prediction.gate, spread)
                size_px = length / depth
                sizes = (size_px / prediction.size_factor, size_px * prediction.size_factor)
                _compare(landmarks, places, features, grid, i, ellipse, sizes, found)


@inlined
def _arm(prediction, p_trs_m, i):
    """Give the way from the eye to landmark i, in trs."""
    eye = prediction.eye_trs_m
    return p_trs_m[i, 0] - eye[0], p_trs_m[i, 1] - eye[1], p_trs_m[i, 2] - eye[2]


@inlined
def _depth(prediction, arm):
    m = prediction.cam_from_trs
    return m[2, 0] * arm[0] + m[2, 1] * arm[1] + m[2, 2] * arm[2]


@inlined
def _ray(prediction, arm, depth):
    m = prediction.cam_from_trs
    x = (m[0, 0] * arm[0] + m[0, 1] * arm[1] + m[0, 2] * arm[2]) / depth
    y = (m[1, 0] * arm[0] + m[1, 1] * arm[1] + m[1, 2] * arm[2]) / depth
    return x, y


@inlined
def _is_near_image(prediction, x, y):
    low, high = prediction.nearest_ray, prediction.farthest_ray
    return low[0] <= x <= high[0] and low[1] <= y <= high[1]


@inlined
def _distorted(k, x, y):
    """Give the distorted ray, and its derivatives xx, xy, yy; see ``geometry.camera``."""
    r2 = x * x + y * y
    above = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    below = 1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
    radial = above / below
    by_above = k[0] + r2 * (2.0 * k[1] + 3.0 * r2 * k[4])
    slope = 2.0 * (by_above - radial * (k[5] + r2 * (2.0 * k[6] + 3.0 * r2 * k[7]))) / below
    p1, p2 = k[2], k[3]
    slopes = (
        radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x,
        slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y,
        radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x,
    )
    xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    return xd, yd, slopes


@inlined
def _spread(prediction, arm, seen, slopes):
    """Give the covariances uu, uv, vv of the place a landmark is seen at, square pixels."""
    noise = prediction.noise_px**2
    if not prediction.is_uncertain:
        return noise, 0.0, noise
    fu, fv = prediction.focal_px
    by_u = _by_pose(prediction, arm, seen, fu * slopes[0], fu * slopes[1])
    by_v = _by_pose(prediction, arm, seen, fv * slopes[1], fv * slopes[2])
    c = prediction.covariance
    uu, uv, vv = noise, 0.0, noise
    for a in range(6):
        for b in range(6):
            uu += by_u[a] * c[a, b] * by_u[b]
            uv += by_u[a] * c[a, b] * by_v[b]
            vv += by_v[a] * c[a, b] * by_v[b]
    return uu, uv, vv


@inlined
def _by_pose(prediction, arm, seen, by_x, by_y):
    """Give the derivative by (rotation, translation) of what changes so with the ray (x, y)."""
    m = prediction.cam_from_trs
    x, y, depth = seen
    gx = (by_x * (m[0, 0] - x * m[2, 0]) + by_y * (m[1, 0] - y * m[2, 0])) / depth
    gy = (by_x * (m[0, 1] - x * m[2, 1]) + by_y * (m[1, 1] - y * m[2, 1])) / depth
    gz = (by_x * (m[0, 2] - x * m[2, 2]) + by_y * (m[1, 2] - y * m[2, 2])) / depth
    ax, ay, az = arm
    # To a camera turned by w, the landmark looks as if it had moved by arm x w.
    return gy * az - gz * ay, gz * ax - gx * az, gx * ay - gy * ax, -gx, -gy, -gz


@inlined
def _compare(landmarks, places, features, grid, i, ellipse, sizes, found):
    """Compare landmark i with the features of such sizes in the ellipse."""
    n_rows, n_columns = grid.starts.shape[0], grid.starts.shape[1] - 1
    u, v, gate, (uu, uv, vv) = ellipse
    half_u, half_v = gate * np.sqrt(uu), gate * np.sqrt(vv)
    left = max(int((u - half_u) / grid.cell_px), 0)
    right = min(int((u + half_u) / grid.cell_px), n_columns - 1)
    top = max(int((v - half_v) / grid.cell_px), 0)
    bottom = min(int((v + half_v) / grid.cell_px), n_rows - 1)
    limit = gate**2 * (uu * vv - uv * uv)
    if left > right:
        return
    for row in range(top, bottom + 1):
        for at in range(grid.starts[row, left], grid.starts[row, right + 1]):
            du, dv = grid.uv[at, 0] - u, grid.uv[at, 1] - v
            if du * du * vv - 2.0 * du * dv * uv + dv * dv * uu > limit:
                continue
            if sizes[0] <= grid.size_px[at] <= sizes[1]:
                j = grid.feature[at]
                _take(places, i, float(n_different(landmarks, i, features, j)), j, found)


@inlined
def _take(places, i, d, j, found):
    """Let landmark i at distance d be the nearest of feature j, or its rival."""
    if d < found.distance[j]:
        if found.landmark[j] >= 0 and are_apart(places, i, found.landmark[j]):
            found.rival[j] = found.distance[j]  # nothing seen so far is nearer to the feature
        found.landmark[j], found.distance[j] = i, d
    elif d < found.rival[j] and are_apart(places, found.landmark[j], i):
        found.rival[j] = d
