"""Which pixels show the terrain model, if it were flat."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.camera import CameraModel
from tronlab.render.mask_kernel import mark_seen
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
    seen = np.zeros(camera.shape, np.bool_)
    corner_trs_m = heightmap.origin_trs_m[:2]
    eye_m = trs_from_cam.translation - [*corner_trs_m, heightmap.mean_height_trs_m]
    if eye_m[2] > 0:
        rotation = np.ascontiguousarray(trs_from_cam.rotation.as_matrix())
        mark_seen(centre_rays(camera), rotation, eye_m, np.array(heightmap.size_m), seen)
    return seen
