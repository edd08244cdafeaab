"""Export in the format of SPEED+, the spacecraft pose estimation dataset of Stanford's TRON.

Source of the format: Park et al., SPEED+, IEEE Aerospace Conference 2022, and its authors' baseline
(github.com/tpark94/speedplusbaseline), which projects by ``R(q) p + r`` with a scalar-first q.
"""

import json
from pathlib import Path

from tronlab.dataset.exchange.images import write_png
from tronlab.dataset.exchange.shots import OnShot, quat_wxyz, shots_of
from tronlab.dataset.reader import Dataset
from tronlab.geometry.camera import CameraModel

_DOMAIN = "lab"
_N_BROWN = 5
"""Coefficients k1, k2, p1, p2, k3, all that readers of SPEED+ expect."""


class SpeedPlusExporter:
    """Writes one domain, ``lab``, with the terrain model in the place of the spacecraft."""

    conventions = f"""\
Format: SPEED+ (Park et al. 2022). One domain, '{_DOMAIN}': its images, and its poses in train.json.
- q_vbs2tango_true: unit quaternion, scalar FIRST (w x y z), and r_Vo2To_vbs_true, metres, such that
  p_cam = R(q) p_model + r. The camera frame is SPEED+'s vbs: x right, y down, z forward;
  the terrain model's frame F_TRS stands in for the spacecraft's.
- camera.json: Nu columns, Nv rows, ccx and ccy the principal point, cameraMatrix and distCoeffs
  as OpenCV has them (k1 k2 p1 p2 k3, and k4 k5 k6 only if the camera needs them: many readers of
  SPEED+ take five and would be wrong then). Images are distorted, as in SPEED+. Focal length and
  pixel pitch in metres (fx, fy, ppx, ppy) are left out: the calibration does not know them.
- Pixel (0, 0) is the centre of the top-left pixel.
- Images are PNG, not JPEG, grey values unscaled; Mono12 is 0 to 4095 in 16-bit PNG.
"""

    def write(self, dataset: Dataset, folder: Path, on_shot: OnShot) -> dict[int, str]:
        """Write the camera, images and poses."""
        images = folder / _DOMAIN / "images"
        images.mkdir(parents=True)
        names: dict[int, str] = {}
        labels: list[dict[str, object]] = []
        for shot in shots_of(dataset, on_shot):
            name = names[shot.shot_id] = f"img{shot.shot_id:06d}.png"
            write_png(images / name, shot.image)
            cam_from_trs = shot.cam_from_trs
            label: dict[str, object] = {
                "filename": name,
                "q_vbs2tango_true": quat_wxyz(cam_from_trs),
                "r_Vo2To_vbs_true": cam_from_trs.translation.tolist(),
            }
            labels.append(label)
        (folder / _DOMAIN / "train.json").write_text(json.dumps(labels, indent=1), "utf-8")
        camera = json.dumps(_camera(dataset.camera), indent=1)
        (folder / "camera.json").write_text(camera, "utf-8")
        return {shot_id: f"{_DOMAIN}/images/{name}" for shot_id, name in names.items()}


def _camera(camera: CameraModel) -> dict[str, object]:
    is_rational = any(camera.distortion[_N_BROWN:])
    return {
        "Nu": camera.width_px,
        "Nv": camera.height_px,
        "ccx": camera.cx_px,
        "ccy": camera.cy_px,
        "cameraMatrix": camera.matrix.tolist(),
        "distCoeffs": list(camera.distortion if is_rational else camera.distortion[:_N_BROWN]),
    }
