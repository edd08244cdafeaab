"""Where a dataset comes from: versions of what shaped its numbers, identities of the devices."""

import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from tronlab.devices.readings import DeviceIdentity
from tronlab.devices.registry import Devices

_PACKAGES = ("numpy", "scipy", "h5py", "numba", "bluesky", "pydantic")
_GIT_TIMEOUT_S = 5.0


def software_versions() -> dict[str, str]:
    """Give the versions of tronlab, Python and the libraries that shape the numbers."""
    import cv2

    import tronlab

    versions = {
        "tronlab": tronlab.__version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "opencv": cv2.__version__,
    }
    for package in _PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "unknown"
    revision = _git_revision(Path(tronlab.__file__).resolve().parents[1])
    if revision:
        versions["tronlab_git"] = revision
    return versions


def device_identities(devices: Devices) -> dict[str, DeviceIdentity]:
    """Ask every device who it is, and the tracker for its T-MAC."""
    identities = {device.name: device.identify() for device in devices.all()}
    identities["tmac"] = devices.tracker.identify_target()
    return identities


def _git_revision(checkout: Path) -> str:
    """Give the revision of a source checkout; empty if tronlab was installed from a wheel."""
    if not (checkout / ".git").exists():
        return ""
    try:
        answer = subprocess.run(  # noqa: S603  # fixed command, our own folder
            ["git", "-C", str(checkout), "describe", "--always", "--dirty", "--tags"],  # noqa: S607
            capture_output=True,
            text=True,
            timeout=_GIT_TIMEOUT_S,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return answer.stdout.strip()
