"""The commands on a small twin: what they write, keep, refuse and say."""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from click.testing import Result
from ruamel.yaml import YAML
from small_twin import TWIN_YAML
from typer.testing import CliRunner

from tronlab.calib import wizard
from tronlab.calib.record import CalibrationRecord
from tronlab.calib.wizard import Settings
from tronlab.cli.app import app
from tronlab.errors import CalibrationError, ConfigError, DeviceTimeoutError
from tronlab.report import calibration as pictures

pytestmark = pytest.mark.opencv
FEW = Settings(n_stations=8, n_views=8, n_reflector_readings=2)


def run(*arguments: str | Path, answers: str = "") -> Result:
    return CliRunner().invoke(app, ["calibrate", *map(str, arguments)], input=answers)


def write_rig(folder: Path, **changes: Any) -> Path:
    """The twin with a quarter of the pixels and a coarse terrain."""
    rig: dict[str, Any] = YAML().load(TWIN_YAML.read_text(encoding="utf-8"))
    camera = rig["laboratory"]["camera"]
    for name in ("sensor_width_px", "sensor_height_px", "left_px", "width_px", "height_px"):
        camera[name] //= 2
    camera["pixel_pitch_m"] *= 2
    rig["terrain"]["spacing_m"] = 0.01
    rig["world"]["surface"]["rays_per_pixel"] = 1
    rig.update(changes)
    path = folder / f"{rig['name']}.yaml"
    with path.open("w", encoding="utf-8") as file:
        YAML().dump(rig, file)
    return path


def measure_little(patch: pytest.MonkeyPatch) -> None:
    """Few measurements, and no true pictures, which take longer than all the rest."""

    def write_pictures(record: CalibrationRecord, folder: Path) -> list[Path]:
        return [folder / f"{record.rig_name}.png"]

    patch.setattr(wizard, "Bench", partial(wizard.Bench, settings=FEW))
    patch.setattr(pictures, "write_pictures", write_pictures)


@dataclass
class Calibrated:
    rig: Path
    record: Path
    result: Result


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Calibrated:
    folder = tmp_path_factory.mktemp("calibrated")
    rig, record = write_rig(folder), folder / "twin.json"
    with pytest.MonkeyPatch.context() as patch:
        measure_little(patch)
        result = run("all", "--rig", rig, "--record", record, "--yes")
    return Calibrated(rig, record, result)


@pytest.fixture
def copied(calibrated: Calibrated, tmp_path: Path) -> Calibrated:
    """The same with a record that may be changed."""
    record = tmp_path / "twin.json"
    record.write_bytes(calibrated.record.read_bytes())
    return replace(calibrated, record=record)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    measure_little(monkeypatch)


def test_all_parts_unattended(calibrated: Calibrated) -> None:
    assert calibrated.result.exit_code == 0, calibrated.result.exception
    record = CalibrationRecord.load(calibrated.record)
    record.check_complete()
    assert set(record.devices) == {"camera", "tracker", "tmac"}
    assert set(record.inputs.measured_utc) == {"frame", "hand_eye", "lamp", "robot"}
    assert calibrated.result.stdout.rstrip().endswith(str(calibrated.record))
    folder = calibrated.record.parent
    assert f"pictures: 1 in {folder / 'twin_pictures'}" in calibrated.result.stdout
    assert not list(folder.glob("*.part*"))


def test_the_verdict_has_the_numbers_and_their_sigmas(calibrated: Calibrated) -> None:
    verdict = calibrated.result.stdout
    for line in (
        "frame trs_from_trk",
        "camera, focal length",
        "hand-eye tmac_from_cam",
        "least determined",
        "chi-square",
        "held out",
        "lamp",
        "robot trs_from_rail",
    ):
        assert line in verdict
    assert "agrees with the stated accuracy" in verdict
    assert "warning" not in verdict


