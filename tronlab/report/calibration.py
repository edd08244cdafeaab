"""The pictures of a calibration: those a wizard leaves beside the record it made."""

from collections.abc import Iterator
from pathlib import Path

from matplotlib.figure import Figure

from tronlab.calib.budget import Budget, error_budget, sweep
from tronlab.calib.camera.view_residuals import view_residuals
from tronlab.calib.hand_eye.station_gaps import station_gaps
from tronlab.calib.inputs import StationsInput
from tronlab.calib.record import CalibrationRecord
from tronlab.devices.laboratory import PatternSpec
from tronlab.report.calibration_budget import budget_chart
from tronlab.report.calibration_charts import bow_chart, frame_chart, model_chart, station_chart
from tronlab.report.calibration_images import (
    coverage_picture,
    projection_picture,
    residual_picture,
)
from tronlab.report.calibration_photometry import photometry_chart
from tronlab.report.style import save_chart


def write_pictures(record: CalibrationRecord, folder: Path) -> list[Path]:
    """Draw all there is to see of a record, each picture as PNG and as PDF.

    Args:
        record: The record; parts it does not have are not drawn.
        folder: Where to; it is made if need be, pictures of the same names are replaced.

    Returns:
        The PNG files.
    """
    folder.mkdir(parents=True, exist_ok=True)
    return [save_chart(figure, folder, stem) for stem, figure in _figures(record)]


def save_budget(budget: Budget, folder: Path) -> Path:
    """Draw an error budget into ``budget.png`` and ``budget.pdf``; give the PNG's path."""
    return save_chart(budget_chart(budget), folder, "budget")


def _figures(record: CalibrationRecord) -> Iterator[tuple[str, Figure]]:
    """Give each figure with the stem of its file."""
    yield from _camera_figures(record)
    hand_eye, stations = record.results.hand_eye, station_gaps(record.inputs, record.results)
    if hand_eye is not None and stations is not None:
        yield "stations", station_chart(stations, hand_eye)
    frame, measured = record.results.frame, record.inputs.frame
    if frame is not None and measured is not None:
        yield "frame", frame_chart(measured, frame)
    photometry, patches = record.results.photometry, record.inputs.photometry
    if photometry is not None and patches is not None:
        yield "photometry", photometry_chart(patches, photometry)
    if _has_budget(record):
        yield "budget", budget_chart(error_budget(record, sweep(record)))


def _camera_figures(record: CalibrationRecord) -> Iterator[tuple[str, Figure]]:
    camera, pattern = record.results.camera, _pattern(record)
    if camera is None or pattern is None:
        return
    views = view_residuals(record.inputs, camera)
    yield "residuals", residual_picture(camera.camera, views)
    yield "coverage", coverage_picture(camera.camera, views)
    if camera.covariance.any():
        yield "projection", projection_picture(camera, views)
    if "models" in camera.statistics:
        yield "models", model_chart(camera)
    yield "bow", bow_chart(pattern, camera)


def _pattern(record: CalibrationRecord) -> PatternSpec | None:
    """Give the board the camera was solved from."""
    if isinstance(record.inputs.hand_eye, StationsInput):
        return record.inputs.hand_eye.pattern
    return None if record.inputs.intrinsics is None else record.inputs.intrinsics.pattern


def _has_budget(record: CalibrationRecord) -> bool:
    parts = (record.results.frame, record.results.camera, record.results.hand_eye)
    has_readings = isinstance(record.inputs.hand_eye, StationsInput)
    return has_readings and record.inputs.frame is not None and None not in parts
