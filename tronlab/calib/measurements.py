"""Everything measured for a calibration, as it goes into the record: the results follow from it."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tronlab.calib.board import BoardView
from tronlab.calib.bundle import Station
from tronlab.devices.laboratory import LaboratorySpec
from tronlab.devices.readings import PointReading, PoseReading
from tronlab.geometry.poses import xyz_quat_from_pose

UV_DECIMALS = 4
"""Corners are rounded to this before anything is solved, so that the record has all there was."""


@dataclass(frozen=True, slots=True)
class Measurements:
    """What a calibration is solved from."""

    laboratory: LaboratorySpec
    """The laboratory as designed."""
    reflectors: dict[str, PointReading]
    lamp: PointReading
    stations: tuple[Station, ...]
    skipped: tuple[str, ...]
    """What was left out, and why, one line each."""

    def to_inputs(self) -> dict[str, Any]:
        """Give plain values for the record; poses as ``x y z qx qy qz qw``, metres."""
        return {
            "laboratory": self.laboratory.model_dump(mode="json"),
            "reflectors": {name: _point(reading) for name, reading in self.reflectors.items()},
            "lamp": _point(self.lamp),
            "skipped": list(self.skipped),
            "stations": [
                {**_pose(station.reading), **_view(station.view)} for station in self.stations
            ],
        }


def rounded(view: BoardView) -> BoardView:
    """Give the view as the record keeps it."""
    return BoardView(view.ids, view.p_board_m, np.round(view.uv_px, UV_DECIMALS))


def _point(reading: PointReading) -> dict[str, Any]:
    return {
        "p_trk_m": reading.p_trk_m.tolist(),
        "covariance_m2": reading.covariance_m2.tolist(),
        "time_s": reading.time_s,
    }


def _pose(reading: PoseReading) -> dict[str, Any]:
    return {
        "trk_from_tmac_xyz_m_quat_xyzw": xyz_quat_from_pose(reading.trk_from_tmac).tolist(),
        "covariance_rad_m": reading.covariance.tolist(),
        "time_s": reading.time_s,
    }


def _view(view: BoardView) -> dict[str, Any]:
    return {"corner_ids": view.ids.tolist(), "uv_px": view.uv_px.tolist()}