@pytest.mark.usefixtures("quick")
def test_one_part_replaces_itself_and_the_old_record_is_kept(copied: Calibrated) -> None:
    before = CalibrationRecord.load(copied.record)
    old = copied.record.read_bytes()
    result = run("frame", "--rig", copied.rig, "--record", copied.record, "--yes")
    assert result.exit_code == 0, result.exception
    after = CalibrationRecord.load(copied.record)
    assert after.inputs.frame != before.inputs.frame
    assert after.inputs.hand_eye == before.inputs.hand_eye
    assert after.devices == before.devices
    kept = [p for p in copied.record.parent.glob("twin-*.json") if p.read_bytes() == old]
    assert len(kept) == 1
    assert f"the record before is kept in {kept[0]}" in result.stdout
    compared = run("compare", kept[0], copied.record)
    assert compared.exit_code == 0
    assert "frame" in compared.stdout


def test_the_same_readings_give_the_same_answer(calibrated: Calibrated) -> None:
    result = run("rerun", calibrated.record)
    assert result.exit_code == 0
    assert "the answer is the same" in result.stdout


def test_a_changed_answer_is_found_out_and_mended(copied: Calibrated, tmp_path: Path) -> None:
    values = json.loads(copied.record.read_text())
    values["frame"]["trs_from_trk"]["xyz_m_quat_xyzw"][0] += 1e-6
    copied.record.write_text(json.dumps(values))
    mended = tmp_path / "mended.json"
    result = run("rerun", copied.record, "--out", mended)
    assert result.exit_code == 1
    assert "the signature does not match" in result.stderr
    assert "frame.trs_from_trk.xyz_m_quat_xyzw: differs by 1e-06" in result.stdout
    assert CalibrationRecord.load(mended).results.frame is not None


def test_an_existing_record_is_not_replaced_unless_forced(tmp_path: Path) -> None:
    record = tmp_path / "r.json"
    record.write_text("precious")
    result = run("all", "--rig", TWIN_YAML, "--record", record, "--yes")
    assert isinstance(result.exception, CalibrationError)
    assert "exists already" in str(result.exception)
    assert "--force" in str(result.exception)
    assert record.read_text() == "precious"


@pytest.mark.usefixtures("quick")
def test_forced_or_not_nothing_is_lost(copied: Calibrated, monkeypatch: pytest.MonkeyPatch) -> None:
    made = CalibrationRecord.load(copied.record)
    monkeypatch.setattr(wizard, "calibrate", lambda *_, **__: made)
    copied.record.write_text("precious")
    arguments = ("all", "--rig", copied.rig, "--record", copied.record, "--yes", "--force")
    assert run(*arguments).exit_code == 0
    assert CalibrationRecord.load(copied.record).rig_name == "twin"
    texts = [path.read_text() for path in copied.record.parent.glob("twin-*.json")]
    assert texts == ["precious"]


