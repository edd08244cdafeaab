"""GenTL producers, and finding a camera through one.

A process may initialise a producer once (GenTL standard 1.5, ``GCInitLib``). Our own producer is
one self-contained file, so every camera can have a copy of it to itself; a vendor's cannot be
copied and serves one camera of a process.
"""

import logging
import os
import shutil
import socket
import tempfile
import threading
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from weakref import WeakValueDictionary

from genicam import gentl
from harvesters.core import Harvester, ParameterKey, ParameterSet

from drivers.gige.faults import GENICAM_ERRORS, first_line
from drivers.gige.options import CameraOptions, camera_address
from drivers.gige.producer import producer_path, why_missing
from tronlab.errors import NotConnectedError

_INTERFACES_VARIABLE: Final = "TRONLAB_GEV_INTERFACES"
_DISCOVERY_MS: Final = 1000
_LOG = logging.getLogger(__name__)
_HARVESTERS_LOG = logging.getLogger(f"{__name__}.harvesters")
_HARVESTERS_LOG.setLevel(logging.CRITICAL)  # with tracebacks it says what is raised here anyway

_loading = threading.RLock()
"""Held while the environment says where to look, and while ``_in_use`` changes."""
_in_use: WeakValueDictionary[Path, "Producer"] = WeakValueDictionary()
"""Who uses a producer's own file in this process."""


@dataclass(frozen=True, slots=True)
class FoundCamera:
    """A camera that answered."""

    index: int
    """In harvesters' list."""
    id: str
    """The producer's own name for it."""
    maker: str
    model: str
    serial: str
    firmware: str
    address: str
    """IPv4 address; empty where the producer does not say."""

    def __str__(self) -> str:
        """Give what people know a camera by."""
        return f"{self.model}, serial {self.serial or 'unknown'}, id {self.id}"


class Producer:
    """A producer of this process, in use for one device."""

    def __init__(self, options: CameraOptions, *, base_dir: Path, device: str) -> None:
        self._options = options
        self.device = device
        self._path = _path_of(options, base_dir, device)
        self.harvester: Any = Harvester(
            config=ParameterSet(
                {
                    ParameterKey.LOGGER: _HARVESTERS_LOG,
                    ParameterKey.TIMEOUT_PERIOD_ON_MODULE_ENUMERATION: _DISCOVERY_MS,
                }
            )
        )

    def find(self) -> FoundCamera:
        """Look for cameras, and give the one that is meant.

        Raises:
            NotConnectedError: The producer cannot be used, or there is no such camera, or several.
        """
        with _loading, self._own_file() as path:
            self._update(path)
        found = [
            _found_camera(index, info) for index, info in enumerate(self.harvester.device_info_list)
        ]
        matching = [camera for camera in found if self._is_meant(camera)]
        if len(matching) == 1:
            return matching[0]
        raise NotConnectedError(self._not_one(matching, found), device=self.device)

    def close(self) -> None:
        """Let go of the producer."""
        try:
            self.harvester.reset()
        except GENICAM_ERRORS as error:
            _LOG.warning("%s: close: %s", self.device, error)
        with _loading:
            if _in_use.get(self._path) is self:
                del _in_use[self._path]

    @property
    def _is_our_own(self) -> bool:
        return self._options.producer is None

    @contextmanager
    def _own_file(self) -> Generator[Path]:
        """Give the producer's file, or if that serves another camera a copy of it."""
        user = _in_use.setdefault(self._path, self)
        if user is self:
            yield self._path
            return
        if not self._is_our_own:
            raise NotConnectedError(
                f"connect: '{user.device}' uses the producer {self._path} in this process, and a "
                "vendor's producer serves one camera a process; use our own, or another process",
                device=self.device,
            )
        with tempfile.TemporaryDirectory(prefix="tronlab-gev-") as folder:
            yield Path(shutil.copy(self._path, folder))

    def _update(self, path: Path) -> None:
        self.harvester.add_file(str(path))
        self._check_interfaces()
        variables = {_INTERFACES_VARIABLE: ",".join(self._places)} if self._is_our_own else {}
        with _environment(variables):
            self.harvester.update()
        if not self.harvester.device_info_list:
            self._check_that_it_loads(path)

    def _check_interfaces(self) -> None:
        here = [name for _, name in socket.if_nameindex()]
        for place in self._places:
            if place not in here and not _is_address(place):
                raise NotConnectedError(
                    f"connect: this computer has no network interface '{place}'; "
                    f"it has {', '.join(here)}; correct the option 'interfaces'",
                    device=self.device,
                )

    def _check_that_it_loads(self, path: Path) -> None:
        """Return if the producer works: harvesters only logs what keeps it from working."""
        producer = gentl.GenTLProducer.create_producer()
        try:
            producer.open(str(path))
        except gentl.ResourceInUseException:
            return  # by harvesters, so it works
        except gentl.GenericException as error:
            raise NotConnectedError(
                f"connect: the GenTL producer {self._path} cannot be used ({first_line(error)}); "
                "check that it is made for this machine",
                device=self.device,
            ) from error
        producer.close()

    @property
    def _places(self) -> Sequence[str]:
        """Get where our own producer is to look; a vendor's is not told."""
        if not self._is_our_own:
            return ()
        if self._options.address is not None:
            return (self._options.address,)
        return self._options.interfaces

    def _is_meant(self, camera: FoundCamera) -> bool:
        options = self._options
        if options.serial is not None:
            return camera.serial == options.serial
        if options.model is not None:
            return camera.model == options.model
        if self._is_our_own:
            return True  # it asked nobody else
        return options.address is not None and camera.address == camera_address(options.address)[0]

    def _not_one(self, matching: Sequence[FoundCamera], found: Sequence[FoundCamera]) -> str:
        options = self._options
        wanted = next(
            f"{key} '{value}'"
            for key in ("serial", "address", "model")
            if (value := getattr(options, key)) is not None
        )
        if matching:
            several = "; ".join(map(str, matching))
            return f"connect: {len(matching)} cameras have {wanted}: {several}. Say which by serial"
        where = ", ".join(self._places) or "all the producer knows"
        return (
            f"connect: no camera with {wanted} answers; looked at {where}, "
            f"found: {'; '.join(map(str, found)) or 'none'}. Check its power, cable and IP address"
        )


