"""Calibration pictures show the numbers they are made of."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.quiver import Quiver
from measured_record import PATTERN, measured_record

from tronlab.calib.budget import error_budget, sweep
from tronlab.calib.camera.view_residuals import ViewResiduals, view_residuals
from tronlab.calib.hand_eye.station_gaps import station_gaps
from tronlab.calib.inputs import Inputs
from tronlab.calib.record import CalibrationRecord
from tronlab.calib.results import Results
from tronlab.calib.solve import solve
from tronlab.report import calibration
from tronlab.report.calibration import save_budget, write_pictures
from tronlab.report.calibration_budget import budget_chart
from tronlab.report.calibration_charts import bow_chart, frame_chart, model_chart, station_chart
from tronlab.report.calibration_images import (
    GOOD_COLOUR,
    OUTLIER_COLOUR,
    coverage_picture,
    projection_picture,
    residual_picture,
)

pytestmark = pytest.mark.opencv

ALL = ["residuals", "coverage", "projection", "models", "bow", "stations", "frame", "budget"]


@pytest.fixture(scope="module")
def record() -> CalibrationRecord:
    measured = measured_record(seed=2, n_stations=12)
    solved = solve(measured.inputs)
    return replace(
        measured, results=replace(solved, lamp=measured.results.lamp, robot=measured.results.robot)
    )


@pytest.fixture(scope="module")
def views(record: CalibrationRecord) -> tuple[ViewResiduals, ...]:
    return view_residuals(record.inputs, record.results.camera)


def test_every_part_there_is_has_its_pictures(record: CalibrationRecord, tmp_path) -> None:
    paths = write_pictures(record, tmp_path / "new" / "pictures")
    assert [path.stem for path in paths] == ALL
    for path in paths:
        assert path.read_bytes().startswith(b"\x89PNG")
        assert path.with_suffix(".pdf").is_file()


def test_parts_that_are_not_there_are_not_drawn(
    record: CalibrationRecord, tmp_path, monkeypatch
) -> None:
    monkeypatch.setattr(calibration, "save_chart", lambda _, folder, stem: folder / f"{stem}.png")
    only_frame = replace(
        record,
        results=Results(frame=record.results.frame),
        inputs=Inputs(frame=record.inputs.frame),
    )
    assert [path.stem for path in write_pictures(only_frame, tmp_path)] == ["frame"]
    only_camera = replace(
        record,
        results=replace(record.results, frame=None, hand_eye=None),
        inputs=record.inputs.with_parts(frame=None),
    )
    assert [path.stem for path in write_pictures(only_camera, tmp_path)] == ALL[:5]
    nothing = replace(record, results=Results(), inputs=Inputs())
    assert write_pictures(nothing, tmp_path) == []


def test_arrows_are_the_residuals_and_outliers_have_their_own_colour(
    record: CalibrationRecord, views: tuple[ViewResiduals, ...]
) -> None:
    is_outlier = np.zeros(len(views[0].uv_px), dtype=bool)
    is_outlier[3] = True
    marked = (replace(views[0], is_outlier=is_outlier), *views[1:])
    (axes,) = residual_picture(record.camera, marked).axes
    good, outliers = (item for item in axes.get_children() if isinstance(item, Quiver))
    assert len(good.U) == sum(len(view.uv_px) for view in views) - 1
    np.testing.assert_allclose(outliers.XY, views[0].uv_px[[3]])
    np.testing.assert_allclose([outliers.U[0], outliers.V[0]], views[0].residuals_px[3])
    colours = [to_hex(arrows.get_facecolor()[0]) for arrows in (good, outliers)]
    assert colours == [GOOD_COLOUR, OUTLIER_COLOUR]
    assert axes.get_ylim()[0] > axes.get_ylim()[1]


def test_fields_show_how_many_corners_they_have(
    record: CalibrationRecord, views: tuple[ViewResiduals, ...]
) -> None:
    axes = coverage_picture(record.camera, views).axes[0]
    counts = [int(text.get_text()) for text in axes.texts]
    assert sum(counts) == sum(len(view.uv_px) for view in views)
    share = np.mean(np.array(counts) > 0)
    assert axes.get_title(loc="left") == f"Coverage: {share:.0%} of the image has corners"


def test_the_uncertainty_of_projection_is_drawn_in_pixels(
    record: CalibrationRecord, views: tuple[ViewResiduals, ...]
) -> None:
    axes, bar = projection_picture(record.results.camera, views).axes
    assert bar.get_ylabel() == "one sigma of a coordinate [px]"
    assert len(axes.lines) == len(views)


def test_the_chosen_model_stands_out(record: CalibrationRecord) -> None:
    (axes,) = model_chart(record.results.camera).axes
    rows = record.results.camera.statistics["models"]
    drawn = {
        label.get_text(): to_hex(container.lines[0].get_color())
        for label, container in zip(axes.get_yticklabels(), axes.containers, strict=True)
    }
    assert len(drawn) == len(rows)
    (chosen,) = [name for name, colour in drawn.items() if colour == GOOD_COLOUR]
    assert chosen.startswith(f"{record.results.camera.model}, bow free")


def test_stations_are_drawn_with_what_is_expected_and_outliers_marked(
    record: CalibrationRecord,
) -> None:
    stations = station_gaps(record.inputs, record.results)
    assert stations is not None
    far = stations.gaps.copy()
    far[4] *= 100
    marked = replace(stations, gaps=far, is_outlier=np.arange(12) == 4)
    figure = station_chart(marked, record.results.hand_eye)
    place, turn = figure.axes
    np.testing.assert_allclose(place.lines[0].get_ydata(), 1e3 * far[:, 3])
    np.testing.assert_allclose(turn.lines[2].get_ydata(), 1e3 * np.degrees(far[:, 2]))
    assert [text.get_text() for text in place.texts] == ["left out"]
    assert place.get_ylim()[1] < 1e3 * np.abs(far[4, 3:]).max()
    assert "stations held out are predicted to 0." in figure.get_suptitle()


def test_lengths_have_the_trackers_own_uncertainty(record: CalibrationRecord) -> None:
    frame = record.results.frame
    plan, lengths = frame_chart(record.inputs.frame, frame).axes
    errors_mm = [1e3 * error for error in frame.statistics["length_errors_m"].values()]
    np.testing.assert_allclose([bar.get_width() for bar in lengths.patches], errors_mm)
    segments = lengths.collections[0].get_segments()
    halves_mm = [np.ptp(segment[:, 0]) / 2 for segment in segments]
    points = record.inputs.frame.points
    sigmas_m = [np.sqrt(points[name].covariance_m2[0][0]) for name in points]
    assert halves_mm[0] == pytest.approx(1e3 * np.hypot(sigmas_m[0], sigmas_m[1]))
    assert [text.get_text().split("\n")[0] for text in plan.texts if text.get_text()] == list(
        points
    )


def test_the_bow_is_told_with_its_sigma(record: CalibrationRecord) -> None:
    axes = bow_chart(PATTERN, record.results.camera).axes[0]
    title = axes.get_title(loc="left")
    sag_mm = 1e3 * record.results.camera.bow_m[0]
    assert f"sag x {sag_mm:+.3f} ± 0.0" in title
    flat = replace(record.results.camera, bow_m=np.zeros(3))
    assert "taken as flat" in bow_chart(PATTERN, flat).axes[0].get_title(loc="left")


def test_a_budget_is_drawn_against_range(record: CalibrationRecord, tmp_path) -> None:
    budget = error_budget(record, sweep(record)[::-1])
    figure = budget_chart(budget)
    curves = figure.axes[0]
    np.testing.assert_allclose(curves.lines[0].get_xdata(), np.arange(5, 51) / 10)
    total = next(line for line in curves.lines if line.get_label() == "all of them")
    np.testing.assert_allclose(total.get_ydata(), 1e3 * budget.total_position_m[::-1])
    assert save_budget(budget, tmp_path).name == "budget.png"


def test_poses_of_one_range_are_drawn_by_their_number(record: CalibrationRecord) -> None:
    (pose,) = sweep(record)[:1]
    beside = budget_chart(error_budget(record, [pose, pose, pose])).axes[0]
    np.testing.assert_array_equal(beside.lines[0].get_xdata(), [1, 2, 3])
    alone = budget_chart(error_budget(record, [pose]))
    assert alone.axes[0].lines[0].get_marker() == "o"
    assert sum(bar.get_height() for bar in alone.axes[1].patches) == pytest.approx(100.0)
