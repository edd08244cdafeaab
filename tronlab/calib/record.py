"""The calibration record: what was measured, what followed from it, and for which rig."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scipy.spatial.transform import RigidTransform

from tronlab.errors import CalibrationError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray
