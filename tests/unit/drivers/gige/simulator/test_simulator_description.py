"""The camera's description, read by EMVA's own GenApi."""

import pytest

from drivers.gige.simulator import description
from drivers.gige.simulator.features import Model, features_of
from drivers.gige.simulator.gvcp import RefusedError
from drivers.gige.simulator.registers import Registers

genapi = pytest.importorskip("genicam.genapi", reason="needs genicam: pip install 'tronlab[lab]'")

READ_WRITE = """
    Width Height OffsetX OffsetY BinningHorizontal BinningVertical DecimationHorizontal
    DecimationVertical PixelFormat AcquisitionMode AcquisitionFrameCount AcquisitionFrameRateAbs
    TriggerSelector TriggerMode TriggerSource TriggerActivation TriggerOverlap TriggerDelayAbs
    ExposureMode ExposureAuto ExposureTimeAbs GainAuto GainRaw BlackLevel Gamma
    StreamBytesPerSecond BandwidthControlMode StreamFrameRateConstrain StreamHoldEnable
    GevSCPSPacketSize GevSCPD
"""
READ_ONLY = """
    SensorWidth SensorHeight WidthMax HeightMax ImageSize PayloadSize AcquisitionFrameRateLimit
    DeviceID DeviceVendorName DeviceModelName DeviceFirmwareVersion
    GevTimestampTickFrequency GevTimestampValue
"""
WRITE_ONLY = """
    AcquisitionStart AcquisitionStop AcquisitionAbort TriggerSoftware
    GevTimestampControlLatch GevTimestampControlReset
"""
ABSENT = "TLParamsLocked DeviceSerialNumber GevHeartbeatTimeout ExposureTime Gain PtpMode"
ENUMERATIONS = {
    "PixelFormat": {"Mono8": 0x01080001, "Mono12": 0x01100005, "Mono12Packed": 0x010C0006},
    "AcquisitionMode": {"Continuous": 1, "SingleFrame": 2, "MultiFrame": 3, "Recorder": 4},
    "ExposureMode": {"Timed": 1},
    "ExposureAuto": {"Off": 1, "Continuous": 2, "Once": 3, "Other": 4},
    "TriggerSelector": {
        "FrameStart": 0,
        "AcquisitionStart": 3,
        "AcquisitionEnd": 4,
        "AcquisitionRecord": 6,
    },
    "TriggerMode": {"Off": 0, "On": 1},
    "TriggerSource": {
        "Freerun": 0,
        "Line1": 1,
        "Line2": 2,
        "Line3": 3,
        "Line4": 4,
        "FixedRate": 5,
        "Software": 6,
    },
}


class Port(genapi.AbstractPort):
    """Registers without a wire."""

    def __init__(self, registers: Registers) -> None:
        super().__init__()
        self.registers = registers

    def get_access_mode(self):
        return genapi.EAccessMode.RW

    def read(self, address, length):
        return self.registers.memory.read(address, length)

    def write(self, address, data):
        self.registers.write(address, int.from_bytes(data), is_acquiring=False)


@pytest.fixture
def nodes():
    model = Model()
    node_map = genapi.NodeMap()
    node_map.load_xml_from_string(description.describe(features_of(model)).decode())
    node_map.connect(Port(Registers(model, host="127.0.0.1", source_port=1)), "Device")
    return node_map


@pytest.mark.parametrize(
    ("names", "access"), [(READ_WRITE, "RW"), (READ_ONLY, "RO"), (WRITE_ONLY, "WO")]
)
def test_every_feature_of_the_camera_is_there(nodes, names, access):
    found = {name: nodes.get_node(name).get_access_mode() for name in names.split()}
    assert found == dict.fromkeys(names.split(), getattr(genapi.EAccessMode, access))


def test_what_the_camera_lacks_is_not_there(nodes):
    assert [name for name in ABSENT.split() if nodes.has_node(name)] == []


@pytest.mark.parametrize("name", ENUMERATIONS)
def test_enumerations_have_the_numbers_of_the_camera(nodes, name):
    entries = {entry.symbolic: entry.value for entry in nodes.get_node(name).entries}
    assert entries == ENUMERATIONS[name]


def test_limits_follow_the_region(nodes):
    nodes.Width.value = 100
    nodes.OffsetX.value = 300
    assert (nodes.OffsetX.max, nodes.Width.max) == (1260, 1060)
    nodes.OffsetY.value = 0
    assert (nodes.OffsetY.max, nodes.Height.max) == (0, 1024)
    assert nodes.PayloadSize.value == 100 * 1024


def test_real_numbers_keep_their_unit(nodes):
    nodes.ExposureTimeAbs.value = 1234.0
    assert nodes.ExposureTimeAbs.value == 1234.0
    assert (nodes.ExposureTimeAbs.min, nodes.ExposureTimeAbs.max) == (10.0, 6.0e7)
    assert nodes.ExposureTimeAbs.unit == "us"
    nodes.AcquisitionFrameRateAbs.value = 19.998
    assert nodes.AcquisitionFrameRateAbs.value == 19.998
    assert nodes.Gamma.value == 1.0


def test_the_packet_size_leaves_the_other_bits_of_its_register(nodes):
    nodes.GevSCPSDoNotFragment.value = True
    nodes.GevSCPSPacketSize.value = 8228
    assert nodes.GevSCPSDoNotFragment.value
    nodes.GevSCPSPacketSize.value = 1500
    assert nodes.GevSCPSPacketSize.value == 1500


def test_what_is_not_simulated_cannot_be_chosen(nodes):
    for name, value in (("ExposureAuto", "Once"), ("AcquisitionMode", "Recorder")):
        with pytest.raises(genapi.GenericException):
            nodes.get_node(name).value = value


def test_limits_of_the_description_are_those_of_the_registers(nodes):
    registers = Registers(Model(), host="127.0.0.1", source_port=1)
    for name in ("Width", "GainRaw", "StreamBytesPerSecond", "AcquisitionFrameCount"):
        node = nodes.get_node(name)
        for value in (node.min, node.max):
            registers.write(address_of(name), value, is_acquiring=False)
        for value in (node.min - 1, node.max + 1):
            if value >= 0:
                with pytest.raises(RefusedError, match="INVALID_PARAMETER"):
                    registers.write(address_of(name), value, is_acquiring=False)


def address_of(name: str) -> int:
    return next(feature.address for feature in features_of(Model()) if feature.name == name)


def test_one_camera_gives_one_archive():
    archives = {description.zipped(description.describe(features_of(Model()))) for _ in range(2)}
    assert len(archives) == 1
