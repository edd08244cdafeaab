"""Feature names and limits, on the node maps of cameras old and new that exist only as XML."""

import pytest

pytest.importorskip("genicam", reason="needs the extra 'lab'")

from genicam.genapi import NodeMap

from drivers.gige.features import EXPOSURE, FRAME_RATE, GAIN, WIDTH, Features
from drivers.gige.options import Region
from drivers.gige.region import read_out
from tronlab.errors import LimitError

HEAD = """<?xml version="1.0" encoding="utf-8"?>
<RegisterDescription ModelName="m" VendorName="v" ToolTip="" StandardNameSpace="None"
 SchemaMajorVersion="1" SchemaMinorVersion="1" SchemaSubMinorVersion="0" MajorVersion="1"
 MinorVersion="0" SubMinorVersion="0" ProductGuid="1F9B5E2E-0000-0000-0000-000000000001"
 VersionGuid="1F9B5E2E-0000-0000-0000-000000000002"
 xmlns="http://www.genicam.org/GenApi/Version_1_1"><Category Name="Root"/>"""


def floating(name: str, value: float, low: float, high: float, *, step: float | None = None) -> str:
    inc = "" if step is None else f"<Inc>{step}</Inc>"
    return (
        f'<Float Name="{name}"><Value>{value}</Value><Min>{low}</Min><Max>{high}</Max>{inc}</Float>'
    )


def whole(name: str, value: int, low: int, high: int, *, step: int = 1) -> str:
    return (
        f'<Integer Name="{name}"><Value>{value}</Value>'
        f"<Min>{low}</Min><Max>{high}</Max><Inc>{step}</Inc></Integer>"
    )


def choice(name: str, *entries: str) -> str:
    listed = "".join(
        f'<EnumEntry Name="{entry}"><Value>{i}</Value></EnumEntry>'
        for i, entry in enumerate(entries)
    )
    return f'<Enumeration Name="{name}">{listed}<Value>0</Value></Enumeration>'


def features_of(*nodes: str) -> Features:
    node_map = NodeMap()
    node_map.load_xml_from_string(HEAD + "".join(nodes) + "</RegisterDescription>")
    features = Features(node_map, device="here")
    return features


@pytest.fixture
def old() -> Features:
    """A camera older than SFNC 2, as the Prosilica GC1380H."""
    return features_of(
        floating("ExposureTimeAbs", 15000, 10, 6e7),
        whole("GainRaw", 0, 0, 33),
        floating("AcquisitionFrameRateAbs", 20, 0.1, 20.4),
        whole("Width", 1360, 16, 1360, step=8),
        whole("Height", 1024, 1, 1024),
        whole("OffsetX", 8, 0, 1344),
        whole("OffsetY", 0, 0, 1023),
        choice("PixelFormat", "Mono8", "Mono12", "Mono12Packed"),
        choice("GainAuto", "Continuous", "Off"),
        '<String Name="DeviceID"><Value>02-2110A-06179</Value></String>',
    )


@pytest.fixture
def new() -> Features:
    """A camera of SFNC 2."""
    return features_of(
        floating("ExposureTime", 15000, 20, 1e6, step=5),
        floating("Gain", 0, 0, 24, step=0.1),
        '<Boolean Name="AcquisitionFrameRateEnable"><Value>0</Value></Boolean>',
        whole("Width", 640, 64, 640),
        whole("Height", 480, 64, 480),
        '<String Name="DeviceSerialNumber"><Value>  77 </Value></String>',
        '<String Name="DeviceID"><Value>not the serial</Value></String>',
    )


def test_one_quantity_has_several_names(old: Features, new: Features):
    for camera in (old, new):
        camera.set_number(EXPOSURE, 0.02, call="configure")
        camera.set_number(GAIN, 6, call="configure")
        assert camera.number(EXPOSURE, call="x") == pytest.approx(0.02)
        assert camera.number(GAIN, call="x") == 6
    assert old.text("serial number") == "02-2110A-06179"
    assert new.text("serial number") == "77"


