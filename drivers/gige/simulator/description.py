"""The camera described to applications: GenICam XML, zipped, as it lies in the camera's memory."""

import io
import zipfile
from collections.abc import Iterable
from typing import Final
from xml.etree import ElementTree as ET

from drivers.gige.simulator.bootstrap import (
    LARGEST_PACKET,
    LATCH_TIMESTAMP,
    RESET_TIMESTAMP,
    SMALLEST_PACKET,
    Bootstrap,
)
from drivers.gige.simulator.features import (
    Access,
    Action,
    Enumeration,
    Feature,
    Integer,
    Real,
    Switch,
)

ADDRESS: Final = 0x30000
"""Where the zipped description begins."""

_FILE: Final = "tronlab_gc1380h"
_NAMESPACE: Final = "http://www.genicam.org/GenApi/Version_1_1"
_SCHEMA: Final = f"{_NAMESPACE} http://www.genicam.org/GenApi/GenApiSchema_Version_1_1.xsd"
_NOT_SIMULATED: Final = "NotSimulated"
_ZIP_TIME: Final = (1980, 1, 1, 0, 0, 0)  # one description gives one archive


def url(archive: bytes) -> str:
    """Give the URL an application finds the description by."""
    return f"Local:{_FILE}.zip;{ADDRESS:x};{len(archive):x}"


def zipped(xml: bytes) -> bytes:
    """Pack the description."""
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr(zipfile.ZipInfo(f"{_FILE}.xml", _ZIP_TIME), xml, zipfile.ZIP_DEFLATED)
    return archive.getvalue()


def describe(features: Iterable[Feature]) -> bytes:
    """Write the GenICam XML (schema 1.1) of a camera with these features.

    The features of the GigE Vision standard are added.
    """
    root = ET.Element(
        "RegisterDescription",
        {
            "ModelName": "GC1380H",
            "VendorName": "AVT",
            "ToolTip": "Simulated Prosilica GC1380H",
            "StandardNameSpace": "GEV",
            "SchemaMajorVersion": "1",
            "SchemaMinorVersion": "1",
            "SchemaSubMinorVersion": "0",
            "MajorVersion": "1",
            "MinorVersion": "0",
            "SubMinorVersion": "0",
            "ProductGuid": "5B0E9A5C-2F0C-4C7C-9E0B-6B7D2A6D1380",
            "VersionGuid": "9D3C77B2-8A35-4E0E-8A2B-30C6C1D91380",
            "xmlns": _NAMESPACE,
            "xmlns:xsi": "http://www.w3.org/2001/XMLSchema-instance",
            "xsi:schemaLocation": _SCHEMA,
        },
    )
    _Writer(root).write(tuple(features))
    ET.indent(root)
    return ET.tostring(root, encoding="utf-8", xml_declaration=True)


