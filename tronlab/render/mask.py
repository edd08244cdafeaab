"""Which pixels show the terrain model, if it were flat."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.camera import CameraModel
from tronlab.render.rays import centre_rays
from tronlab.terrain.heightmap import HeightMap


def model_mask(
    heightmap: HeightMap, camera: CameraModel, trs_from_cam: RigidTransform
) -> NDArray[np.bool_]:
    """Mark the pixels whose centre sees the model's outline at its mean height.

    Args:
        heightmap: The terrain model.
        camera: Intrinsics; the rays are those of the distorted image.
        trs_from_cam: Where the camera is.

    Returns:
        Shape (rows, columns); all False when the camera looks away, or from behind.
    """
    rotation = trs_from_cam.rotation.as_matrix()
    eye = trs_from_cam.translation
    rays = centre_rays(camera)
    direction_z = rays @ rotation[2, :2] + rotation[2, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (heightmap.mean_height_trs_m - eye[2]) / direction_z
        seen = (depth > 0) & (eye[2] > heightmap.mean_height_trs_m)
        for axis in (0, 1):
            direction = rays @ rotation[axis, :2] + rotation[axis, 2]
            place = eye[axis] + depth * direction - heightmap.origin_trs_m[axis]
            seen &= (place >= 0) & (place <= heightmap.size_m[axis])
    return seen
