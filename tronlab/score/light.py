"""Where the light was: the lamp of a calibration record, and the phase angle of a shot."""

import json
from functools import lru_cache
from typing import Any

import numpy as np

from tronlab.dataset.records import Truth
from tronlab.geometry.poses import FloatArray


@lru_cache(maxsize=32)
def lamp_position(calibration_json: str) -> tuple[float, float, float] | None:
    """Give the centre of the light as a calibration record has it.

    Args:
        calibration_json: The record, whole, as a dataset keeps it.

    Returns:
        Its place in trs, metres; None if the record does not know it, as that of a foreign camera.
    """
    try:
        record: Any = json.loads(calibration_json)
        x, y, z = (float(value) for value in record["lamp"]["p_trs_m"])
    except (ValueError, TypeError, KeyError):
        return None
    return (x, y, z) if np.isfinite([x, y, z]).all() else None


def phase_angle_rad(truth: Truth, p_lamp_trs_m: FloatArray) -> float:
    """Give the angle at the terrain between the directions to the camera and to the lamp.

    It is that of the point where the optical axis meets the terrain: 0 with the lamp behind the
    camera, pi / 2 with the light from the side.

    Args:
        truth: Of the shot.
        p_lamp_trs_m: Centre of the light, shape (3,).

    Returns:
        0 to pi; NaN if the range is not known.
    """
    to_camera = -truth.range_los_m * truth.trs_from_cam.rotation.as_matrix()[:, 2]
    to_lamp = np.asarray(p_lamp_trs_m) - (truth.trs_from_cam.translation - to_camera)
    sine, cosine = np.linalg.norm(np.cross(to_camera, to_lamp)), to_camera @ to_lamp
    return float(np.arctan2(sine, cosine))
