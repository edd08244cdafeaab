"""Where the light is, from the reflector on the lamp's housing."""

import numpy as np

from tronlab.calib.reflectors.frame import check_range, check_reading, point_in_trs
from tronlab.calib.results import FrameResult, LampResult
from tronlab.devices.laboratory import LampSpec
from tronlab.devices.readings import PointReading
from tronlab.errors import CalibrationError


def solve_lamp(reading: PointReading, frame: FrameResult, lamp: LampSpec) -> LampResult:
    """Find the centre of the light.

    Args:
        reading: The reflector on the housing.
        frame: Where the model frame lies in that set-up of the tracker.
        lamp: How far the light is from the reflector, and how well that is known.

    Raises:
        CalibrationError: The reading makes no sense: not finite, in millimetres, or the light would
            be behind the model.
    """
    check_reading(reading, "lamp: its reflector")
    check_range(reading.p_trk_m, "lamp: its reflector")
    p_reflector, covariance = point_in_trs(reading, frame)
    p_light = p_reflector + np.array(lamp.light_from_reflector_m)
    if p_light[2] <= 0.0:
        raise CalibrationError(
            f"lamp: the light would be {-p_light[2]:.3f} m behind the model;"
            "\nmeasure the reflector on the lamp's housing, and check"
            " laboratory.lamp.light_from_reflector_m in the rig file"
        )
    return LampResult(
        p_trs_m=p_light,
        covariance_m2=covariance + lamp.light_sigma_m**2 * np.eye(3),
        statistics={
            "p_reflector_trs_m": p_reflector.tolist(),
            "from_nominal_m": (p_light - np.array(lamp.p_trs_m)).tolist(),
            "reflector_sigma_m": np.sqrt(np.diag(covariance)).tolist(),
            "light_sigma_m": lamp.light_sigma_m,
        },
    )
