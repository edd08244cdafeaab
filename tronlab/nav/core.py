"""What a navigation core is, and what it answers."""

from dataclasses import dataclass, field
from typing import Literal, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.dataset.records import ReferenceView
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray

Status: TypeAlias = Literal["ok", "no_pose", "error", "timeout"]


@dataclass(frozen=True, slots=True)
class NavigationResult:
    """One answer of a core. Finding no pose is an answer, not an exception."""

    status: Status
    trs_from_cam: RigidTransform | None = None
    covariance: FloatArray | None = None
    """Of (rotation vector, translation) in trs, shape (6, 6), rad and m; None if not estimated."""
    n_features: int = 0
    n_matches: int = 0
    n_inliers: int = 0
    uv_inliers: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    """Image positions the pose rests on, shape (n_inliers, 2), pixels."""
    time_detect_s: float = 0.0
    time_match_s: float = 0.0
    time_pose_s: float = 0.0
    reason: str = ""
    """Why there is no pose."""


class NavigationCore(Protocol):
    """Finds the camera's pose in an image.

    A plug-in: entry point group ``tronlab.navigation_cores``, a factory
    ``factory(context: CoreContext) -> NavigationCore``.
    """

    @property
    def name(self) -> str:
        """Get the name the scores carry."""
        ...

    def locate(
        self, image: NDArray[np.uint8] | NDArray[np.uint16], mask: NDArray[np.bool_]
    ) -> NavigationResult:
        """Find ``trs_from_cam`` of one image.

        Args:
            image: Grey values, shape (rows, columns); uint16 holds 12 bit.
            mask: True where features may be used, same shape.
        """
        ...


@dataclass(frozen=True)
class CoreContext:
    """What a core may know: the reference views and the camera, never the truth of a shot."""

    camera: CameraModel
    references: tuple[ReferenceView, ...]
    shared: dict[str, object] = field(default_factory=dict[str, object])
    """One for all cores of a process: cores with the same detector share its work here."""