def test_a_folder_that_cannot_be_written_shows_before_anything_is_measured(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    result = run("frame", "--rig", TWIN_YAML, "--record", tmp_path / "file/r.json", "--yes")
    assert isinstance(result.exception, CalibrationError)
    assert "name another file: --record" in str(result.exception)
    assert not result.stderr


def test_another_rigs_record_is_refused(copied: Calibrated, tmp_path: Path) -> None:
    rig = write_rig(tmp_path, name="other")
    result = run("frame", "--rig", rig, "--record", copied.record, "--yes")
    assert isinstance(result.exception, CalibrationError)
    assert "of another rig" in str(result.exception)


def test_a_record_of_other_devices_is_refused(copied: Calibrated, tmp_path: Path) -> None:
    """Another world of the twin has other serial numbers."""
    world = YAML().load(copied.rig.read_text())["world"]
    rig = write_rig(tmp_path, world={**world, "seed": 2})
    result = run("frame", "--rig", rig, "--record", copied.record, "--yes")
    assert isinstance(result.exception, CalibrationError)
    assert "tracker: record" in str(result.exception)


def stop_after_one_draft(error: BaseException) -> Callable[..., CalibrationRecord]:
    def stop(parts: Any, bench: Any, draft: CalibrationRecord, *, keep: Any) -> CalibrationRecord:
        keep(draft)
        raise error

    return stop


def test_ctrl_c_says_where_the_readings_are(
    copied: Calibrated, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = ("frame", "--rig", copied.rig, "--record", copied.record, "--yes")
    monkeypatch.setattr(wizard, "calibrate", stop_after_one_draft(KeyboardInterrupt()))
    result = run(*arguments)
    assert result.exit_code == 130
    part = copied.record.with_name("twin.part.json")
    assert f"what was measured so far is in {part}" in result.stderr
    assert run("rerun", part).exit_code == 0
    first = part.read_bytes()
    monkeypatch.setattr(
        wizard, "calibrate", stop_after_one_draft(DeviceTimeoutError("slow", device="tracker"))
    )
    assert isinstance(run(*arguments).exception, DeviceTimeoutError)
    kept = [p for p in copied.record.parent.glob("twin.part-*") if p.read_bytes() == first]
    assert kept


def test_the_robot_does_not_move_before_a_yes(copied: Calibrated) -> None:
    arguments = ("robot", "--rig", copied.rig, "--record", copied.record)
    result = run(*arguments, answers="n\n")
    assert result.exit_code == 1
    assert "The robot will move" in result.stderr


def test_a_person_is_told_what_to_prepare(copied: Calibrated) -> None:
    result = run("lamp", "--rig", copied.rig, "--record", copied.record, answers="n\n")
    assert result.exit_code == 1
    assert "Seat the reflectors: top_left, bottom_left, top_right, lamp;" in result.stderr
    assert "robot" not in result.stderr


@pytest.mark.usefixtures("quick")
def test_a_person_is_asked_before_each_place(copied: Calibrated) -> None:
    result = run(
        "robot", "--rig", copied.rig, "--record", copied.record, answers="y\n\nwhat\nskip\nst\n"
    )
    assert isinstance(result.exception, CalibrationError)  # from one place nothing follows
    assert "robot station 3 of" in result.stderr
    assert "robot stations: " not in result.stderr
    assert "reflectors: 3 of 3" in result.stderr
    assert "'what': type one of go, skip, stop" in result.stderr


@pytest.mark.usefixtures("quick")
def test_the_record_is_named_after_the_rig_by_default(
    calibrated: Calibrated, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run("frame", "--rig", calibrated.rig, "--yes").exit_code == 0
    record = CalibrationRecord.load(tmp_path / "calibration/records/twin.json")
    assert set(record.devices) == {"tracker"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "name a rig file to measure"),
        (("--rig", "r.yaml", "--from", "images"), "name one of them"),
        (("images",), "put --from before"),
        (("--from", "images"), "needs to know what is on the board"),
        (("--from", "images", "--pattern", "chessboard", "--columns", "9"), "board.rows"),
    ],
)
def test_a_command_that_makes_no_sense_says_why(arguments: tuple[str, ...], message: str) -> None:
    result = run("intrinsics", *arguments)
    assert isinstance(result.exception, ConfigError)
    assert message in str(result.exception)


def test_recorded_files_are_solved_without_a_rig(
    calibrated: Calibrated, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What reading gives is the reader's matter; here it is what was measured before."""
    measured = CalibrationRecord.load(calibrated.record)
    seen: dict[str, Any] = {}

    def read_hand_eye(paths: list[Path], **options: Any) -> Any:
        seen.update(options, paths=paths)
        return measured.inputs.hand_eye

    monkeypatch.setattr("tronlab.calib.offline.read_hand_eye", read_hand_eye)
    record = tmp_path / "o.json"
    board = ("--pattern", "charuco", "--columns", "10", "--rows", "8", "--square-m", "0.05")
    measure_little(monkeypatch)
    options = ("--record", record, *board, "--marker-m", "0.035", "--rig-name", "bench")
    result = run("hand-eye", "--from", "a.png", "b.png", *options, "--eye-to-hand")
    assert result.exit_code == 0, result.exception
    assert seen["paths"] == [Path("a.png"), Path("b.png")]
    assert seen["setup"] == "eye_to_hand"
    assert seen["pattern"].marker_m == 0.035
    made = CalibrationRecord.load(record)
    assert made.rig_name == "bench"
    assert made.devices == {}
    assert set(made.inputs.measured_utc) == {"hand_eye"}


def test_a_missing_rig_file_is_named() -> None:
    result = run("frame", "--rig", "none.yaml", "--yes")
    assert isinstance(result.exception, ConfigError)
    assert "none.yaml" in str(result.exception)
