"""CESAPI, a client that others wrote for trackers of this protocol, drives the simulated one."""

import struct
from types import SimpleNamespace

import pytest

packet = pytest.importorskip("CESAPI.packet", reason="needs CESAPI (pip install 'tronlab[test]')")
from CESAPI.command import CommandSync  # noqa: E402
from CESAPI.connection import Connection  # noqa: E402


@pytest.fixture
def tracker(rig, monkeypatch):
    """CESAPI's connection; only its pauses of 0.2 s a packet are left out."""
    monkeypatch.setattr("CESAPI.connection.time", SimpleNamespace(sleep=lambda _: None))
    rig.client.close()
    connection = Connection()
    connection.connect(host=rig.server.address[0], port=rig.server.address[1])
    yield CommandSync(connection)
    rig.server.close()  # or its reader waits another second for data
    connection.disconnect()


def units(length: int, angle: int):
    data = packet.SystemUnitsDataT()
    data.lenUnitType, data.angUnitType = length, angle
    data.tempUnitType = data.pressUnitType = data.humUnitType = 0
    return data


def stationary_mode(time_ms: int):
    data = packet.StationaryModeDataT()
    data.lMeasTime, data.bUseADM = time_ms, 1
    return data


def name_of(text: bytes) -> str:
    return text.decode("utf-16-le").rstrip("\0")


def test_a_whole_session(rig, tracker):
    status = tracker.GetSystemStatus()
    assert status.lTrackerSerialNumber == rig.scene.serial
    assert status.trackerProcessorStatus == packet.ES_TPS_Booted
    tracker.SetUnits(units(packet.ES_LU_Millimeter, packet.ES_AU_Degree))
    assert tracker.GetUnits().unitsSettings.lenUnitType == packet.ES_LU_Millimeter
    tracker.Initialize()
    assert tracker.GetSystemStatus().trackerProcessorStatus == packet.ES_TPS_Initialized
    tracker.SetCoordinateSystemType(packet.ES_CS_RHR)
    settings = tracker.GetSystemSettings().systemSettings
    settings.weatherMonitorStatus = 2
    tracker.SetSystemSettings(settings)
    tracker.SetReflector(7)
    assert tracker.GetReflector().iInternalReflectorId == 7
    tracker.SetMeasurementMode(packet.ES_MM_Stationary)
    tracker.SetStationaryModeParams(stationary_mode(100))
    search = packet.SearchParamsDataT()
    search.dSearchRadius, search.lTimeOut = 50.0, 5000
    tracker.SetSearchParams(search)
    x, y, z = 1000.0 * rig.scene.reflectors["top_left"]
    tracker.PointLaser(x + 5.0, y, z)
    tracker.FindReflector(3800.0)
    result = tracker.StartMeasurement()
    assert isinstance(result, packet.SingleMeasResultT)
    assert (result.dVal1, result.dVal2, result.dVal3) == pytest.approx((x, y, z), abs=0.1)
    assert (result.dStd1, result.dStd2, result.dStd3) == pytest.approx((0.015,) * 3)
    assert result.dTemperature == pytest.approx(21.5)
    assert result.dPressure == pytest.approx(987.0)
    assert result.dHumidity == pytest.approx(41.0)


def test_extended_result(rig, tracker):
    tracker.SetUnits(units(packet.ES_LU_Meter, packet.ES_AU_Radian))
    tracker.Initialize()
    tracker.SetReflector(7)
    tracker.SetStationaryModeParams(stationary_mode(100))
    tracker.SetStatisticMode(0, 1)
    statistics = tracker.GetStatisticMode()
    assert statistics.stationaryMeasurements == 1
    tracker.GoPosition(1, *rig.scene.reflectors["lamp"])
    result = tracker.StartMeasurement()
    assert isinstance(result, packet.SingleMeasResult2T)
    assert result.dVal1 == pytest.approx(rig.scene.reflectors["lamp"][0], abs=1e-4)
    assert (result.dStd1, result.dStd2, result.dStd3) == pytest.approx((15e-6,) * 3)
    assert result.dAprioriStdTotal == pytest.approx(15e-6 * 3**0.5)
    assert result.dHumidity == pytest.approx(50.0)


