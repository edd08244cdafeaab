"""What a record's camera leaves over of each view, and where tracker and images disagree."""

from dataclasses import replace

import numpy as np
import pytest
from measured_record import (
    BOW_M,
    CAMERA,
    PATTERN,
    SIGMA_PX,
    TMAC_FROM_CAM,
    measured_record,
)
from scipy.stats import chi2

from tronlab.calib.camera.view_residuals import view_residuals
from tronlab.calib.hand_eye.station_gaps import station_gaps
from tronlab.calib.inputs import IntrinsicsInput
from tronlab.calib.record import CalibrationRecord

pytestmark = pytest.mark.opencv


def true_record(tracker_noise: float = 1.0) -> CalibrationRecord:
    """Give a record that knows the truth."""
    drawn = measured_record(seed=3, n_stations=16, tracker_noise=tracker_noise)
    camera = replace(drawn.results.camera, camera=CAMERA, bow_m=BOW_M)
    hand_eye = replace(drawn.results.hand_eye, tmac_from_cam=TMAC_FROM_CAM)
    return replace(drawn, results=replace(drawn.results, camera=camera, hand_eye=hand_eye))


@pytest.fixture(scope="module")
def record() -> CalibrationRecord:
    return true_record()


def with_camera_statistics(record: CalibrationRecord, **statistics: object) -> CalibrationRecord:
    camera = replace(record.results.camera, statistics=statistics)
    return replace(record, results=replace(record.results, camera=camera))


def test_what_is_left_of_a_view_is_the_noise_of_its_corners(record: CalibrationRecord) -> None:
    views = view_residuals(record.inputs, record.results.camera)
    assert [view.name for view in views] == [f"station {i}" for i in range(16)]
    square_sum = sum((view.residuals_px**2).sum() for view in views) / SIGMA_PX**2
    dof = sum(2 * len(view.uv_px) - 6 for view in views)
    assert chi2.ppf(0.001, dof) < square_sum < chi2.ppf(0.999, dof)
    assert not any(view.is_outlier.any() for view in views)


def test_a_flat_board_does_not_explain_a_bowed_one(record: CalibrationRecord) -> None:
    flat = replace(record.results.camera, bow_m=np.zeros(3))
    views = view_residuals(record.inputs, flat)
    assert np.mean([(view.residuals_px**2).mean() for view in views]) > 2 * SIGMA_PX**2


def test_outliers_are_marked_in_the_order_of_the_solution(record: CalibrationRecord) -> None:
    stations = record.inputs.hand_eye.stations
    free = IntrinsicsInput(
        measured_utc="2026-01-02T03:00:00Z",
        pattern=PATTERN,
        nominal=record.inputs.hand_eye.nominal,
        views=[station.view for station in stations[:2]],
    )
    inputs = record.inputs.with_parts(intrinsics=free)
    corner = stations[3].view.corner_ids[5]
    camera = with_camera_statistics(
        record, outlier_views=[17], outlier_corners=[[3, corner]]
    ).results.camera
    views = view_residuals(inputs, camera)
    assert [view.name for view in views[-2:]] == ["view 0", "view 1"]
    assert views[17].is_outlier.all()
    assert np.flatnonzero(views[3].is_outlier).tolist() == [5]
    assert sum(view.is_outlier.any() for view in views) == 2


def test_views_of_another_board_say_nothing_of_this_camera(record: CalibrationRecord) -> None:
    other = IntrinsicsInput(
        measured_utc="2026-01-02T03:00:00Z",
        pattern=PATTERN.model_copy(update={"rows": 9}),
        nominal=record.inputs.hand_eye.nominal,
        views=[],
    )
    inputs = record.inputs.with_parts(intrinsics=other)
    assert len(view_residuals(inputs, record.results.camera)) == 16


@pytest.mark.parametrize("tracker_noise", [1.0, 0.01], ids=["usual", "images alone"])
def test_gaps_between_tracker_and_images_are_as_large_as_their_covariance(
    tracker_noise: float,
) -> None:
    record = true_record(tracker_noise)
    stations = station_gaps(record.inputs, record.results)
    assert stations is not None
    chi_square = sum(
        gap @ np.linalg.solve(covariance, gap)
        for gap, covariance in zip(stations.gaps, stations.covariances, strict=True)
    )
    assert chi2.ppf(0.001, 6 * 16) < chi_square < chi2.ppf(0.999, 6 * 16)


def test_stations_left_out_are_marked(record: CalibrationRecord) -> None:
    hand_eye = record.results.hand_eye
    left_out = replace(hand_eye, statistics={**hand_eye.statistics, "outlier_stations": [2]})
    stations = station_gaps(record.inputs, replace(record.results, hand_eye=left_out))
    assert stations is not None
    assert np.flatnonzero(stations.is_outlier).tolist() == [2]


def test_without_stations_there_are_no_gaps_and_no_residuals(record: CalibrationRecord) -> None:
    inputs = record.inputs.with_parts(hand_eye=None)
    assert station_gaps(inputs, record.results) is None
    assert view_residuals(inputs, record.results.camera) == ()
