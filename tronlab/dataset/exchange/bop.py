"""Export in the format of the BOP benchmark for 6D object pose estimation.

Source of the format: BOP toolkit, docs/bop_datasets_format.md (scene-wise).
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tronlab.dataset.exchange.images import write_mask, write_png
from tronlab.dataset.exchange.rectification import Rectification
from tronlab.dataset.exchange.shots import ExportShot, OnShot, json_rows, shots_of
from tronlab.dataset.reader import Dataset
from tronlab.geometry.camera import CameraModel

_SCENE_ID = 1
_OBJ_ID = 1
_MM_PER_M = 1000.0
_IMAGE_FOLDERS = ("gray", "mask", "mask_visib")
_NO_BOX = [-1, -1, -1, -1]


class BopExporter:
    """Writes one scene of one object, the terrain model; image ids are shot ids."""

    conventions = """\
Format: BOP, scene-wise (bop_toolkit/docs/bop_datasets_format.md). One scene, one object: the
terrain model (obj_id 1). Image ids are shot ids.
- cam_R_m2c, cam_t_m2c and the same values as cam_R_w2c, cam_t_w2c: from the model frame to the
  camera frame; matrices row by row, lengths in MILLIMETRES. Camera: x right, y down, z forward.
- The model frame is F_TRS: its origin is the top-left mark of the model and not, as BOP has it,
  the centre of the bounding box; z points out of the model.
- cam_K: pixel (0, 0) is the centre of the top-left pixel, as in OpenCV.
- BOP knows no lens distortion. If the camera has some, images and masks were resampled (bilinear,
  nearest) to what a pinhole with cam_K sees; where the camera saw nothing they are 0.
- gray: grey values unscaled; Mono12 is 0 to 4095 in 16-bit PNG.
- mask and mask_visib: the flat outline of the model within the image. px_count_all, visib_fract
  and bbox_obj know nothing of what lies beside the image.
- There are no depth images (px_count_valid is 0, depth_scale has no meaning) and no mesh in models.
"""

    def write(self, dataset: Dataset, folder: Path, on_shot: OnShot) -> dict[int, str]:
        """Write images, masks, cameras and poses."""
        scene = folder / "test" / f"{_SCENE_ID:06d}"
        for name in _IMAGE_FOLDERS:
            (scene / name).mkdir(parents=True)
        rectification = Rectification(dataset.camera)
        with (
            json_rows(scene / "scene_camera.json") as write_camera,
            json_rows(scene / "scene_gt.json") as write_pose,
            json_rows(scene / "scene_gt_info.json") as write_info,
        ):
            for shot in shots_of(dataset, on_shot):
                mask = rectification.mask(shot.mask)
                write_png(scene / "gray" / _name(shot.shot_id), rectification.image(shot.image))
                for name in ("mask", "mask_visib"):
                    write_mask(scene / name / f"{shot.shot_id:06d}_{0:06d}.png", mask)
                write_camera(shot.shot_id, _camera_of_image(dataset.camera, shot))
                write_pose(shot.shot_id, [{"obj_id": _OBJ_ID, **_pose(shot, "m2c")}])
                write_info(shot.shot_id, [_info(mask)])
        shot_ids = dataset.shot_ids.tolist()
        _write_targets(folder, shot_ids)
        _write_camera(folder, dataset.camera)
        images = (scene / "gray").relative_to(folder).as_posix()
        return {shot_id: f"{images}/{_name(shot_id)}" for shot_id in shot_ids}


def _name(shot_id: int) -> str:
    return f"{shot_id:06d}.png"


def _camera_of_image(camera: CameraModel, shot: ExportShot) -> dict[str, Any]:
    return {"cam_K": camera.matrix.ravel().tolist(), "depth_scale": 1.0, **_pose(shot, "w2c")}


def _pose(shot: ExportShot, frames: str) -> dict[str, Any]:
    cam_from_trs = shot.cam_from_trs
    return {
        f"cam_R_{frames}": cam_from_trs.rotation.as_matrix().ravel().tolist(),
        f"cam_t_{frames}": (cam_from_trs.translation * _MM_PER_M).tolist(),
    }


def _info(mask: NDArray[np.bool_]) -> dict[str, Any]:
    n_seen = int(mask.sum())
    box = _box(mask) if n_seen else _NO_BOX
    return {
        "px_count_all": n_seen,
        "px_count_valid": 0,
        "px_count_visib": n_seen,
        "visib_fract": 1.0 if n_seen else 0.0,
        "bbox_obj": box,
        "bbox_visib": box,
    }


def _box(mask: NDArray[np.bool_]) -> list[int]:
    """Give x, y, width and height as the BOP toolkit computes them: last minus first pixel."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    x, y = int(columns[0]), int(rows[0])
    return [x, y, int(columns[-1]) - x, int(rows[-1]) - y]


def _write_targets(folder: Path, shot_ids: list[int]) -> None:
    targets = [
        {"im_id": shot_id, "inst_count": 1, "obj_id": _OBJ_ID, "scene_id": _SCENE_ID}
        for shot_id in shot_ids
    ]
    (folder / "test_targets_bop19.json").write_text(json.dumps(targets, indent=1), "utf-8")


def _write_camera(folder: Path, camera: CameraModel) -> None:
    values = {
        "width": camera.width_px,
        "height": camera.height_px,
        "fx": camera.fx_px,
        "fy": camera.fy_px,
        "cx": camera.cx_px,
        "cy": camera.cy_px,
        "depth_scale": 1.0,
    }
    (folder / "camera.json").write_text(json.dumps(values, indent=1), "utf-8")
