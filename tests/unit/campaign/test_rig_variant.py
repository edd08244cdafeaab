"""A rig file that extends another one."""

from pathlib import Path

import pytest

from tronlab.campaign.rig import load_rig
from tronlab.errors import ConfigError
from tronlab.twin.truth import serial_number

RIGS = Path(__file__).parents[3] / "campaigns" / "rigs"
TWIN = RIGS / "twin.yaml"


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def test_the_wire_rig_is_the_same_laboratory_with_other_drivers():
    twin, wire = load_rig(TWIN), load_rig(RIGS / "wire.yaml")
    assert wire.name == twin.name
    assert wire.config.world is not None
    assert twin.config.world is not None
    serials = [serial_number(rig.config.laboratory, rig.config.world) for rig in (twin, wire)]
    assert serials[0] == serials[1]
    assert wire.config.devices.tracker.driver == "leica.tracker"
    assert wire.config.terrain == twin.config.terrain


def test_provenance_has_both_files():
    wire = load_rig(RIGS / "wire.yaml")
    assert wire.text in wire.whole_text
    assert load_rig(TWIN).text in wire.whole_text
    assert "# --- extends: twin.yaml" in wire.whole_text


def test_sections_are_replaced_whole(tmp_path: Path):
    path = write(
        tmp_path / "mine.yaml",
        f"extends: {TWIN}\nname: mine\nworld: {{seed: 7}}\n",
    )
    rig = load_rig(path)
    assert rig.name == "mine"
    assert rig.config.world is not None
    assert rig.config.world.seed == 7
    assert rig.config.world.sensor.read_noise_e == 10.0
    assert rig.config.devices == load_rig(TWIN).config.devices


def test_a_mistake_is_named_in_the_file_it_stands_in(tmp_path: Path):
    path = write(tmp_path / "mine.yaml", f"extends: {TWIN}\nworld: {{seed: -1}}\n")
    with pytest.raises(ConfigError, match=rf"^{path}:2: world\.seed: "):
        load_rig(path)


def test_an_option_of_a_driver_is_named_with_its_line(tmp_path: Path):
    text = (RIGS / "wire.yaml").read_text(encoding="utf-8")
    text = text.replace("extends: twin.yaml", f"extends: {TWIN}").replace("port: 10700", "prot: 1")
    path = write(tmp_path / "mine.yaml", text)
    line = 1 + text[: text.index("prot: 1")].count("\n")
    with pytest.raises(
        ConfigError,
        match=rf"{path}:{line}: devices\.tracker\.options\.prot: unknown key, did you mean port\?",
    ):
        load_rig(path).open_devices(0)


def test_devices_taken_over_keep_their_folder_and_their_lines(tmp_path: Path):
    text = (RIGS / "wire.yaml").read_text(encoding="utf-8")
    text = text.replace("extends: twin.yaml", f"extends: {TWIN}")
    (tmp_path / "lab").mkdir()
    wire = write(tmp_path / "lab" / "wire.yaml", text.replace("port: 10700", "prot: 1"))
    rig = load_rig(write(tmp_path / "mine.yaml", "extends: lab/wire.yaml\nworld: {seed: 7}\n"))
    dimmer = rig.config.devices.room.options["dimmer"]["path"]
    assert dimmer == str(wire.parent / "../../out/wire/dimmer")
    line = 1 + text[: text.index("port: 10700")].count("\n")
    with pytest.raises(ConfigError, match=rf"^{wire}:{line}: devices\.tracker\.options\.prot: "):
        rig.open_devices(0)


def test_a_missing_file_is_one_clear_error(tmp_path: Path):
    path = write(tmp_path / "mine.yaml", "extends: nowhere.yaml\n")
    with pytest.raises(ConfigError, match=r"mine\.yaml:1: extends: no such file: .*nowhere\.yaml"):
        load_rig(path)


def test_files_that_extend_each_other_are_refused(tmp_path: Path):
    write(tmp_path / "a.yaml", "extends: b.yaml\n")
    write(tmp_path / "b.yaml", "extends: a.yaml\n")
    with pytest.raises(ConfigError, match="the file extends itself by way of"):
        load_rig(tmp_path / "a.yaml")
    write(tmp_path / "c.yaml", "extends: c.yaml\n")
    with pytest.raises(ConfigError, match="extends itself"):
        load_rig(tmp_path / "c.yaml")
