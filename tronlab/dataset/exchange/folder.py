"""Export as a folder of PNG images and a CSV table: the layout that import reads too."""

import csv
import json
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.dataset import schema
from tronlab.dataset.exchange.images import write_mask, write_png
from tronlab.dataset.exchange.shots import ExportShot, OnShot, shots_of
from tronlab.dataset.reader import Dataset
from tronlab.dataset.records import ReferenceView
from tronlab.geometry.poses import FloatArray, xyz_quat_from_pose

SHOTS_CSV: Final = "shots.csv"
CAMERA_JSON: Final = "camera.json"
REFERENCES_CSV: Final = "references.csv"
POSE_COLUMNS: Final = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
NOMINAL_COLUMNS: Final = tuple(f"nominal_{name}" for name in POSE_COLUMNS)
UPPER_TRIANGLE: Final = tuple((i, j) for i in range(6) for j in range(i, 6))
COVARIANCE_COLUMNS: Final = tuple(f"cov_{i}{j}" for i, j in UPPER_TRIANGLE)
"""Of (rotation vector, translation) in trs, rad and m: rows and columns 0 to 5."""
FRAME_COLUMNS: Final = ("time_s", "exposure_s", "gain_db")
SHOT_COLUMNS: Final = (
    "shot_id",
    "image",
    "mask",
    *POSE_COLUMNS,
    "range_los_m",
    *FRAME_COLUMNS,
    "pixel_format",
    *NOMINAL_COLUMNS,
    *COVARIANCE_COLUMNS,
    "usable_fraction",
    "truth_state",
    "flags",
)
REFERENCE_COLUMNS: Final = ("view_id", "image", "mask", "depth", *POSE_COLUMNS)


class FolderExporter:
    """Writes images, masks and reference views, and a table of all values that scoring needs."""

    conventions = """\
Format: tronlab's folder of PNG and CSV; tronlab dataset import reads it again.
- shots.csv has a row for each shot. x_m .. qw is the pose of the camera in F_TRS, the frame of the
  terrain model: it takes points from the camera frame (x right, y down, z forward) to F_TRS;
  metres, quaternion scalar LAST. nominal_x_m .. nominal_qw is where the plan wanted it.
- cov_ij is the covariance of (rotation vector, translation) in F_TRS, i and j from 0 to 5, rad and
  m, upper triangle. range_los_m is the distance to the terrain along the optical axis.
- An empty cell means that the value is not known.
- images: grey values unscaled; Mono12 is 0 to 4095 in 16-bit PNG. masks: 255 where the flat outline
  of the model is seen, else 0.
- camera.json: pixel (0, 0) is the centre of the top-left pixel; distortion k1 k2 p1 p2 k3 k4 k5 k6
  as in OpenCV. Images are distorted.
- references.csv and references: the rendered views that navigation databases are made from; depth
  is along the optical axis, metres, float32 in NumPy's .npy, NaN where no terrain is seen.
"""

    def write(self, dataset: Dataset, folder: Path, on_shot: OnShot) -> dict[int, str]:
        """Write images, masks, tables and camera."""
        for name in ("images", "masks"):
            (folder / name).mkdir()
        images: dict[int, str] = {}
        frames = {name: dataset.rows(f"{schema.CAMERA}/{name}") for name in FRAME_COLUMNS}
        nominal = dataset.rows("entry/shots/trs_from_cam_nominal")
        with (folder / SHOTS_CSV).open("w", encoding="utf-8", newline="") as file:
            table: csv.DictWriter[str] = csv.DictWriter(file, SHOT_COLUMNS)
            table.writeheader()
            for shot in shots_of(dataset, on_shot):
                name = f"{shot.shot_id:06d}.png"
                image = images[shot.shot_id] = f"images/{name}"
                write_png(folder / image, shot.image)
                write_mask(folder / "masks" / name, shot.mask)
                row = {
                    "shot_id": shot.shot_id,
                    "image": image,
                    "mask": f"masks/{name}",
                    **_truth_cells(shot),
                    **{key: _cell(values[shot.i]) for key, values in frames.items()},
                    "pixel_format": dataset.pixel_format(shot.i),
                    **_cells(NOMINAL_COLUMNS, nominal[shot.i]),
                    "truth_state": dataset.truth_states[shot.i],
                    "flags": flags_of(dataset, shot.i),
                }
                table.writerow(row)
        camera = json.dumps(dataset.camera.to_dict(), indent=1)
        (folder / CAMERA_JSON).write_text(camera, "utf-8")
        _write_references(folder, dataset)
        return images


def flags_of(dataset: Dataset, i: int) -> str:
    """Give what the quality gate held against the shot of row ``i``, with blanks between."""
    quality = dataset.quality(i)
    return "" if quality is None else " ".join(quality.flags)


def _truth_cells(shot: ExportShot) -> dict[str, str]:
    truth = shot.truth
    return {
        **_pose_cells(truth.trs_from_cam),
        **_cells(COVARIANCE_COLUMNS, np.array([truth.covariance[ij] for ij in UPPER_TRIANGLE])),
        "range_los_m": _cell(truth.range_los_m),
        "usable_fraction": _cell(truth.usable_fraction),
    }


def _write_references(folder: Path, dataset: Dataset) -> None:
    if not dataset.n_references:
        return
    (folder / "references").mkdir()
    with (folder / REFERENCES_CSV).open("w", encoding="utf-8", newline="") as file:
        table: csv.DictWriter[str] = csv.DictWriter(file, REFERENCE_COLUMNS)
        table.writeheader()
        for i in range(dataset.n_references):
            view = dataset.reference(i)
            table.writerow(_write_reference(folder, view))


def _write_reference(folder: Path, view: ReferenceView) -> dict[str, Any]:
    stem = f"references/{view.view_id:06d}"
    names = {"image": f"{stem}.png", "mask": f"{stem}_mask.png", "depth": f"{stem}_depth.npy"}
    write_png(folder / names["image"], view.image)
    write_mask(folder / names["mask"], view.mask)
    np.save(folder / names["depth"], view.depth_m)
    return {"view_id": view.view_id, **names, **_pose_cells(view.trs_from_cam)}


def _pose_cells(pose: RigidTransform) -> dict[str, str]:
    return _cells(POSE_COLUMNS, xyz_quat_from_pose(pose))


def _cells(names: tuple[str, ...], values: FloatArray) -> dict[str, str]:
    return {name: _cell(value) for name, value in zip(names, values, strict=True)}


def _cell(value: float) -> str:
    """Write a number so that it reads back as it was; nothing if it is not known."""
    return "" if np.isnan(value) else repr(float(value))