def _path_of(options: CameraOptions, base_dir: Path, device: str) -> Path:
    if options.producer is not None:
        path = (base_dir / options.producer.expanduser()).resolve()
        if not path.is_file():
            raise NotConnectedError(
                f"connect: no GenTL producer {path}; correct the option 'producer'", device=device
            )
        return path
    own = producer_path()
    if own is None:
        raise NotConnectedError(
            f"connect: our own GenTL producer is not there: {why_missing()}", device=device
        )
    return own.resolve()


def _is_address(place: str) -> bool:
    try:
        camera_address(place)
    except ValueError:
        return False
    return True


@contextmanager
def _environment(variables: Mapping[str, str]) -> Generator[None]:
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _found_camera(index: int, info: Any) -> FoundCamera:
    said: Mapping[str, Any] = info.property_dict

    def text(key: str) -> str:
        return str(said.get(key) or "").strip()

    return FoundCamera(
        index=index,
        id=text("id_"),
        maker=text("vendor"),
        model=text("model"),
        serial=text("serial_number"),
        firmware=text("version"),
        address=_address_of(info),
    )


def _address_of(info: Any) -> str:
    """Read the address from the interface's features (GenTL SFNC), where a producer has them."""
    node_map = info.parent.node_map
    names = ("DeviceSelector", "DeviceID", "GevDeviceIPAddress")
    if node_map is None or not all(node_map.has_node(name) for name in names):
        return ""
    try:
        selector = node_map.DeviceSelector
        for i in range(selector.min, selector.max + 1):
            selector.value = i
            if node_map.DeviceID.value == info.id_:
                number = int(node_map.GevDeviceIPAddress.value)
                return ".".join(str(byte) for byte in number.to_bytes(4, "big"))
    except GENICAM_ERRORS as error:
        _LOG.info("the producer does not say a camera's address: %s", error)
    return ""
