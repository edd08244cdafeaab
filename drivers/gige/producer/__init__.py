"""The project's own GenTL producer: GigE Vision cameras without a vendor's software.

The library is written in C and built when tronlab is installed. Environment variables steer it:

``TRONLAB_GEV_INTERFACES``
    Where to look for cameras, separated by commas: names of network interfaces and addresses
    ``A.B.C.D[:PORT]`` of cameras. Default ``lo``. Nothing else is ever sent a packet. Read each
    time the consumer updates its list of interfaces.
``TRONLAB_GEV_PACKET_SIZE``
    Packet size in bytes, IP header included (GevSCPSPacketSize). Default: the largest of 8228, 1500
    and 576 whose test packet arrives when the camera is opened, else what the camera has.

A device's id is ``SERIAL@A.B.C.D:PORT``, an interface's is its entry in the list.
"""

from pathlib import Path

_LIBRARY = Path(__file__).with_name("tronlab_gev.cti")


def producer_path() -> Path | None:
    """Find the library for a GenTL consumer to load; None if it was not built."""
    return _LIBRARY if _LIBRARY.is_file() else None


def why_missing() -> str:
    """Say why the library is not there and what to do; empty if it is there."""
    if producer_path():
        return ""
    return (
        f"{_LIBRARY} is not there: tronlab was installed where it could not be compiled. "
        "On Linux, install a C compiler (Debian: apt install gcc libc6-dev) and install tronlab "
        "again, or run 'python hatch_build.py' in its source tree; or name another producer's "
        ".cti file, such as the camera vendor's"
    )
