"""Export in COLMAP's text format.

Source of the format: COLMAP's documentation, pages *Output Format*, *Camera Models*, *Database*.
"""

from pathlib import Path

from tronlab.dataset.exchange.images import write_mask, write_png
from tronlab.dataset.exchange.shots import ExportShot, OnShot, numbers, quat_wxyz, shots_of
from tronlab.dataset.reader import Dataset
from tronlab.geometry.camera import CameraModel

_CAMERA_ID = 1
_CORNER_PX = 0.5
"""COLMAP's pixel coordinates begin at the corner of the top-left pixel, ours at its centre."""
_N_OPENCV = 4
"""Coefficients k1, k2, p1, p2 of the model OPENCV; FULL_OPENCV has all eight."""


class ColmapExporter:
    """Writes a sparse model with known poses and no points."""

    conventions = """\
Format: COLMAP, text. sparse/0 has cameras.txt, images.txt and an empty points3D.txt; masks are in
masks/NAME.png, as the feature extractor expects them (0: ignore).
- images.txt: the pose takes points from the world to the camera frame (x right, y down, z forward);
  quaternion scalar FIRST (w x y z, Hamilton), metres. The world is F_TRS, the frame of the terrain
  model. IMAGE_ID counts from 1 in row order; NAME has the shot id.
- cameras.txt: PINHOLE, OPENCV (k1 k2 p1 p2) or FULL_OPENCV (k1 k2 p1 p2 k3 k4 k5 k6), whichever is
  enough. COLMAP's pixel (0.5, 0.5) is the centre of the top-left pixel: the principal point is half
  a pixel more than in tronlab.
- Images are distorted, grey values unscaled; Mono12 is 0 to 4095 in 16-bit PNG, which COLMAP reads
  as a very dark image: scale such images for feature extraction.
"""

    def write(self, dataset: Dataset, folder: Path, on_shot: OnShot) -> dict[int, str]:
        """Write images, masks and the model."""
        for name in ("images", "masks", "sparse/0"):
            (folder / name).mkdir(parents=True)
        model = folder / "sparse/0"
        names: dict[int, str] = {}
        lines: list[str] = []
        for image_id, shot in enumerate(shots_of(dataset, on_shot), start=1):
            name = names[shot.shot_id] = f"{shot.shot_id:06d}.png"
            write_png(folder / "images" / name, shot.image)
            write_mask(folder / "masks" / f"{name}.png", shot.mask)
            # The second line of an image lists its points: there are none.
            lines.append(f"{image_id} {_pose(shot)} {_CAMERA_ID} {name}\n\n")
        _write(
            model / "cameras.txt",
            "CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]",
            [_camera(dataset.camera)],
        )
        header = "IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n# POINTS2D[]"
        _write(model / "images.txt", header, lines)
        _write(model / "points3D.txt", "POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[]", [])
        return {shot_id: f"images/{name}" for shot_id, name in names.items()}


def _pose(shot: ExportShot) -> str:
    cam_from_trs = shot.cam_from_trs
    return numbers([*quat_wxyz(cam_from_trs), *cam_from_trs.translation])


def _camera(camera: CameraModel) -> str:
    name, coefficients = _model(camera)
    values = [
        camera.fx_px,
        camera.fy_px,
        camera.cx_px + _CORNER_PX,
        camera.cy_px + _CORNER_PX,
        *coefficients,
    ]
    return f"{_CAMERA_ID} {name} {camera.width_px} {camera.height_px} {numbers(values)}\n"


def _model(camera: CameraModel) -> tuple[str, tuple[float, ...]]:
    if not any(camera.distortion):
        return "PINHOLE", ()
    if not any(camera.distortion[_N_OPENCV:]):
        return "OPENCV", camera.distortion[:_N_OPENCV]
    return "FULL_OPENCV", camera.distortion


def _write(path: Path, header: str, lines: list[str]) -> None:
    path.write_text(f"# {header}\n" + "".join(lines), "utf-8")
