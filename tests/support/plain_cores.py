"""Specs of plain cores that misbehave, frames for them, and a look into the process table."""

import sys
from pathlib import Path
from time import monotonic, sleep

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.dataset.records import ReferenceView
from tronlab.geometry.camera import CameraModel
from tronlab.nav.core import Frame
from tronlab.nav.specs import CoreSpec

PLAIN_CORE = Path(__file__).parents[1] / "unit/nav/foreign/plain_core.py"
CAMERA = CameraModel(24, 16, 20.0, 20.5, 11.5, 7.5, (-0.1, 0.02, 1e-4, -2e-4, 0.01))


def plain(*words: str) -> CoreSpec:
    """Give the spec of a plain core that misbehaves as the words say."""
    return CoreSpec("plain", "command", f"{sys.executable} -ISE {PLAIN_CORE} {' '.join(words)}")


def frame(number: int, *, shape: tuple[int, int] = (16, 24), **more: object) -> Frame:
    """Give a frame whose bytes sum up to another value for each number."""
    image = np.full(shape, 7 + number, np.uint16)
    return Frame(image, np.arange(image.size).reshape(shape) % 3 == 0, number=number, **more)  # type: ignore[arg-type]


def place(frame: Frame, n_references: int = 0) -> list[float]:
    """Give where a plain core is that saw the frame."""
    return [float(frame.image.sum()), float(frame.mask.sum()), float(n_references)]


def reference(view_id: int) -> ReferenceView:
    pose = RigidTransform.from_components([0.1, -0.2, view_id], Rotation.from_rotvec([0.1, 0, 3.0]))
    depth = np.full(CAMERA.shape, 1.0 + view_id, np.float32)
    depth[0, 0] = np.nan
    image = np.arange(depth.size, dtype=np.uint8).reshape(depth.shape)
    return ReferenceView(view_id, pose, image, depth, np.isfinite(depth))


def is_gone(pid: int, *, within_s: float = 5.0) -> bool:
    """Say whether a process ends within a time; one that is only waited for has ended."""
    deadline = monotonic() + within_s
    while monotonic() < deadline:
        try:
            if Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z":
                return True
        except OSError:
            return True
        sleep(0.01)
    return False
