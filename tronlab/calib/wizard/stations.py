"""Where the camera may look at the board from: a pool of poses that are worth a station."""

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.devices.laboratory import LaboratorySpec, PatternSpec
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray

POOL_SIZE = 60
N_FIXED = 6
"""The first poses of the pool: one of each corner of the image and all distances, so that from them
camera and hand-eye are roughly known before any station is chosen."""
_FILLS = (0.8, 0.6, 0.45)
"""Width of the board over that of the image: near and far views tell distance from focal length."""
_AIMS = ((0, 0), (-1, -1), (1, 1), (1, -1), (-1, 1), (0, -1), (0, 1), (-1, 0), (1, 0))
"""Where in the image the centre of the board comes to lie; corners reach the image's edge."""
_OVERHANG = 0.15
"""How far the board may reach beyond the image, so that its corners do lie at the edge."""
_TILTS_DEG = ((30, 0), (0, 30), (-30, 0), (0, -30), (22, 22), (-22, 22), (22, -22), (-22, -22))
_ROLLS_DEG = (30, -60, 45, -30, 60)
"""Turns about the optical axis; with the tilts they determine all of the hand-eye transform. Edges
near the rows and columns of pixels would give corners of two to four times the error."""


def plan_stations(laboratory: LaboratorySpec) -> tuple[RigidTransform, ...]:
    """Give nominal poses ``trs_from_cam`` from which the board is seen.

    Distances follow from the size of the board and the field of view. Distances, aims, tilts and
    rolls run through cycles of different length, so that they come in many combinations, and the
    first poses are as different as can be.
    """
    board, camera = laboratory.board, laboratory.camera.nominal_model
    trs_from_board = board.trs_from_board.pose
    return tuple(trs_from_board * _board_from_cam(board, camera, i) for i in range(POOL_SIZE))


def board_centre_m(pattern: PatternSpec) -> FloatArray:
    """Give the middle of the board, shape (3,), frame board."""
    return np.array([pattern.columns, pattern.rows, 0.0]) * pattern.square_m / 2


def _board_from_cam(board: PatternSpec, camera: CameraModel, i: int) -> RigidTransform:
    fill = _FILLS[(i + i // len(_AIMS)) % len(_FILLS)]
    aim = np.array(_AIMS[i % len(_AIMS)], dtype=np.float64) * (1.0 + _OVERHANG - fill)
    tilt = Rotation.from_euler("xy", _TILTS_DEG[i % len(_TILTS_DEG)], degrees=True)
    roll = Rotation.from_euler("z", _ROLLS_DEG[i % len(_ROLLS_DEG)], degrees=True)
    distance_m = board.columns * board.square_m * camera.fx_px / (fill * camera.width_px)
    half_size = np.array([camera.width_px, camera.height_px]) / 2
    ray = np.append(aim * half_size / [camera.fx_px, camera.fy_px], 1.0)
    cam_from_looking = _turn_to(ray) * roll
    rotation = tilt * cam_from_looking.inv()
    away = tilt.apply([0.0, 0.0, distance_m])
    return RigidTransform.from_components(board_centre_m(board) - away, rotation)


def _turn_to(ray: FloatArray) -> Rotation:
    """Give the smallest rotation that turns the z-axis to a ray."""
    direction = ray / np.linalg.norm(ray)
    axis = np.cross([0.0, 0.0, 1.0], direction)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        return Rotation.identity()
    return Rotation.from_rotvec(axis / sine * np.arctan2(sine, direction[2]))
