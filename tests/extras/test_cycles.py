"""The renderer cycles, with a true Blender, against formulas and the reference renderer."""

import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Iterator

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import CAM_FROM_BLENDER_CAM, pose_along_boresight
from tronlab.render.cycles.process import blender_python
from tronlab.render.cycles.renderer import CyclesRenderer, open_cycles
from tronlab.render.reference import ReferenceRenderer
from tronlab.render.renderer import Lamp, RenderError, Rendering, SpotCone
from tronlab.render.settings import RenderSettings
from tronlab.terrain.heightmap import HeightMap

try:
    BLENDER = blender_python()
except RenderError as error:
    pytest.skip(str(error).splitlines()[0], allow_module_level=True)

PINHOLE = CameraModel(96, 80, 70.0, 72.0, 44.0, 42.0)
DISTORTED = CameraModel(96, 80, 70.0, 72.0, 44.0, 42.0, (-0.15, 0.05, 0.001, -0.0008))
ORIGIN_M = np.array([1.2, -0.7, 0.3])
SPACING_M = 0.01
LAMP = Lamp(np.array([0.2, -1.5, 1.6]), 3.0)
AT_POINTS = RenderSettings(prefilter=False)
NADIR = pose_along_boresight((1.7, -0.1, 1.3), boresight=(0, 0, -1), right=(0.1, 1, 0))
OBLIQUE = pose_along_boresight((0.9, -0.2, 0.9), boresight=(0.8, 0.1, -0.6), right=(0, 1, 0))


