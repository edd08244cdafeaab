"""A navigation core that answers the pose of the reference view most like the image."""

from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from tronlab.nav.core import CoreContext, Frame, NavigationResult

__version__ = "1.0"


class NearestView:
    """Compares images with the reference views, pixel by pixel.

    Setting ``min_likeness``, -1 to 1: less than this is no pose. Without it everything is one.
    """

    name = "nearest-view"

    def __init__(self, context: CoreContext) -> None:
        self._references = context.references
        setting = context.settings.get("min_likeness", -1.0)
        if isinstance(setting, bool) or not isinstance(setting, int | float):
            raise ValueError("the setting min_likeness must be a number, -1 to 1")
        self._min_likeness = setting

    def locate(self, frame: Frame) -> NavigationResult:
        """Find ``trs_from_cam`` of one image."""
        start_s = perf_counter()
        likeness = [
            _likeness(frame.image, view.image, frame.mask & view.mask) for view in self._references
        ]
        if not np.isfinite(likeness).any():
            return NavigationResult("no_pose", reason="the image resembles no reference view")
        best = int(np.nanargmax(likeness))
        if likeness[best] < self._min_likeness:
            return NavigationResult(
                "no_pose", reason=f"the nearest view has a likeness of only {likeness[best]:.3f}"
            )
        pose = self._references[best].trs_from_cam
        return NavigationResult("ok", pose, time_pose_s=perf_counter() - start_s)


def _likeness(a: NDArray[np.generic], b: NDArray[np.generic], where: NDArray[np.bool_]) -> float:
    """Give the correlation of two images, -1 to 1; NaN if one of them is flat."""
    x, y = (values[where].astype(np.float64) for values in (a, b))
    if not where.any() or np.ptp(x) == 0 or np.ptp(y) == 0:
        return float("nan")
    return float(np.corrcoef(x, y)[0, 1])
