"""What a navigation core is, what it is given, and what it answers."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.dataset.records import ReferenceView
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray
from tronlab.nav.stages import NOTHING_KEPT, StageStore

GreyImage: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]
Mask: TypeAlias = NDArray[np.bool_]
Status: TypeAlias = Literal["ok", "no_pose", "error", "timeout"]


@dataclass(frozen=True, slots=True)
class PosePrior:
    """What is known of a pose before the image is looked at."""

    trs_from_cam: RigidTransform
    covariance: FloatArray
    """Of (rotation vector, translation) in trs, shape (6, 6), rad and m; see
    ``geometry.uncertainty``."""


@dataclass(frozen=True, slots=True)
class Frame:
    """One image that a core shall find the pose of."""

    image: GreyImage
    """Grey values, shape (rows, columns); uint16 holds 12 bit."""
    mask: Mask
    """True where features may be used, same shape."""
    number: int = 0
    """Counts the frames of a sequence, from 0."""
    time_s: float = float("nan")
    """Of the exposure, Unix time; NaN if nobody knows it."""
    prior: PosePrior | None = None
    """None unless the scoring offers one."""
    key: str = ""
    """Tells images with their masks apart; frames of the same key show the same. Empty: unknown."""


@dataclass(frozen=True, slots=True)
class NavigationResult:
    """One answer of a core. Finding no pose is an answer, not an exception."""

    status: Status
    trs_from_cam: RigidTransform | None = None
    covariance: FloatArray | None = None
    """Of (rotation vector, translation) in trs, shape (6, 6), rad and m; None if not estimated."""
    bound: FloatArray | None = None
    """Cramer-Rao bound: the least covariance an unbiased estimate from the same measurements can
    have, shape (6, 6), like ``covariance``; None if not known."""
    n_features: int = 0
    n_matches: int = 0
    n_inliers: int = 0
    uv_inliers: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    """Image positions the pose rests on, shape (n_inliers, 2), pixels."""
    landmark_inliers: NDArray[np.intp] = field(default_factory=lambda: np.empty(0, np.intp))
    """Landmark of each inlier in the database, shape (n_inliers,); empty if the core has none."""
    database: str = ""
    """Digest of the database that ``landmark_inliers`` counts in."""
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

    def locate(self, frame: Frame) -> NavigationResult:
        """Find ``trs_from_cam`` of one image."""
        ...


@runtime_checkable
class SequentialCore(NavigationCore, Protocol):
    """A core that keeps state along a trajectory, a filter for example.

    It sees the frames of a sequence one after the other, all of them, in one process.
    """

    def reset(self) -> None:
        """Forget everything: the next frame is the first of a sequence."""
        ...


@dataclass(frozen=True)
class CoreContext:
    """What a core may know: the reference views and the camera, never the truth of a shot."""

    camera: CameraModel
    references: tuple[ReferenceView, ...]
    settings: Mapping[str, object] = field(default_factory=dict[str, object])
    """Of this core, as the sweep or the campaign gives them."""
    seed: int = 0
    """Of every random number the core draws."""
    shared: dict[str, object] = field(default_factory=dict[str, object])
    """One for all cores of a process: cores with the same detector share its work here."""
    stages: StageStore = NOTHING_KEPT
    """Where results of single stages are kept from one scoring to the next."""
    references_key: str = ""
    """Tells sets of reference views, with the camera, apart; empty: unknown."""
