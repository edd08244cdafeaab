from pathlib import Path

import pytest

from tronlab.campaign.rig import load_rig
from tronlab.errors import ConfigError

REPOSITORY = Path(__file__).resolve().parents[3]
TWIN = (REPOSITORY / "campaigns/rigs/twin.yaml").read_text(encoding="utf-8")
CAMERA = "  camera: {driver: twin.camera}\n"


def line_of(text: str, part: str) -> int:
    return text[: text.index(part)].count("\n") + 1


def changed(tmp_path: Path, old: str, new: str) -> Path:
    assert old in TWIN
    path = tmp_path / "rig.yaml"
    path.write_text(TWIN.replace(old, new), encoding="utf-8")
    return path


def test_twin_as_it_is_committed_opens_devices_by_their_names() -> None:
    devices = load_rig(REPOSITORY / "campaigns/rigs/twin.yaml").open_devices(0)
    assert [device.name for device in devices.all()] == [
        "robot",
        "tracker",
        "camera",
        "room",
        "operator",
    ]


def test_needed_device_is_missing(tmp_path: Path) -> None:
    path = changed(tmp_path, CAMERA, "")
    line = line_of(TWIN, "devices:\n")
    with pytest.raises(ConfigError, match=f":{line}: devices.camera: required key is missing"):
        load_rig(path)


def test_unknown_device_is_refused(tmp_path: Path) -> None:
    path = changed(tmp_path, CAMERA, CAMERA + "  camera2: {driver: twin.camera}\n")
    with pytest.raises(ConfigError, match=r"devices\.camera2: unknown key, did you mean camera\?"):
        load_rig(path)


def test_unknown_driver_is_named_with_its_line_and_the_installed_ones(tmp_path: Path) -> None:
    path = changed(tmp_path, "driver: twin.camera}", "driver: twin.kamera}")
    rig = load_rig(path)
    line = line_of(TWIN, CAMERA)
    with pytest.raises(ConfigError) as caught:
        rig.open_devices(0)
    assert str(caught.value).startswith(
        f"{path}:{line}: devices.camera.driver: no driver 'twin.kamera'; installed drivers: "
    )
    assert "twin.camera" in str(caught.value)


def test_every_bad_driver_is_listed(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(TWIN.replace("driver: twin.", "driver: twn."), encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_rig(path).open_devices(0)
    assert len(str(caught.value).splitlines()) == 5


def test_driver_of_another_kind_is_refused(tmp_path: Path) -> None:
    path = changed(tmp_path, "driver: twin.camera}", "driver: twin.robot}")
    with pytest.raises(ConfigError, match=r"devices\.camera\.driver: driver 'twin.robot' is not a"):
        load_rig(path).open_devices(0)


def test_twin_devices_need_a_world(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(TWIN[: TWIN.index("world:\n")], encoding="utf-8")
    with pytest.raises(ConfigError, match="world"):
        load_rig(path).open_devices(0)


def test_wrong_unit_deep_in_the_rig(tmp_path: Path) -> None:
    path = changed(tmp_path, "    focal_length_m: 0.0048 ", "    focal_length_mm: 4.8 ")
    with pytest.raises(ConfigError) as caught:
        load_rig(path)
    line = line_of(TWIN, "    focal_length_m: 0.0048 ")
    assert (
        f"{path}:{line}: laboratory.camera.focal_length_mm: unknown key, did you mean"
        " focal_length_m (in metres)?"
    ) in str(caught.value)
