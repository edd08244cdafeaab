"""The reference renderer's depth and shadows against Embree on the same triangles."""

import numpy as np
import pytest

from tronlab.geometry.poses import pose_along_boresight
from tronlab.render.rays import centre_rays
from tronlab.render.reference import ReferenceRenderer
from tronlab.render.renderer import Lamp

pytest.importorskip("embreex", reason="embreex is built for x86-64 only")

SAME_PLACE_M = 5e-5
POSES = {  # position, boresight, right
    "nadir": ((0.2, 0.27, 0.5), (0, 0, -1), (0, 1, 0)),
    "oblique": ((-0.3, 0.3, 0.25), (0.8, 0.02, -0.45), (0, 1, 0)),
    "corner": ((0.5, -0.2, 0.1), (-0.7, 0.7, -0.2), (1, 1, 0)),
    "grazing, in a crater's air": ((0.2, 0.27, 0.045), (0.1, 1, -0.03), (1, 0, 0)),
    "from below the border": ((0.2, -0.2, -0.01), (0, 1, 0.02), (1, 0, 0)),
}
LAMPS = {"high": (-0.5, -0.3, 0.6), "low": (-0.6, 0.1, 0.12), "over the middle": (0.2, 0.3, 0.2)}


class EmbreeTerrain:
    """The triangles of a height map, each cell split from node (i, j) to (i + 1, j + 1)."""

    def __init__(self, heightmap):
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        rows, columns = heightmap.height_m.shape
        x, y = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
        step = heightmap.spacing_m
        vertices = np.stack([x * step, y * step, heightmap.height_m], axis=-1).reshape(-1, 3)
        node = np.arange(rows * columns).reshape(rows, columns)
        a, b, c, d = node[:-1, :-1], node[:-1, 1:], node[1:, 1:], node[1:, :-1]
        faces = np.stack([np.stack([a, c, b], -1), np.stack([a, d, c], -1)], axis=-2)
        self._origin = heightmap.origin_trs_m
        self._scene = EmbreeScene()
        self._mesh = TriangleMesh(
            self._scene, vertices.astype(np.float32), faces.reshape(-1, 3).astype(np.int32)
        )

    def first_hit(self, p_trs_m, directions):
        """Give t (NaN: no hit on an upper side), shape (n,), and upward unit normals, (n, 3)."""
        hits = self._scene.run(*self._rays(p_trs_m, directions), query="INTERSECT", output=True)
        is_hit = hits["primID"] >= 0
        normals = np.where(is_hit[:, None], hits["Ng"], 1.0).astype(np.float64)
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        is_upper = is_hit & (np.sum(normals * directions, axis=1) < 0)
        return np.where(is_upper, hits["tfar"], np.nan).astype(np.float64), normals

    def is_blocked(self, p_trs_m, p_lamp_trs_m):
        """Seen from the lamp: with its 32 bits Embree cannot look from just above a place."""
        hits = self._scene.run(
            *self._rays(p_lamp_trs_m, p_trs_m - p_lamp_trs_m), query="INTERSECT", output=True
        )
        short_m = (1 - hits["tfar"]) * np.linalg.norm(p_trs_m - p_lamp_trs_m, axis=1)
        return (hits["primID"] >= 0) & (short_m > SAME_PLACE_M)

    def _rays(self, starts, directions):
        starts = np.broadcast_to(starts - self._origin, np.shape(directions))
        return starts.astype(np.float32), np.asarray(directions).astype(np.float32)


def smooth_normals(heightmap, p_trs_m):
    """Give upward unit normals from numpy's gradient, interpolated between nodes by scipy."""
    from scipy.ndimage import map_coordinates

    place = (p_trs_m[:, :2] - heightmap.origin_trs_m[:2]).T / heightmap.spacing_m
    slopes = np.gradient(heightmap.height_m.astype(np.float64), heightmap.spacing_m)
    slope_x, slope_y = (map_coordinates(slope, place, order=1, mode="nearest") for slope in slopes)
    normals = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], axis=-1)
    return normals / np.linalg.norm(normals, axis=1)[:, None]


