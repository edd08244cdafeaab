import pytest
from records import make_record, make_results

from tronlab.calib.inputs import CameraValues, Inputs, Setup, StationsInput
from tronlab.cli.calibration_verdict import verdict
from tronlab.devices.laboratory import PatternSpec
from tronlab.geometry.camera import CameraModel

CAMERA = CameraModel(width_px=9, height_px=9, fx_px=9.0, fy_px=9.0, cx_px=4.0, cy_px=4.0)


@pytest.mark.parametrize(
    ("setup", "found"), [("eye_in_hand", "tmac_from_cam"), ("eye_to_hand", "base_from_cam")]
)
def test_the_transform_is_named_by_where_the_camera_is(setup: Setup, found: str) -> None:
    stations = StationsInput(
        measured_utc="2026-01-02T03:00:00Z",
        pattern=PatternSpec(kind="chessboard", columns=5, rows=4, square_m=0.1),
        nominal=CameraValues.of(CAMERA),
        stations=(),
        setup=setup,
    )
    record = make_record(make_results(camera=CAMERA), inputs=Inputs(hand_eye=stations))
    assert f"hand-eye {found}" in verdict(record)
