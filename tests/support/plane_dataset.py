"""Shots along a line over a flat, textured terrain, which the built-in cores solve."""

from dataclasses import replace
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.dataset.records import ReferenceView
from tronlab.dataset.writer import DatasetWriter
from tronlab.geometry.camera import CameraModel

CAMERA = CameraModel(240, 224, 190.0, 190.0, 119.5, 111.5)
LOOKING_DOWN = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
SIDE_M = 3.0
N_SHOTS = 12


def write_plane_dataset(path: Path) -> None:
    """Write the shots, and two reference views."""
    fakes = _fakes()
    rng = np.random.default_rng(5)
    noise = cv2.GaussianBlur(rng.normal(size=(700, 700)).astype(np.float32), (0, 0), 3)
    texture = np.clip(120 + 40 * noise / noise.std(), 0, 255).astype(np.uint8)
    everything = np.ones(CAMERA.shape, np.bool_)

    def view(i: int, trs_from_cam: RigidTransform) -> ReferenceView:
        depth = _depth_m(trs_from_cam).astype(np.float32)
        return ReferenceView(i, trs_from_cam, _seen(texture, trs_from_cam), depth, everything)

    with DatasetWriter(path, replace(fakes.fake_provenance(N_SHOTS), camera=CAMERA)) as writer:
        writer.add_references([view(i, _pose(at)) for i, at in enumerate((2.0, 8.0))])
        for i in range(N_SHOTS):
            shot = fakes.fake_shot(i, trs_from_cam=_pose(i))
            truth = replace(shot.truth, range_los_m=1.9 - 0.03 * i, usable_fraction=1.0)
            frame = replace(shot.frame, image=_seen(texture, _pose(i)))
            writer.commit(replace(shot, frame=frame, mask=everything, truth=truth))
        writer.finish("complete")


def _pose(i: float) -> RigidTransform:
    tilt = Rotation.from_rotvec([0.01, -0.02, 0.04 * i])
    return RigidTransform.from_components([0.02, 0.01 * i, 1.9 - 0.03 * i], tilt * LOOKING_DOWN)


def _seen(texture: np.ndarray, trs_from_cam: RigidTransform) -> np.ndarray:
    """Give the grey values of a textured square around the origin of trs, in its plane z = 0."""
    texels_per_m = len(texture) / SIDE_M
    r, t = trs_from_cam.rotation.as_matrix().T, trs_from_cam.inv().translation
    k = [[CAMERA.fx_px, 0, CAMERA.cx_px], [0, CAMERA.fy_px, CAMERA.cy_px], [0, 0, 1]]
    uv_from_plane = k @ np.column_stack([r[:, 0], r[:, 1], t])
    plane_from_texel = np.array(
        [[1 / texels_per_m, 0, -SIDE_M / 2], [0, 1 / texels_per_m, -SIDE_M / 2], [0, 0, 1]]
    )
    size = (CAMERA.width_px, CAMERA.height_px)
    return cv2.warpPerspective(texture, uv_from_plane @ plane_from_texel, size)


def _depth_m(trs_from_cam: RigidTransform) -> np.ndarray:
    towards = trs_from_cam.rotation.as_matrix()[2]
    rays = np.concatenate([CAMERA.ray_table(), np.ones((*CAMERA.shape, 1))], axis=-1)
    return -trs_from_cam.translation[2] / (rays @ towards)


def _fakes() -> Any:
    """Give the module that makes shots: pytest has it under a name nobody can import."""
    spec = spec_from_file_location("fakes", Path(__file__).parents[1] / "conftest.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
