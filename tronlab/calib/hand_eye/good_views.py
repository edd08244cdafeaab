"""The stations and free views whose images are good enough for the hand-eye solution."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.calib.camera.board import BoardView
from tronlab.calib.camera.intrinsics import IntrinsicsSolution
from tronlab.calib.hand_eye.bundle import Station

PosesPerStation = tuple[list[RigidTransform], list[RigidTransform]]
"""trk_from_tmac as read, and cam_from_board by the image alone."""


@dataclass(frozen=True, slots=True)
class GoodViews:
    """What the intrinsics have not found to be outliers, without the corners that are."""

    stations: Mapping[int, Station]
    """By their number."""
    free_views: Sequence[BoardView]
    cam_from_board: Sequence[RigidTransform]
    """By the images alone, of each view, stations first."""
    bad_stations: tuple[int, ...]
    """Numbers of those left out."""

    @classmethod
    def of(
        cls,
        stations: Sequence[Station],
        free_views: Sequence[BoardView],
        intrinsics: IntrinsicsSolution,
    ) -> "GoodViews":
        """Choose by the intrinsics, which were solved from both, stations first."""
        views = [*(station.view for station in stations), *free_views]
        good = [i for i in range(len(views)) if i not in intrinsics.outlier_views]
        kept = {i: without_corners(views[i], i, intrinsics.outlier_corners) for i in good}
        n = len(stations)
        return cls(
            stations={i: Station(stations[i].reading, kept[i]) for i in good if i < n},
            free_views=[kept[i] for i in good if i >= n],
            cam_from_board=[intrinsics.cam_from_board[i] for i in good],
            bad_stations=tuple(i for i in range(n) if i not in kept),
        )

    @property
    def numbers(self) -> list[int]:
        """Get the stations' numbers."""
        return list(self.stations)

    def poses(self, which: NDArray[np.bool_] | None = None) -> PosesPerStation:
        """Give the poses of all stations, or of some, shape (n_stations,)."""
        chosen = range(len(self.stations)) if which is None else np.flatnonzero(which).tolist()
        readings = [station.reading.trk_from_tmac for station in self.stations.values()]
        return [readings[i] for i in chosen], [self.cam_from_board[i] for i in chosen]


def without_corners(view: BoardView, i: int, corners: Sequence[tuple[int, int]]) -> BoardView:
    """Give view i without the corners listed as (view, number)."""
    is_good = ~np.isin(view.ids, [number for i_view, number in corners if i_view == i])
    return BoardView(view.ids[is_good], view.p_board_m[is_good], view.uv_px[is_good])