@pytest.fixture(scope="module")
def rough() -> HeightMap:
    """Steps, waves and noise on 1 x 1.2 m, with shadows at all scales."""
    i, j = np.ogrid[:101, :121]
    waves = 0.04 * np.sin(i * 0.21 + 0.1 * j) * np.cos(j * 0.17) + 0.05 * ((i // 20 + j // 30) % 2)
    height_m = waves + 0.004 * np.random.default_rng(3).random((101, 121))
    return HeightMap(height_m.astype(np.float32), SPACING_M, ORIGIN_M)


@pytest.fixture(scope="module")
def albedo(rough: HeightMap) -> np.ndarray:
    return np.random.default_rng(4).integers(2000, 65535, rough.height_m.shape, dtype=np.uint16)


@pytest.fixture(scope="module")
def cycles(rough: HeightMap, albedo: np.ndarray) -> Iterator[CyclesRenderer]:
    renderer = open_cycles(rough.painted(albedo))
    yield renderer
    renderer.close()


@pytest.fixture(scope="module")
def reference(rough: HeightMap, albedo: np.ndarray) -> ReferenceRenderer:
    return ReferenceRenderer(rough.painted(albedo))


def unlike(one: Rendering, other: Rendering) -> float:
    """Give the share of points that only one of two has lit."""
    both = np.isfinite(one.depth_m) & np.isfinite(other.depth_m)
    return float(np.mean(one.is_lit[both] != other.is_lit[both]))


def ratios(one: Rendering, other: Rendering) -> np.ndarray:
    lit = one.is_lit & other.is_lit
    assert lit.mean() > 0.2
    return one.radiance[lit] / other.radiance[lit]


@pytest.mark.parametrize("pose", [NADIR, OBLIQUE], ids=["nadir", "oblique"])
def test_pixel_by_pixel_as_the_reference(
    cycles: CyclesRenderer, reference: ReferenceRenderer, pose: RigidTransform
) -> None:
    axis = np.array([1.7, -0.1, 0.3]) - LAMP.p_trs_m
    cone = SpotCone(axis / np.linalg.norm(axis), 0.1, 0.35)
    lamp = Lamp(LAMP.p_trs_m, LAMP.intensity, cone=cone)
    settings = RenderSettings(prefilter=False, ambient=0.02, vignetting_power=4)
    ours = cycles.render(PINHOLE, pose, lamp, settings)
    expected = reference.render(PINHOLE, pose, lamp, settings)
    np.testing.assert_array_equal(np.isfinite(ours.depth_m), np.isfinite(expected.depth_m))
    error_m = np.abs(ours.depth_m - expected.depth_m)
    assert np.nanquantile(error_m, 0.999) < 5e-6
    assert np.nanquantile(np.abs(ours.points_trs_m - expected.points_trs_m), 0.999) < 5e-6
    assert unlike(ours, expected) < 0.015
    np.testing.assert_allclose(np.quantile(ratios(ours, expected), [0.01, 0.99]), 1, atol=1e-3)
    unlit = ~ours.is_lit & ~expected.is_lit
    np.testing.assert_allclose(ours.radiance[unlit], expected.radiance[unlit], atol=1e-5)


def test_a_plane_has_the_light_of_the_formula() -> None:
    slope = np.array([0.2, -0.1])
    i, j = np.ogrid[:101, :121]
    height_m = ((i * slope[0] + j * slope[1]) * SPACING_M).astype(np.float32)
    grey = np.full(height_m.shape, 13107, dtype=np.uint16)
    renderer = open_cycles(HeightMap(height_m, SPACING_M, ORIGIN_M).painted(grey))
    point, sphere = (
        renderer.render(PINHOLE, NADIR, Lamp(LAMP.p_trs_m, 3.0, radius_m), AT_POINTS)
        for radius_m in (0.0, 0.05)
    )
    renderer.close()
    to_lamp = LAMP.p_trs_m - point.points_trs_m.astype(np.float64)
    distance = np.linalg.norm(to_lamp, axis=-1)
    cos_incidence = to_lamp @ [*-slope, 1.0] / np.sqrt(1 + slope @ slope) / distance
    expected = np.nan_to_num(3.0 * 0.2 * cos_incidence / distance**2)
    np.testing.assert_allclose(point.radiance, expected, rtol=2e-5)
    # A sphere wholly above the horizon gives as much light as a point in its middle.
    inside = expected > 0
    assert np.median(sphere.radiance[inside] / expected[inside]) == pytest.approx(1, abs=1e-4)
    np.testing.assert_allclose(sphere.radiance[inside], expected[inside], rtol=5e-3)
    np.testing.assert_array_equal(point.is_lit, inside)
    np.testing.assert_array_equal(sphere.is_lit, inside)


def test_soft_shadows(cycles: CyclesRenderer, reference: ReferenceRenderer) -> None:
    lamp = Lamp(LAMP.p_trs_m, LAMP.intensity, radius_m=0.1)
    ours = cycles.render(PINHOLE, NADIR, lamp, AT_POINTS)
    expected = reference.render(PINHOLE, NADIR, lamp, AT_POINTS)
    assert np.median(ratios(ours, expected)) == pytest.approx(1, abs=0.005)
    assert unlike(ours, expected) < 0.015
    both = np.isfinite(ours.depth_m)
    error = np.abs(ours.radiance - expected.radiance)[both] / expected.radiance[both].mean()
    assert error.mean() < 0.01


def test_distortion_put_on_afterwards(cycles: CyclesRenderer, reference: ReferenceRenderer) -> None:
    ours = cycles.render(DISTORTED, NADIR, LAMP, AT_POINTS)
    expected = reference.render(DISTORTED, NADIR, LAMP, AT_POINTS)
    seen, expected_seen = np.isfinite(ours.depth_m), np.isfinite(expected.depth_m)
    assert np.mean(seen != expected_seen) < 0.005
    both = seen & expected_seen
    pixel_m = np.median(expected.depth_m[both]) / DISTORTED.fx_px
    error_px = np.abs(ours.depth_m - expected.depth_m)[both] / pixel_m
    assert np.median(error_px) < 0.01
    assert np.quantile(error_px, 0.9) < 0.2
    assert np.median(ratios(ours, expected)) == pytest.approx(1, abs=0.01)
    # Nothing is moved: half a pixel aside, images differ three times as much.
    aside = CameraModel(96, 80, 70.0, 72.0, 44.5, 42.0, DISTORTED.distortion)
    moved = reference.render(aside, NADIR, LAMP, AT_POINTS)
    error = np.abs(ours.radiance - expected.radiance)[both].mean()
    assert error < np.abs(moved.radiance - expected.radiance)[both].mean() / 3


def test_the_mean_of_what_a_pixel_covers(
    cycles: CyclesRenderer, reference: ReferenceRenderer
) -> None:
    far = pose_along_boresight((1.7, -0.1, 4.3), boresight=(0, 0, -1), right=(0, 1, 0))
    camera = CameraModel(24, 20, 70.0, 70.0, 11.5, 9.5)
    fine = reference.render(camera.scaled(24 * 8), far, LAMP, AT_POINTS)
    mean = fine.radiance.reshape(20, 8, 24, 8).mean(axis=(1, 3))
    filtered = cycles.render(camera, far, LAMP)
    at_points = cycles.render(camera, far, LAMP, AT_POINTS)
    error, error_at_points = (
        np.sqrt(np.mean((image.radiance - mean) ** 2)) for image in (filtered, at_points)
    )
    assert error < error_at_points / 3
    np.testing.assert_array_equal(filtered.depth_m, at_points.depth_m)
    smooth_edges = cycles.render(
        camera, far, LAMP, RenderSettings(prefilter=False, rays_per_pixel=4)
    )
    assert np.sqrt(np.mean((smooth_edges.radiance - mean) ** 2)) < error_at_points / 1.5


def test_the_underside_is_not_seen(cycles: CyclesRenderer, reference: ReferenceRenderer) -> None:
    camera = CameraModel(32, 24, 60, 60, 15.5, 11.5)
    settings = RenderSettings(ambient=1.0, rays_per_pixel=4)
    below = pose_along_boresight((1.7, -0.1, -1.0), boresight=(0, 0, 1), right=(1, 0, 0))
    unseen = cycles.render(camera, below, LAMP, settings)
    assert np.isnan(unseen.depth_m).all()
    assert np.isnan(unseen.points_trs_m).all()
    assert not unseen.radiance.any()
    assert not unseen.is_lit.any()
    # Through the side: most rays come in under the border, some above it.
    aside = pose_along_boresight((1.7, -2.5, 0.0), boresight=(0, 1, 0.15), right=(1, 0, 0))
    is_missed = np.isnan(cycles.render(camera, aside, LAMP, settings).depth_m)
    assert 0.5 < is_missed.mean() < 1
    expected = reference.render(camera, aside, LAMP, settings)
    np.testing.assert_array_equal(is_missed, np.isnan(expected.depth_m))


def test_one_blender_serves_a_batch_and_keeps_quiet(
    rough: HeightMap, capfd: pytest.CaptureFixture[str]
) -> None:
    said: list[str] = []
    renderer = open_cycles(rough.thinned(2), announce=said.append)
    batch = list(renderer.render_batch(PINHOLE, [NADIR, OBLIQUE], LAMP, AT_POINTS))
    alone = [renderer.render(PINHOLE, pose, LAMP, AT_POINTS) for pose in (NADIR, OBLIQUE)]
    renderer.close()
    for one, other in zip(batch, alone, strict=True):
        np.testing.assert_array_equal(one.radiance, other.radiance)
    assert not np.array_equal(batch[0].radiance, batch[1].radiance)
    assert said == ["starting Blender with 3,111 samples of terrain (0.4 GB)"]
    assert capfd.readouterr() == ("", "")
    expected = ReferenceRenderer(rough.thinned(2)).render(PINHOLE, NADIR, LAMP, AT_POINTS)
    np.testing.assert_allclose(batch[0].depth_m, expected.depth_m, atol=2e-5)


def test_blender_reads_the_quaternion_as_we_write_it() -> None:
    trs_from_blender_cam = OBLIQUE * CAM_FROM_BLENDER_CAM
    quat_wxyz = np.roll(trs_from_blender_cam.rotation.as_quat(), 1).tolist()
    program = f"""
        import bpy, json
        from mathutils import Matrix, Quaternion
        matrix = Matrix.LocRotScale(None, Quaternion({quat_wxyz}), None)
        print(json.dumps([list(row) for row in matrix]))
    """
    done = subprocess.run(
        [BLENDER, "-I", "-c", textwrap.dedent(program)], capture_output=True, text=True, check=True
    )
    matrix = np.array(json.loads(done.stdout.splitlines()[-1]))
    np.testing.assert_allclose(matrix[:3, :3], trs_from_blender_cam.rotation.as_matrix(), atol=1e-6)


@pytest.mark.parametrize("signal_", [signal.SIGKILL, signal.SIGINT])
def test_blender_ends_with_us_in_the_middle_of_an_image(tmp_path, signal_) -> None:
    program = f"""
        import signal, tempfile
        # A shell that starts tests in the background has them ignore Ctrl-C.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        tempfile.tempdir = {str(tmp_path)!r}
        import numpy as np
        from tronlab.geometry.camera import CameraModel
        from tronlab.geometry.poses import pose_along_boresight
        from tronlab.render.cycles import renderer as cycles
        from tronlab.render.renderer import Lamp
        from tronlab.terrain.heightmap import HeightMap
        cycles.SPHERE_SAMPLES = 1_000_000
        renderer = cycles.open_cycles(HeightMap(np.zeros((9, 9), np.float32), 0.1, np.zeros(3)))
        pose = pose_along_boresight([0.4, 0.4, 1], boresight=[0, 0, -1], right=[0, 1, 0])
        lamp = Lamp(np.array([0.0, 0.0, 2.0]), 1.0, radius_m=0.1)
        renderer._scene._running()
        print(renderer._scene._process._process.pid, flush=True)
        renderer.render(CameraModel(640, 640, 400, 400, 320, 320), pose, lamp)
    """
    with subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(program)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as parent:
        assert parent.stdout is not None
        blender = int(parent.stdout.readline())
        time.sleep(1.5)
        parent.send_signal(signal_)
    deadline = time.monotonic() + 30
    while os.path.exists(f"/proc/{blender}"):
        assert time.monotonic() < deadline, "Blender is still running"
        time.sleep(0.05)
    assert not list(tmp_path.glob("tronlab-blender-*"))
