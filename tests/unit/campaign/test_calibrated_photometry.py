"""``database: {photometry: calibrated}``: the calibration record has the photometric function."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from small_study import CAMPAIGN, write_small_study

from tronlab.calib.record import CalibrationRecord
from tronlab.calib.results import PhotometryResult
from tronlab.campaign.acceptance import Acceptance
from tronlab.campaign.job import Files, Job, read_job
from tronlab.campaign.recorded import recorded_database
from tronlab.dataset.records import Provenance
from tronlab.errors import CalibrationError, ConfigError
from tronlab.render.photometry import LunarLambert

FOUND = LunarLambert(weight=0.25)


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    write_small_study(tmp_path)
    path = tmp_path / "campaign.yaml"
    path.write_text(CAMPAIGN.replace("  n_views: 2\n", "  n_views: 2\n  photometry: calibrated\n"))
    return path


def job_of(campaign: Path) -> Job:
    return read_job(Files(campaign), seed=None, acceptance=Acceptance(False, warn=print))


def calibrate(folder: Path) -> CalibrationRecord:
    record = CalibrationRecord.load(folder / "record.json")
    found = PhotometryResult(FOUND, weight_sigma=0.01)
    record = replace(record, results=replace(record.results, photometry=found))
    record.save(folder / "record.json")
    return record


def test_a_record_without_it_is_named_with_the_key_and_what_to_do(campaign: Path) -> None:
    with pytest.raises(
        ConfigError,
        match=r"yaml:\d+: database\.photometry: .*record\.json[\s\S]*calibrate photometry",
    ):
        job_of(campaign)


def test_reference_views_are_rendered_with_what_was_found(campaign: Path) -> None:
    calibrate(campaign.parent)
    images = job_of(campaign).database_images
    assert images.photometry == FOUND
    assert images.rays_per_pixel == 1


def test_a_function_that_is_named_needs_no_calibration(campaign: Path) -> None:
    campaign.write_text(campaign.read_text().replace("calibrated", "lommel_seeliger"))
    assert job_of(campaign).database_images.photometry.kind == "lommel_seeliger"


def test_a_name_that_is_none_is_told_what_is_allowed(campaign: Path) -> None:
    campaign.write_text(campaign.read_text().replace("calibrated", "calibrate"))
    with pytest.raises(ConfigError, match=r"database\.photometry.*'calibrate'.*'calibrated'"):
        job_of(campaign)


def test_recomputing_takes_it_from_the_new_record(
    campaign: Path, make_provenance: Callable[..., Provenance]
) -> None:
    provenance = replace(make_provenance(), campaign_yaml=campaign.read_text())
    before = CalibrationRecord.load(campaign.parent / "record.json")
    with pytest.raises(CalibrationError, match="calibrate photometry"):
        recorded_database(provenance, before)
    assert recorded_database(provenance, calibrate(campaign.parent)).photometry == FOUND
