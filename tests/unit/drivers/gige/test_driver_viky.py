"""The driver on the one producer that comes with genicam: simulated cameras without a network."""

import os
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("genicam", reason="needs the extra 'lab'")

import genicam

from drivers.gige.driver import open_camera
from tronlab.devices.registry import DeviceContext
from tronlab.errors import LimitError, NotConnectedError

VIKY = Path(genicam.__file__).parent / "viky.cti"


def make(**options: object):
    context = DeviceContext(
        name="here", options={"producer": str(VIKY), **options}, seed=0, world=None
    )
    return open_camera(context)


@pytest.fixture
def camera():
    camera = make(serial="1")
    yield camera
    camera.close()


def frames_of(camera, n: int):
    """Give frames below the driver's own calls: viky has neither exposure nor trigger."""
    connection = camera._connected("test")
    connection.start()
    for _ in range(n):
        frame = connection.wait_for_frame(until_s=time.monotonic() + 5.0, call="test")
        assert frame is not None
        yield frame
    connection.stop()


def test_identity_is_what_discovery_said_where_the_camera_has_no_feature_for_it(camera):
    camera.connect()
    identity = camera.identify()
    assert (identity.model, identity.serial) == ("Viky", "1")


def test_frames_come_in_the_size_of_the_whole_sensor(camera):
    camera.connect()
    frames = list(frames_of(camera, 3))
    assert [frame.image.shape for frame in frames] == [(800, 800)] * 3
    assert [frame.image.dtype for frame in frames] == [np.uint8] * 3
    assert np.diff([frame.block_id for frame in frames]).tolist() == [1, 1]
    assert all(frame.image.any() for frame in frames)
    assert {frame.device_time_s for frame in frames} == {None}  # viky has no clock


def test_region_is_set_before_the_buffers_are_made():
    camera = make(serial="0", region={"left_px": 0, "top_px": 0, "width_px": 320, "height_px": 200})
    camera.connect()
    (frame,) = frames_of(camera, 1)
    camera.close()
    assert frame.image.shape == (200, 320)


def test_what_the_camera_cannot_do_is_said(camera):
    camera.connect()
    with pytest.raises(LimitError, match=r"^here: grab: this camera has no trigger source"):
        camera.grab(timeout_s=1.0)
    with pytest.raises(LimitError, match=r"pixel format is 'Mono12', allowed RGBa8, Mono8"):
        camera.configure(exposure_s=0.01, gain_db=0.0, pixel_format="Mono12")
    with pytest.raises(LimitError, match=r"pixel format is 'Bayer', allowed Mono8, Mono12"):
        camera.configure(exposure_s=0.01, gain_db=0.0, pixel_format="Bayer")
    with pytest.raises(LimitError, match=r"no exposure \(ExposureTime or ExposureTimeAbs\)"):
        camera.configure(exposure_s=0.01, gain_db=0.0, pixel_format="Mono8")


def test_cameras_that_answered_are_listed_if_none_is_meant():
    listed = "; ".join(rf"Viky, serial {i}, id VikyTL_DEV_\w+" for i in range(3))
    with pytest.raises(
        NotConnectedError, match=rf"no camera with serial '7' answers.*found: {listed}\."
    ):
        make(serial="7").connect()


def test_several_cameras_of_one_model_are_refused():
    with pytest.raises(NotConnectedError, match=r"3 cameras have model 'Viky'.*Say which"):
        make(model="Viky").connect()


def test_address_is_unknown_to_a_producer_without_addresses():
    with pytest.raises(NotConnectedError, match=r"no camera with address '127\.0\.0\.1' answers"):
        make(address="127.0.0.1").connect()


def test_vendor_producer_serves_one_camera_a_process(camera):
    camera.connect()
    second = make(serial="2")
    with pytest.raises(NotConnectedError, match=r"'here' uses the producer .*viky\.cti"):
        second.connect()
    camera.close()
    second.connect()
    assert second.identify().serial == "2"
    second.close()


@pytest.mark.parametrize(
    ("producer", "message"),
    [
        ("/nowhere/x.cti", r"no GenTL producer /nowhere/x\.cti; correct the option 'producer'"),
        (__file__, r"test_driver_viky\.py cannot be used \(.*invalid ELF header"),
    ],
)
def test_file_that_is_no_producer_is_named(producer: str, message: str):
    with pytest.raises(NotConnectedError, match=message):
        make(serial="1", producer=producer).connect()


def test_missing_producer_of_our_own_is_said_with_what_to_do(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("drivers.gige.producers.producer_path", lambda: None)
    monkeypatch.setattr("drivers.gige.producers.why_missing", lambda: "no compiler; install one")
    camera = open_camera(
        DeviceContext(name="here", options={"address": "127.0.0.1"}, seed=0, world=None)
    )
    with pytest.raises(NotConnectedError, match=r"our own GenTL producer .*no compiler; install"):
        camera.connect()


def test_calls_before_connect_are_refused(camera):
    for call in ("identify", "configure", "grab", "stream"):
        arguments = {
            "configure": {"exposure_s": 0.01, "gain_db": 0.0, "pixel_format": "Mono8"},
            "grab": {"timeout_s": 1.0},
        }.get(call, {})
        with pytest.raises(NotConnectedError, match=rf"^here: {call}: not connected"):
            getattr(camera, call)(**arguments)


def test_interrupts_stay_with_the_program(camera):
    before = signal.getsignal(signal.SIGINT)
    camera.connect()
    assert signal.getsignal(signal.SIGINT) is before


def test_nothing_is_left_after_close(camera):
    camera.connect()  # loads what is loaded once
    camera.close()
    before = threading.active_count(), len(os.listdir("/proc/self/fd"))
    for _ in range(5):
        camera.connect()
        list(frames_of(camera, 1))
        camera.close()
        camera.close()
    assert (threading.active_count(), len(os.listdir("/proc/self/fd"))) == before
