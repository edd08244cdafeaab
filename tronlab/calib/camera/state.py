"""Camera, board and poses as one state, and the corners it is to agree with."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.calib.camera.board import BoardView
from tronlab.calib.camera.bow import N_BOW, bow_basis
from tronlab.calib.camera.projection import (
    N_INTRINSICS,
    DistortionModel,
    free_intrinsics,
    intrinsics_of,
    with_intrinsics,
)
from tronlab.devices.laboratory import PatternSpec
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray

N_COMMON = N_INTRINSICS + N_BOW
"""What all views share: the intrinsics, then the terms of the bow."""


@dataclass(frozen=True, slots=True)
class CameraKind:
    """Which of the unknowns that all views share are free; the others stay 0."""

    model: DistortionModel
    is_bow_free: bool

    @property
    def name(self) -> str:
        """Get the model, and whether the board is taken as flat."""
        return self.model if self.is_bow_free else f"{self.model}, flat board"

    @property
    def free(self) -> NDArray[np.intp]:
        """Get the free ones as indices below ``N_COMMON``."""
        bow = np.arange(N_INTRINSICS, N_COMMON if self.is_bow_free else N_INTRINSICS)
        return np.concatenate([free_intrinsics(self.model), bow])


@dataclass(frozen=True, slots=True)
class Corners:
    """Corners of several views in arrays of one length; short views are filled up, weight 0."""

    p_board_m: FloatArray
    """Of the flat board, shape (n_views, n, 3)."""
    uv_px: FloatArray
    """Shape (n_views, n, 2)."""
    basis: FloatArray
    """``bow_basis`` there, shape (n_views, n, 3)."""
    weights: FloatArray
    """Of each corner's squared residual, shape (n_views, n)."""

    @classmethod
    def of(cls, views: Sequence[BoardView], pattern: PatternSpec) -> "Corners":
        """Stack views of which each has a corner at least."""
        length = max(len(view) for view in views)
        fill = [np.minimum(np.arange(length), len(view) - 1) for view in views]
        p_board_m = np.stack([v.p_board_m[f] for v, f in zip(views, fill, strict=True)])
        basis = bow_basis(p_board_m.reshape(-1, 3), pattern).reshape(p_board_m.shape)
        weights = np.stack([np.arange(length) < len(view) for view in views]).astype(float)
        uv_px = np.stack([v.uv_px[f] for v, f in zip(views, fill, strict=True)])
        return cls(p_board_m, uv_px, basis, weights)

    def weighted(self, weights: FloatArray) -> "Corners":
        """Give the corners with other weights, shape (n_views, n)."""
        return replace(self, weights=weights)

    def of_views(self, chosen: NDArray[np.intp]) -> "Corners":
        """Give the corners of some views."""
        return Corners(
            self.p_board_m[chosen], self.uv_px[chosen], self.basis[chosen], self.weights[chosen]
        )

    @property
    def n_used(self) -> int:
        """Get how many corners have a weight."""
        return int(np.count_nonzero(self.weights))


@dataclass(frozen=True, slots=True)
class CameraFit:
    """Camera, bow of the board, and the pose of the board in each view."""

    camera: CameraModel
    bow_m: FloatArray
    rotations: Rotation
    """Of cam_from_board, one a view."""
    translations_m: FloatArray
    """Of cam_from_board, shape (n_views, 3)."""

    @classmethod
    def at(cls, camera: CameraModel, cam_from_board: Sequence[RigidTransform]) -> "CameraFit":
        """Start with a flat board and these poses."""
        rotations = Rotation.concatenate([pose.rotation for pose in cam_from_board])
        translations = np.stack([pose.translation for pose in cam_from_board])
        return cls(camera, np.zeros(N_BOW), rotations, translations)

    @property
    def cam_from_board(self) -> tuple[RigidTransform, ...]:
        """Get the pose of the board in each view."""
        return tuple(
            RigidTransform.from_components(translation, rotation)
            for rotation, translation in zip(self.rotations, self.translations_m, strict=True)
        )

    @property
    def common(self) -> FloatArray:
        """Get what all views share, shape (15,)."""
        return np.concatenate([intrinsics_of(self.camera), self.bow_m])

    def of_views(self, chosen: NDArray[np.intp]) -> "CameraFit":
        """Give the fit with the poses of some views."""
        rotations = Rotation.from_quat(self.rotations.as_quat()[chosen])
        return replace(self, rotations=rotations, translations_m=self.translations_m[chosen])

    def with_poses(self, other: "CameraFit") -> "CameraFit":
        """Give this camera and bow with the poses of another fit."""
        return replace(self, rotations=other.rotations, translations_m=other.translations_m)

    def restricted(self, kind: CameraKind) -> "CameraFit":
        """Give the fit with 0 for what that kind of camera does not have."""
        common = np.zeros(N_COMMON)
        common[kind.free] = self.common[kind.free]
        return self._with_common(common)

    def moved(self, common: FloatArray, poses: FloatArray) -> "CameraFit":
        """Add steps: of what is shared, shape (15,), and of the poses, shape (n_views, 6)."""
        return replace(
            self._with_common(self.common + common),
            rotations=Rotation.from_rotvec(poses[:, :3]) * self.rotations,
            translations_m=self.translations_m + poses[:, 3:],
        )

    def _with_common(self, common: FloatArray) -> "CameraFit":
        camera = with_intrinsics(self.camera, common[:N_INTRINSICS])
        return replace(self, camera=camera, bow_m=common[N_INTRINSICS:])
