"""Recorded files as inputs of a calibration: images, poses, streams, cameras of other programs."""

from tronlab.calib.offline.cameras import read_camera
from tronlab.calib.offline.hand_eye import read_hand_eye
from tronlab.calib.offline.images import read_intrinsics

__all__ = ["read_camera", "read_hand_eye", "read_intrinsics"]