def test_identity(rig, tracker):
    info = tracker.GetTrackerInfo()
    assert info.trackerType == 14
    assert name_of(info.cTrackerName) == "AT901-MR"
    assert info.lSerialNumber == rig.scene.serial
    assert info.iNumberOfFaces == 2
    assert name_of(tracker.GetSystemSoftwareVersion().cSoftwareVersion) == "3.6.0"
    assert tracker.GetTPInfo().laserTrackerSensorType == 14
    assert tracker.GetMeteoStationInfo().meteoStationType == 1


def test_environment_and_refraction(tracker):
    tracker.SetUnits(units(packet.ES_LU_Meter, packet.ES_AU_Radian))
    environment = packet.EnvironmentDataT()
    environment.dTemperature, environment.dPressure, environment.dHumidity = 19.0, 1001.0, 33.0
    tracker.SetEnvironmentParams(environment)
    assert tracker.GetEnvironmentParams().environmentData.dPressure == pytest.approx(1001.0)
    assert tracker.GetRefractionParams().refractionData.dIfmRefractionIndex > 1.00026


def test_nivel_and_direction(rig, tracker):
    tracker.SetUnits(units(packet.ES_LU_Meter, packet.ES_AU_Radian))
    tracker.Initialize()
    tracker.StartNivelMeasurement()
    assert abs(tracker.nivel_measurement.dXTilt) < 2e-4
    assert tracker.GetFace().trackerFace == 1
    tracker.ChangeFace()
    assert tracker.GetFace().trackerFace == 2


def test_errors_are_errors_to_it(tracker):
    with pytest.raises(Exception, match="failed with status 39"):
        tracker.StartMeasurement()


def test_beam_break_is_an_error_to_it(rig, tracker):
    tracker.SetUnits(units(packet.ES_LU_Meter, packet.ES_AU_Radian))
    tracker.Initialize()
    tracker.GoPosition(1, *rig.scene.reflectors["lamp"])
    tracker.SetStationaryModeParams(stationary_mode(100))
    rig.faults.arm("tracker.beam_breaks", times=1)
    with pytest.raises(Exception, match="Command 64 failed with status 701"):
        tracker.StartMeasurement()


@pytest.mark.parametrize(
    ("request_class", "fields", "reply_class"),
    [
        ("GetCompensationsCT", {}, "GetCompensationsRT"),
        ("GetCompensations2CT", {}, "GetCompensations2RT"),
        ("GetReflectorsCT", {}, "GetReflectorsRT"),
        ("GetStationOrientationParamsCT", {}, "GetStationOrientationParamsRT"),
        ("GetTransformationParamsCT", {}, "GetTransformationParamsRT"),
        ("GetSearchParamsCT", {}, "GetSearchParamsRT"),
        ("GetStationaryModeParamsCT", {}, "GetStationaryModeParamsRT"),
        ("GetMeasurementStatusInfoCT", {}, "GetMeasurementStatusInfoRT"),
        ("GetLongSystemParamCT", {"systemParam": 10}, "GetLongSystemParamRT"),
        ("GetDoubleSystemParamCT", {"systemParam": 1101}, "GetDoubleSystemParamRT"),
        ("ClearCommandQueueCT", {"clearQueueType": 1}, "ClearCommandQueueRT"),
    ],
)
def test_replies_are_what_its_classes_write(rig, request_class, fields, reply_class):
    """Reading a reply into CESAPI's class and writing it again gives the same bytes."""
    request = getattr(packet, request_class)()
    for name, value in fields.items():
        setattr(request, name, value)
    rig.client.send(request.pack())
    data = rig.client.receive().data
    reply = packet.PacketFactory().packet(data)
    assert type(reply).__name__ == reply_class
    assert reply.pack() == data
    assert struct.unpack_from("<I", data, 12) == (0,)