def test_camera_without_a_feature_says_so(new: Features):
    assert not new.has("software trigger")
    assert new.text("firmware") == ""
    names = r"AcquisitionFrameRate or AcquisitionFrameRateAbs"
    with pytest.raises(
        LimitError, match=rf"^here: stream: this camera has no frame rate \({names}"
    ):
        new.set_number(FRAME_RATE, 20, call="stream")


@pytest.mark.parametrize("exposure_s", [9e-6, 60.001, -1.0])
def test_number_out_of_range_is_refused_with_the_range(old: Features, exposure_s: float):
    with pytest.raises(
        LimitError, match=r"^here: configure: exposure is .* allowed 1e-05 s to 60 s"
    ):
        old.set_number(EXPOSURE, exposure_s, call="configure")
    assert old.number(EXPOSURE, call="x") == pytest.approx(0.015)


def test_limits_themselves_are_allowed(old: Features):
    for exposure_s in (1e-5, 60.0):
        old.set_number(EXPOSURE, exposure_s, call="configure")
        assert old.number(EXPOSURE, call="x") == pytest.approx(exposure_s)


def test_whole_numbers_are_not_rounded(old: Features):
    with pytest.raises(LimitError, match=r"gain is 1.5 dB, allowed 0 dB to 33 dB in steps of 1 dB"):
        old.set_number(GAIN, 1.5, call="configure")
    with pytest.raises(
        LimitError, match=r"width is 1001 px, allowed 16 px to 1360 px in steps of 8"
    ):
        old.set_number(WIDTH, 1001, call="connect")


def test_value_the_camera_makes_another_of_is_refused():
    stubborn = features_of(
        '<Float Name="ExposureTime"><pValue>Kept</pValue><Min>20</Min><Max>1e6</Max></Float>',
        '<Converter Name="Kept"><FormulaTo>5000</FormulaTo><FormulaFrom>TO</FormulaFrom>'
        "<pValue>Store</pValue><Slope>Varying</Slope></Converter>",
        '<Float Name="Store"><Value>5000</Value></Float>',
    )
    with pytest.raises(
        LimitError, match=r"exposure is 0.02 s, allowed .*; the camera made 0.005 s"
    ):
        stubborn.set_number(EXPOSURE, 0.02, call="configure")


def test_choices_are_listed(old: Features):
    old.choose("pixel format", "Mono12", call="configure")
    assert old.text("pixel format") == "Mono12"
    with pytest.raises(
        LimitError, match=r"pixel format is 'BayerRG8', allowed Mono8, Mono12, Mono12Packed$"
    ):
        old.choose("pixel format", "BayerRG8", call="configure")


def test_automatics_are_switched_off_where_there_are_any(old: Features, new: Features):
    assert old.text("GainAuto") == "Continuous"
    old.neutralise()
    new.neutralise()
    assert old.text("GainAuto") == "Off"


def test_region_is_read_out(old: Features):
    region = Region(left_px=168, top_px=7, width_px=1024, height_px=1000)
    read_out(region, old, call="connect")
    numbers = [old.integer(name, call="x") for name in ("OffsetX", "OffsetY", "Width", "Height")]
    assert numbers == [168, 7, 1024, 1000]


def test_whole_sensor_is_read_out_by_default(old: Features, new: Features):
    for camera, size in ((old, (1360, 1024)), (new, (640, 480))):
        read_out(None, camera, call="connect")
        assert tuple(camera.integer(name, call="x") for name in ("Width", "Height")) == size
    assert old.integer("OffsetX", call="x") == 0


def test_region_that_is_not_on_the_sensor_is_refused(old: Features, new: Features):
    with pytest.raises(LimitError, match=r"height is 1025 px, allowed 1 px to 1024 px"):
        read_out(Region(left_px=0, top_px=0, width_px=16, height_px=1025), old, call="connect")
    with pytest.raises(LimitError, match=r"this camera has no left column \(OffsetX\)"):
        read_out(Region(left_px=8, top_px=0, width_px=64, height_px=64), new, call="connect")
