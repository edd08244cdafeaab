"""The paint of the small twin, found from a dataset that was recorded with it."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import Result
from perfect_record import save_perfect_record
from records import make_record, make_results
from ruamel.yaml import YAML
from small_study import CAMPAIGN, write_small_rig
from typer.testing import CliRunner

from tronlab.calib.record import CalibrationRecord
from tronlab.calib.results_json import results_to_json
from tronlab.campaign.live import SilentLive
from tronlab.campaign.photometry import measure_photometry
from tronlab.campaign.run import run_campaign
from tronlab.cli.app import app
from tronlab.dataset.records import Provenance, Session, ShotRecord
from tronlab.dataset.writer import DatasetWriter
from tronlab.errors import DatasetError

WEIGHT = 0.4


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a record, and a dataset of a descent over lunar-Lambert paint in ``out``."""
    folder = tmp_path_factory.mktemp("laboratory")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))
        rig = write_small_rig(folder)
        yaml = YAML()
        values = yaml.load(rig.read_text())
        values["laboratory"]["camera"].update(
            sensor_width_px=160,
            sensor_height_px=128,
            width_px=128,
            height_px=128,
            pixel_pitch_m=5e-5,
        )
        values["world"]["surface"].update(
            photometry={"kind": "lunar_lambert", "weight": WEIGHT}, vignetting_power=3.0
        )
        yaml.dump(values, rig)
        save_perfect_record(folder / "record.json", rig_path=rig)
        (folder / "campaign.yaml").write_text(
            CAMPAIGN.replace("[1.08, 2.08, 3.0]", "[0.7, 1.2, 3.0]").replace(
                "[1.08, 2.08, 2.0]", "[1.4, 2.9, 1.6]"
            )
        )
        run_campaign(folder / "campaign.yaml", out_dir=folder / "out")
    return folder


def calibrate(dataset: Path, record: Path) -> Result:
    arguments = ["calibrate", "photometry", "--from", str(dataset), "--record", str(record)]
    return CliRunner().invoke(app, arguments)


def test_the_weight_of_the_paint_goes_into_the_record_and_nothing_else_changes(
    laboratory: Path, tmp_path: Path
) -> None:
    before = CalibrationRecord.load(laboratory / "record.json")
    path = tmp_path / "record.json"
    # No reflectors: a record that is exact has no residuals to draw.
    replace(before, inputs=before.inputs.with_parts(frame=None)).save(path)
    result = calibrate(laboratory / "out", path)
    assert result.exit_code == 0, result.output
    assert "photometry: calibrated" in result.output
    assert (tmp_path / "record_pictures/photometry.png").is_file()
    assert len(list(tmp_path.glob("record-*.json"))) == 1
    after = CalibrationRecord.load(path)
    found = after.results.photometry
    assert found is not None
    assert abs(found.weight - WEIGHT) < 3 * found.weight_sigma
    assert found.statistics["vignetting_power"] == pytest.approx(3.0, abs=0.1)
    assert f"weight {found.weight:.4f}" in result.output
    others = results_to_json(replace(after.results, photometry=None))
    assert others == results_to_json(CalibrationRecord.load(laboratory / "record.json").results)


def test_a_record_of_another_rig_is_refused_and_stays(laboratory: Path, tmp_path: Path) -> None:
    path = tmp_path / "record.json"
    replace(CalibrationRecord.load(laboratory / "record.json"), rig_name="other").save(path)
    text = path.read_text()
    result = calibrate(laboratory / "out", path)
    assert "of another rig: it was made on 'other'" in str(result.exception)
    assert path.read_text() == text


def test_what_was_imported_is_refused(
    tmp_path: Path,
    make_provenance: Callable[..., Provenance],
    make_session: Callable[..., Session],
    make_shot: Callable[..., ShotRecord],
) -> None:
    path = tmp_path / "imported.h5"
    with DatasetWriter(path, make_provenance(), session=make_session(kind="import")) as writer:
        writer.commit(make_shot(0))
    with pytest.raises(DatasetError, match="was imported: nobody knows"):
        measure_photometry(path, rig_path=None, live=SilentLive())


def test_a_dataset_without_shots_is_refused(empty_dataset: Path) -> None:
    with pytest.raises(DatasetError, match="it has no shots"):
        measure_photometry(empty_dataset, rig_path=None, live=SilentLive())


def test_a_dataset_of_a_rig_whose_lamp_was_not_measured_is_refused(
    tmp_path: Path, make_provenance: Callable[..., Provenance], make_shot: Callable[..., ShotRecord]
) -> None:
    provenance = make_provenance()
    dark = make_record(replace(make_results(camera=provenance.camera), lamp=None)).to_json()
    path = tmp_path / "dataset.h5"
    with DatasetWriter(path, replace(provenance, calibration_json=dark)) as writer:
        writer.commit(make_shot(0))
    with pytest.raises(DatasetError, match=r"has no lamp.*\n.*calibrate lamp"):
        measure_photometry(path, rig_path=None, live=SilentLive())