@pytest.fixture(scope="module")
def embree(heightmap):
    return EmbreeTerrain(heightmap)


@pytest.fixture(scope="module")
def renderer(heightmap):
    return ReferenceRenderer(heightmap)


def directions_trs(camera, trs_from_cam):
    rays = centre_rays(camera).reshape(-1, 2)
    return np.c_[rays, np.ones(len(rays))] @ trs_from_cam.rotation.as_matrix().T


@pytest.mark.parametrize("pose", POSES.values(), ids=POSES)
def test_depth_is_embrees(renderer, embree, camera, pose):
    position_m, boresight, right = pose
    trs_from_cam = pose_along_boresight(position_m, boresight=boresight, right=right)
    lamp = Lamp(np.array(LAMPS["high"]), 1.0)
    depth = renderer.render(camera, trs_from_cam, lamp).depth_m.ravel()
    expected, _ = embree.first_hit(trs_from_cam.translation, directions_trs(camera, trs_from_cam))
    assert np.isfinite(expected).mean() > 0.02
    assert np.mean(np.isfinite(depth) != np.isfinite(expected)) < 1e-4
    difference = np.abs(depth - expected)
    assert np.nanpercentile(difference, 99.9) < 10e-6
    assert np.nanmax(difference) < 1e-3


@pytest.mark.parametrize("p_lamp_trs_m", LAMPS.values(), ids=LAMPS)
@pytest.mark.parametrize("pose", list(POSES.values())[:4], ids=list(POSES)[:4])
def test_shadows_are_embrees(renderer, embree, camera, heightmap, pose, p_lamp_trs_m):
    position_m, boresight, right = pose
    trs_from_cam = pose_along_boresight(position_m, boresight=boresight, right=right)
    lamp = Lamp(np.array(p_lamp_trs_m), 1.0)
    rendering = renderer.render(camera, trs_from_cam, lamp)
    directions = directions_trs(camera, trs_from_cam)
    depth, normals = embree.first_hit(trs_from_cam.translation, directions)
    seen = np.isfinite(depth) & np.isfinite(rendering.depth_m.ravel())
    points = trs_from_cam.translation + depth[seen, None] * directions[seen]
    to_lamp = lamp.p_trs_m - points
    expected = (
        ~embree.is_blocked(points, lamp.p_trs_m)
        & (np.sum(normals[seen] * to_lamp, axis=1) > 0)
        & (np.sum(smooth_normals(heightmap, points) * to_lamp, axis=1) > 0)
    )
    assert expected.mean() > 0.1
    n_different = np.count_nonzero(rendering.is_lit.ravel()[seen] != expected)
    # Less than 0.01 % of the pixels, of which these small images have up to 96000.
    assert n_different <= 1e-4 * camera.width_px * camera.height_px


def test_any_ray_from_anywhere_is_embrees(renderer, embree, heightmap):
    rng = np.random.default_rng(5)
    middle = heightmap.origin_trs_m + np.array([0.22, 0.3, 0.06])
    starts = middle + rng.normal(size=(400, 3)) * [0.1, 0.15, 0.02]
    directions = rng.normal(size=(400, 3)) * [1, 1, 0.3]
    directions[:40, 0] = 0.0
    directions[40:80, 1] = 0.0
    directions[80:120, 2] = 0.0
    directions[120:160, :2] = 0.0
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    expected = np.array(
        [embree.first_hit(p, d[None])[0][0] for p, d in zip(starts, directions, strict=True)]
    )
    found = np.array(
        [renderer.range_along_m(p, d) for p, d in zip(starts, directions, strict=True)]
    )
    assert 50 < np.isfinite(expected).sum() < 350
    np.testing.assert_array_equal(np.isfinite(found), np.isfinite(expected))
    assert np.nanmax(np.abs(found - expected)) < 5e-6
