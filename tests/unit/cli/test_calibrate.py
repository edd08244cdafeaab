from pathlib import Path

import numpy as np
import pytest
import typer
from scipy.spatial.transform import RigidTransform
from typer.testing import CliRunner

from tronlab.calib.record import CalibrationRecord
from tronlab.cli import calibrate as command
from tronlab.devices.readings import DeviceIdentity
from tronlab.errors import CalibrationError, ConfigError
from tronlab.geometry.camera import CameraModel

TWIN_YAML = Path(__file__).parents[3] / "campaigns/rigs/twin.yaml"


def made(p_value: float = 0.4) -> CalibrationRecord:
    return CalibrationRecord(
        rig_name="twin",
        created_utc="2026-01-02T03:04:05Z",
        software={},
        devices={
            name: DeviceIdentity("M", name, "1", "") for name in ("camera", "tracker", "tmac")
        },
        camera=CameraModel(
            width_px=1024, height_px=1024, fx_px=764.25, fy_px=764.5, cx_px=511.0, cy_px=512.0
        ),
        camera_covariance=np.diag([0.03**2] * 9),
        trs_from_trk=RigidTransform.identity(),
        trs_from_trk_covariance=np.diag([1e-5] * 3 + [5e-5] * 3) ** 2,
        tmac_from_cam=RigidTransform.identity(),
        tmac_from_cam_covariance=np.diag([np.radians(0.003)] * 3 + [1.4e-5] * 3) ** 2,
        p_lamp_trs_m=np.array([-3.0, -2.5, 3.5]),
        p_lamp_trs_covariance_m2=np.eye(3) * 1e-8,
        statistics={
            "rms_px": 0.024,
            "n_corners": 1250,
            "n_stations": 27,
            "chi_square_poses": 120.0,
            "dof_poses": 118.5,
            "p_value_poses": p_value,
        },
        inputs={},
    )


@pytest.fixture
def app(monkeypatch: pytest.MonkeyPatch) -> typer.Typer:
    """The command alone; measuring is replaced by a finished record."""
    monkeypatch.setattr(command, "_measure_and_solve", lambda rig, seed: made())
    app = typer.Typer()
    app.command()(command.calibrate)
    return app


def run(app: typer.Typer, *arguments: str, answer: str = ""):
    return CliRunner().invoke(app, ["all", "--rig", str(TWIN_YAML), *arguments], input=answer)


def test_the_record_is_saved_and_the_verdict_printed(app: typer.Typer, tmp_path: Path) -> None:
    path = tmp_path / "records" / "r.json"
    result = run(app, "--record", str(path), "--yes")
    assert result.exit_code == 0
    assert CalibrationRecord.load(path).rig_name == "twin"
    assert "764.250 +- 0.030" in result.output
    assert "rms 0.024 px over 1250 in 27 stations" in result.output
    assert "0.014 0.014 0.014 mm,  3.00 3.00 3.00 mdeg" in result.output
    assert "chi-square 120.0, expected 118.5: agrees" in result.output
    assert result.output.rstrip().endswith(str(path))


def test_a_bad_fit_is_said_aloud(
    app: typer.Typer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "_measure_and_solve", lambda rig, seed: made(p_value=1e-6))
    result = run(app, "--record", str(tmp_path / "r.json"), "--yes")
    assert "DOES NOT FIT" in result.output


def test_an_existing_record_is_not_replaced_unless_forced(app: typer.Typer, tmp_path: Path) -> None:
    path = tmp_path / "r.json"
    path.write_text("precious")
    result = run(app, "--record", str(path), "--yes")
    assert isinstance(result.exception, CalibrationError)
    assert "exists already" in str(result.exception)
    assert path.read_text() == "precious"
    assert run(app, "--record", str(path), "--yes", "--force").exit_code == 0
    assert CalibrationRecord.load(path).rig_name == "twin"


def test_the_robot_does_not_move_before_a_yes(app: typer.Typer, tmp_path: Path) -> None:
    path = tmp_path / "r.json"
    result = run(app, "--record", str(path), answer="n\n")
    assert result.exit_code == 1
    assert not path.exists()
    assert run(app, "--record", str(path), answer="y\n").exit_code == 0


def test_the_record_is_named_after_the_rig_by_default(
    app: typer.Typer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(app, "--yes").exit_code == 0
    assert (tmp_path / "calibration/records/twin.json").exists()


def test_an_unknown_part_lists_the_known_ones(app: typer.Typer) -> None:
    result = CliRunner().invoke(app, ["everything", "--rig", str(TWIN_YAML)])
    assert result.exit_code == 2
    assert "all" in result.output


def test_a_missing_rig_file_is_named(app: typer.Typer) -> None:
    result = CliRunner().invoke(app, ["all", "--rig", "none.yaml", "--yes"])
    assert isinstance(result.exception, ConfigError)
    assert "none.yaml" in str(result.exception)
