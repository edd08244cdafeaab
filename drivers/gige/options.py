"""Options of the camera in a rig file, ``devices.camera.options``."""

from pathlib import Path
from typing import Annotated, Final, Self, TypeAlias

from pydantic import AfterValidator, Field, model_validator

from tronlab.yaml_models import Model

STANDARD_GVCP_PORT: Final = 3956
_PORTS: Final = range(1, 65536)
_BYTES: Final = range(256)


def camera_address(text: str) -> tuple[str, int]:
    """Read ``A.B.C.D[:PORT]``; without a port it is GigE Vision's own, 3956.

    Raises:
        ValueError: It is something else.
    """
    host, colon, port = text.partition(":")
    parts = host.split(".")
    is_host = len(parts) == 4 and all(_is_number(part, _BYTES) for part in parts)
    if not is_host or (colon and not _is_number(port, _PORTS)):
        raise ValueError(f"must be A.B.C.D or A.B.C.D:PORT, such as 192.168.2.20, got '{text}'")
    return host, int(port) if colon else STANDARD_GVCP_PORT


def _is_number(text: str, allowed: range) -> bool:
    return text.isascii() and text.isdecimal() and int(text) in allowed


def _checked_address(text: str) -> str:
    camera_address(text)
    return text


Address: TypeAlias = Annotated[str, AfterValidator(_checked_address)]
Name: TypeAlias = Annotated[str, Field(min_length=1)]


class Region(Model):
    """Part of the sensor that is read out."""

    left_px: Annotated[int, Field(ge=0)]
    """First column read out."""
    top_px: Annotated[int, Field(ge=0)]
    """First row read out."""
    width_px: Annotated[int, Field(gt=0)]
    """Columns read out."""
    height_px: Annotated[int, Field(gt=0)]
    """Rows read out."""


class CameraOptions(Model):
    """Which camera it is, and how it shall be read out."""

    serial: Name | None = None
    """Serial number of the camera, as on its label."""
    address: Address | None = None
    """IPv4 address of the camera, ``A.B.C.D`` or ``A.B.C.D:PORT``."""
    model: Name | None = None
    """Model name of the camera, where there is only one such."""
    interfaces: Annotated[tuple[Name, ...], Field(min_length=1)] = ("lo",)
    """Network interfaces on which our own producer looks for that serial number or model."""
    producer: Path | None = None
    """GenTL producer (.cti) of a vendor, relative to the rig file; by default our own."""
    region: Region | None = None
    """Part of the sensor that is read out; by default all of it."""
    is_packed: bool = False
    """Whether Mono12 travels as two pixels in three bytes (Mono12Packed); images are the same."""
    n_buffers: Annotated[int, Field(ge=2, le=256)] = 16
    """Frames the producer can hold while nobody fetches them."""
    packet_size_bytes: Annotated[int, Field(ge=576, le=16000)] | None = None
    """Size of the stream's IP packets, at most the network's MTU; by default the producer's."""
    frame_timeout_s: Annotated[float, Field(gt=0)] = 2.0
    """How long a stream waits for its next frame."""

    @model_validator(mode="after")
    def _camera_is_named_once(self) -> Self:
        given = [key for key in ("serial", "address", "model") if getattr(self, key) is not None]
        if len(given) != 1:
            raise ValueError(
                "give exactly one of serial, address and model to say which camera it is; "
                f"given: {', '.join(given) or 'none'}"
            )
        return self

    @model_validator(mode="after")
    def _interfaces_are_searched(self) -> Self:
        if "interfaces" in self.model_fields_set and self.address is not None:
            raise ValueError("interfaces are not searched when the address is given; remove them")
        if "interfaces" in self.model_fields_set and self.producer is not None:
            raise ValueError("interfaces are for our own producer only; remove them")
        return self