class _Writer:
    """Writes nodes, and remembers which category shows them."""

    def __init__(self, root: ET.Element) -> None:
        self._root = root
        self._shown: dict[str, list[str]] = {}

    def write(self, features: tuple[Feature, ...]) -> None:
        for feature in features:
            self._feature(feature)
        self._identification()
        self._transport_layer()
        self._categories()
        _texts(self._node("Integer", _NOT_SIMULATED), Value=0, Min=0, Max=0)
        self._node("Port", "Device")

    def _feature(self, feature: Feature) -> None:
        match feature:
            case Enumeration():
                self._enumeration(feature)
            case Action():
                self._command(feature.name, feature.category, feature.address)
            case Switch():
                node = self._shown_node("Boolean", feature.name, feature.category)
                _texts(node, pValue=self._register(feature), OnValue=1, OffValue=0)
            case Real():
                self._real(feature)
            case Integer():
                self._integer(feature)
            case _:
                raise TypeError(f"{feature.name}: no node for a {type(feature).__name__}")

    def _integer(self, feature: Integer) -> None:
        register = self._register(feature)
        high = self._highest(feature)
        node = self._shown_node("Integer", feature.name, feature.category)
        _texts(node, pValue=register, Min=feature.low, **high, Inc=1)
        if feature.unit:
            _texts(node, Unit=feature.unit)

    def _highest(self, feature: Integer) -> dict[str, int | str]:
        if not feature.high_formula:
            return {"Max": feature.high}
        limit = self._node("IntSwissKnife", f"{feature.name}Highest")
        for name in feature.high_formula.split(" - "):
            # The register, not the feature: its own limit would depend on this one in turn.
            ET.SubElement(limit, "pVariable", Name=name.upper()).text = f"{name}Register"
        _texts(limit, Formula=feature.high_formula.upper())
        return {"pMax": f"{feature.name}Highest"}

    def _real(self, feature: Real) -> None:
        register, scale = self._register(feature), feature.per_unit
        converter = self._node("Converter", f"{feature.name}Converter")
        _texts(
            converter,
            FormulaTo=f"FROM * {scale}",
            FormulaFrom=f"TO / {scale}.0",
            pValue=register,
            Slope="Increasing",
        )
        node = self._shown_node("Float", feature.name, feature.category)
        low, high = feature.low / scale, feature.high / scale
        _texts(node, pValue=f"{feature.name}Converter", Min=low, Max=high)
        if feature.unit:
            _texts(node, Unit=feature.unit)

    def _enumeration(self, feature: Enumeration) -> None:
        register = self._register(feature)
        node = self._shown_node("Enumeration", feature.name, feature.category)
        for name, value in feature.entries.items():
            entry = ET.SubElement(node, "EnumEntry", Name=name, NameSpace="Standard")
            if name in feature.refused:
                _texts(entry, pIsAvailable=_NOT_SIMULATED)
            _texts(entry, Value=value)
        _texts(node, pValue=register)

    def _command(self, name: str, category: str, address: int, value: int = 1) -> None:
        register = self._integer_register(f"{name}Register", address, 4, "WO")
        _texts(self._shown_node("Command", name, category), pValue=register, CommandValue=value)

    def _identification(self) -> None:
        for name, address, length, access in (
            ("DeviceVendorName", Bootstrap.VENDOR, 32, "RO"),
            ("DeviceModelName", Bootstrap.MODEL, 32, "RO"),
            ("DeviceFirmwareVersion", Bootstrap.DEVICE_VERSION, 32, "RO"),
            ("DeviceID", Bootstrap.SERIAL, 16, "RO"),
            ("DeviceUserID", Bootstrap.USER_NAME, 16, "RW"),
        ):
            node = self._shown_node("StringReg", name, "DeviceControl")
            _texts(node, Address=hex(address), Length=length, AccessMode=access, pPort="Device")

    def _transport_layer(self) -> None:
        category = "TransportLayerControl"
        self._packet_size(category)
        self._standard_integer("GevSCPD", category, Bootstrap.PACKET_DELAY, 4, "RW")
        self._standard_integer(
            "GevTimestampTickFrequency", category, Bootstrap.TICK_HZ_HIGH, 8, "RO"
        )
        self._standard_integer("GevTimestampValue", category, Bootstrap.TIMESTAMP_HIGH, 8, "RO")
        for name, value in (("Latch", LATCH_TIMESTAMP), ("Reset", RESET_TIMESTAMP)):
            self._command(
                f"GevTimestampControl{name}", category, Bootstrap.TIMESTAMP_CONTROL, value
            )

    def _standard_integer(
        self, name: str, category: str, address: int, length: int, access: Access
    ) -> None:
        register = self._integer_register(f"{name}Register", address, length, access)
        _texts(self._shown_node("Integer", name, category), pValue=register)

    def _packet_size(self, category: str) -> None:
        """Write the three features of one register; the standard counts its bits from the top."""
        size, test, whole = (
            self._bits(name, Bootstrap.PACKET_SIZE, first=first, last=last)
            for name, first, last in (
                ("GevSCPSPacketSize", 16, 31),
                ("GevSCPSFireTestPacket", 0, 0),
                ("GevSCPSDoNotFragment", 1, 1),
            )
        )
        node = self._shown_node("Integer", "GevSCPSPacketSize", category)
        _texts(node, pValue=size, Min=SMALLEST_PACKET, Max=LARGEST_PACKET, Inc=4, Unit="bytes")
        node = self._shown_node("Command", "GevSCPSFireTestPacket", category)
        _texts(node, pValue=test, CommandValue=1)
        node = self._shown_node("Boolean", "GevSCPSDoNotFragment", category)
        _texts(node, pValue=whole, OnValue=1, OffValue=0)

    def _bits(self, name: str, address: int, *, first: int, last: int) -> str:
        register = self._node("MaskedIntReg", f"{name}Register")
        _place(register, address, 4, "RW")
        _texts(register, LSB=last, MSB=first, Sign="Unsigned", Endianess="BigEndian")
        return f"{name}Register"

    def _categories(self) -> None:
        root = self._node("Category", "Root")
        for category, names in self._shown.items():
            ET.SubElement(root, "pFeature").text = category
            node = self._node("Category", category)
            for name in names:
                ET.SubElement(node, "pFeature").text = name

    def _register(self, feature: Feature) -> str:
        return self._integer_register(f"{feature.name}Register", feature.address, 4, feature.access)

    def _integer_register(self, name: str, address: int, length: int, access: Access) -> str:
        register = self._node("IntReg", name)
        _place(register, address, length, access)
        _texts(register, Sign="Unsigned", Endianess="BigEndian")
        return name

    def _shown_node(self, kind: str, name: str, category: str) -> ET.Element:
        self._shown.setdefault(category, []).append(name)
        return self._node(kind, name)

    def _node(self, kind: str, name: str) -> ET.Element:
        return ET.SubElement(self._root, kind, Name=name)


def _place(register: ET.Element, address: int, length: int, access: Access) -> None:
    _texts(
        register,
        Address=hex(address),
        Length=length,
        AccessMode=access,
        pPort="Device",
        Cachable="NoCache",
    )


def _texts(node: ET.Element, **texts: object) -> None:
    """Add child elements that hold one text each, in this order."""
    for tag, text in texts.items():
        ET.SubElement(node, tag).text = str(text)
