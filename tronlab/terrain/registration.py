"""How well it is known where a terrain model lies: its error, drawn, and its covariance."""

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.geometry.poses import FloatArray, skew
from tronlab.terrain.config import Registration
from tronlab.terrain.heightmap import HeightMap


def draw_registration_error(
    rng: np.random.Generator, heightmap: HeightMap, registration: Registration
) -> RigidTransform:
    """Draw a small motion: a turn about the middle of the model and a shift.

    Returns:
        ``believed_from_true``: takes a point of the model to where the laboratory believes it to
        be, both in trs.
    """
    turn = Rotation.from_rotvec(rng.standard_normal(3) * np.radians(registration.sigma_deg))
    shift_m = rng.standard_normal(3) * registration.sigma_m
    middle_trs_m = _middle_trs_m(heightmap)
    return RigidTransform.from_components(
        translation=middle_trs_m + shift_m - turn.apply(middle_trs_m), rotation=turn
    )


def registration_covariance(heightmap: HeightMap, registration: Registration) -> FloatArray:
    """Give the covariance of the motion that ``draw_registration_error`` draws.

    Returns:
        Of (rotation vector, translation) in trs, shape (6, 6), rad and m; see
        ``geometry.uncertainty``.
    """
    sigmas = [np.radians(registration.sigma_deg)] * 3 + [registration.sigma_m] * 3
    about_origin = np.eye(6)
    about_origin[3:, :3] = skew(_middle_trs_m(heightmap))
    return about_origin @ np.diag(np.square(sigmas)) @ about_origin.T


def _middle_trs_m(heightmap: HeightMap) -> FloatArray:
    middle_trs_m = np.array([*heightmap.origin_trs_m[:2], heightmap.mean_height_trs_m])
    middle_trs_m[:2] += np.array(heightmap.size_m) / 2
    return middle_trs_m
