"""Export in the format of the TUM RGB-D benchmark, which evo reads as ``tum``.

Source of the format: Sturm et al., IROS 2012, and the benchmark's page on file formats.
"""

import json
from pathlib import Path

from tronlab.dataset import schema
from tronlab.dataset.exchange.images import write_png
from tronlab.dataset.exchange.shots import ExportShot, OnShot, numbers, shots_of
from tronlab.dataset.reader import Dataset
from tronlab.errors import DatasetError
from tronlab.geometry.poses import xyz_quat_from_pose


class TumExporter:
    """Writes the list of images and the trajectory, both by the time of exposure."""

    conventions = """\
Format: TUM RGB-D benchmark. rgb.txt lists 'timestamp filename', groundtruth.txt lists
'timestamp tx ty tz qx qy qz qw', in the order of time.
- The pose is that of the camera in the world: it takes points from the camera frame (x right, y
  down, z forward) to F_TRS, the frame of the terrain model. Metres; quaternion scalar LAST.
- The timestamp is the middle of the exposure, seconds since 1970 UTC, to the microsecond; image and
  pose of a shot have the same.
- rgb holds grey images, unscaled; Mono12 is 0 to 4095 in 16-bit PNG. There is no depth.
- The format has no place for intrinsics: camera.json has them as tronlab does, pixel (0, 0) being
  the centre of the top-left pixel, distortion k1 k2 p1 p2 k3 k4 k5 k6 as in OpenCV.
"""

    def write(self, dataset: Dataset, folder: Path, on_shot: OnShot) -> dict[int, str]:
        """Write images, trajectory and camera."""
        stamps = _stamps(dataset)
        (folder / "rgb").mkdir()
        poses: dict[str, str] = {}
        for shot in shots_of(dataset, on_shot):
            stamp = stamps[shot.shot_id]
            write_png(folder / "rgb" / f"{stamp}.png", shot.image)
            poses[stamp] = _pose(shot)
        in_time = sorted(poses, key=float)
        images = [f"{stamp} rgb/{stamp}.png" for stamp in in_time]
        trajectory = [f"{stamp} {poses[stamp]}" for stamp in in_time]
        _write(folder / "rgb.txt", "# images\n# timestamp filename", images)
        header = "# ground truth trajectory\n# timestamp tx ty tz qx qy qz qw"
        _write(folder / "groundtruth.txt", header, trajectory)
        camera = json.dumps(dataset.camera.to_dict(), indent=1)
        (folder / "camera.json").write_text(camera, "utf-8")
        return {shot_id: f"rgb/{stamp}.png" for shot_id, stamp in stamps.items()}


def _stamps(dataset: Dataset) -> dict[int, str]:
    """Give the time stamp of each shot by its id.

    Raises:
        DatasetError: A time is not known, or two shots have the same to the microsecond.
    """
    times_s = dataset.rows(f"{schema.CAMERA}/time_s")
    stamps = {
        shot_id: f"{time_s:.6f}"
        for shot_id, time_s in zip(dataset.shot_ids.tolist(), times_s.tolist(), strict=True)
    }
    seen: dict[str, int] = {}
    for shot_id, stamp in stamps.items():
        if stamp == "nan":
            raise DatasetError(
                f"{dataset.path}: shot {shot_id}: its time is not known, and TUM's format goes by"
                " time; export to another format"
            )
        if stamp in seen:
            raise DatasetError(
                f"{dataset.path}: shots {seen[stamp]} and {shot_id} have the same time {stamp} s,"
                " and TUM's format goes by time; export to another format"
            )
        seen[stamp] = shot_id
    return stamps


def _pose(shot: ExportShot) -> str:
    return numbers(xyz_quat_from_pose(shot.truth.trs_from_cam))


def _write(path: Path, header: str, lines: list[str]) -> None:
    path.write_text("\n".join([header, *lines]) + "\n", "utf-8")
