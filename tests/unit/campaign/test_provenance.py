from typing import Any

import pytest

from tronlab.campaign import provenance
from tronlab.campaign.provenance import device_identities, software_versions
from tronlab.devices.registry import Devices


def test_versions_name_what_shapes_the_numbers() -> None:
    import numpy as np

    import tronlab

    versions = software_versions()
    assert versions["tronlab"] == tronlab.__version__
    assert versions["numpy"] == np.__version__
    for name in ("python", "platform", "scipy", "opencv", "h5py", "numba"):
        assert versions[name]
        assert versions[name] != "unknown"


def test_missing_git_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def run(*arguments: Any, **keywords: Any) -> None:
        raise FileNotFoundError

    monkeypatch.setattr(provenance.subprocess, "run", run)
    assert "tronlab_git" not in software_versions()


def test_identities_of_all_devices_and_the_tmac(devices: Devices) -> None:
    identities = device_identities(devices)
    assert set(identities) == {"robot", "tracker", "camera", "room", "operator", "tmac"}
    assert str(identities["camera"]) == "Fake camera 1"
    assert str(identities["tmac"]) == "Fake tmac 1"
