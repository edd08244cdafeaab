"""Motions between stations, seen from T-MAC and camera: what closed hand-eye forms rest on."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.errors import DegenerateGeometryError
from tronlab.geometry.poses import FloatArray

Poses: TypeAlias = Sequence[RigidTransform] | RigidTransform
"""One a station; a RigidTransform of many poses spares the time to stack them."""

MIN_STATIONS = 3
MIN_TURN_RAD = np.radians(5.0)
"""Least root mean square of the turns between stations, about each of two axes."""
_LARGEST_TURN_RAD = np.radians(165.0)
"""A rotation vector near half a turn flips its sign by noise."""
_MAX_MOTIONS = 5000
"""Long streams have millions of pairs; an even choice of them says the same."""


@dataclass(frozen=True, slots=True)
class Motions:
    """How both moved between two stations: ``tmac * X = X * cam`` with X = tmac_from_cam."""

    tmac: RigidTransform
    """Earlier T-MAC in the later one, n poses."""
    cam: RigidTransform
    """Earlier camera in the later one, n poses."""

    def __len__(self) -> int:
        return len(self.tmac)

    @property
    def turns_tmac(self) -> FloatArray:
        """Get the rotation vectors of the T-MAC, shape (n, 3)."""
        return self.tmac.rotation.as_rotvec()

    @property
    def turns_cam(self) -> FloatArray:
        """Get the rotation vectors of the camera, shape (n, 3)."""
        return self.cam.rotation.as_rotvec()


def motions_between(trk_from_tmac: Poses, cam_from_board: Poses) -> Motions:
    """Give the motion between every two stations, near half turns left out.

    Args:
        trk_from_tmac: Measured pose of the T-MAC at each station.
        cam_from_board: Pose of the board in the camera at each station.
    """
    tmac, cam = stack_poses(trk_from_tmac), stack_poses(cam_from_board)
    first, second = _pairs(len(tmac))
    motions_tmac = tmac[second].inv() * tmac[first]
    is_used = motions_tmac.rotation.magnitude() < _LARGEST_TURN_RAD
    motions_cam = cam[second[is_used]] * cam[first[is_used]].inv()
    return Motions(motions_tmac[is_used], motions_cam)


def stack_poses(poses: Poses) -> RigidTransform:
    """Give poses as one object of many."""
    if isinstance(poses, RigidTransform):
        return poses
    return RigidTransform.concatenate(list(poses))


def check_motions(trk_from_tmac: Poses) -> None:
    """Refuse stations that cannot determine a hand-eye transform.

    Args:
        trk_from_tmac: Measured pose of the T-MAC at each station.

    Raises:
        DegenerateGeometryError: Fewer than three stations, or the T-MAC turned about one axis only,
            or hardly at all (then part of the translation is undetermined), or all stations are
            about half a turn apart.
    """
    n = len(trk_from_tmac)
    if n < MIN_STATIONS:
        raise DegenerateGeometryError(
            f"hand-eye: {n} stations, at least {MIN_STATIONS} with turns about two axes needed"
        )
    turns = motions_between(trk_from_tmac, trk_from_tmac).turns_tmac
    if not len(turns):
        raise DegenerateGeometryError(
            "hand-eye: all stations are about half a turn apart; add stations in between"
        )
    _, spread, axes = np.linalg.svd(turns / np.sqrt(len(turns)), full_matrices=False)
    needed = f"at least {np.degrees(MIN_TURN_RAD):.0f} deg needed"
    if spread[0] < MIN_TURN_RAD:
        raise DegenerateGeometryError(
            f"hand-eye: the T-MAC turned by {np.degrees(spread[0]):.2f} deg between stations"
            f" ({needed}); turn it about two axes"
        )
    # A single motion has a single axis: its two rows of zeros are not in the decomposition.
    second = spread[1] if len(spread) > 1 else 0.0
    if second < MIN_TURN_RAD:
        axis = ", ".join(f"{value:.2f}" for value in axes[0])
        raise DegenerateGeometryError(
            f"hand-eye: all turns are about the same axis ({axis}) of tmac, within"
            f" {np.degrees(second):.2f} deg ({needed}): the translation along it is not"
            " determined; turn the T-MAC about a second axis"
        )


def align_directions(a: FloatArray, b: FloatArray) -> Rotation:
    """Find R with a = R b in the least-squares sense, vectors of shape (n, 3)."""
    u, _, vt = np.linalg.svd(a.T @ b)
    handed = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    return Rotation.from_matrix(u @ handed @ vt)


def _pairs(n: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    first, second = np.triu_indices(n, k=1)
    if len(first) > _MAX_MOTIONS:
        chosen = np.linspace(0, len(first) - 1, _MAX_MOTIONS).astype(np.intp)
        return first[chosen], second[chosen]
    return first, second
