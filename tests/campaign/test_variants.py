"""Campaigns and rigs that extend others, thinned plans, and reference views of another way."""

from pathlib import Path

import numpy as np
import pytest
from recorder import Recorder

from tronlab.calib.record import CalibrationRecord
from tronlab.campaign.acceptance import Acceptance
from tronlab.campaign.job import Files, Job, read_job
from tronlab.campaign.recorded import recorded_database, recorded_terrain
from tronlab.campaign.run import CampaignInterrupted, resume_campaign, run_campaign
from tronlab.campaign.stop import StopRequest
from tronlab.dataset.reader import Dataset
from tronlab.errors import ChangedError, ConfigError
from tronlab.score.rescore import campaign_cores

CAMPAIGN = """\
extends: ../campaign.yaml
name: thin
rig: rigs/dim.yaml
changes:
  camera: {exposure_s: 0.01}
  score: {cores: [akaze]}
  plan: {every_n: 2}
  database:
    trajectory:
      kind: straight_line
      start_trs_m: [1.08, 2.08, 2.5]
      end_trs_m: [1.08, 30.0, 2.5]          # the last view shows nothing of the model
      n_points: 3
    n_views: null
"""
RIG = """\
extends: ../../rig.yaml
changes:
  world: {surface: {stray_radiance_w_per_m2_sr: 0.1}}
"""


@pytest.fixture
def variant_path(campaign_path: Path) -> Path:
    folder = campaign_path.parent / "variants"
    (folder / "rigs").mkdir(parents=True)
    (folder / "rigs/dim.yaml").write_text(RIG)
    (folder / "thin.yaml").write_text(CAMPAIGN)
    return folder / "thin.yaml"


def job_of(path: Path) -> Job:
    return read_job(Files(path), seed=None, acceptance=Acceptance(False, warn=print))


def test_every_n_th_shot_is_planned_and_the_whole_way_is_seen(
    campaign_path: Path, variant_path: Path
) -> None:
    whole, thin = job_of(campaign_path), job_of(variant_path)
    assert [shot.shot_id for shot in thin.plan.shots] == [1, 3, 5]
    middle = [plan.shots[i].trs_from_cam_nominal for plan, i in ((thin.plan, 1), (whole.plan, 2))]
    np.testing.assert_array_equal(*(pose.as_matrix() for pose in middle))
    assert [pose.translation[1] for pose in thin.reference_poses] == [2.08, 16.04, 30.0]
    text = CAMPAIGN[: CAMPAIGN.index("    trajectory:")] + "    n_views: 5\n"
    variant_path.write_text(text)
    assert [pose.translation[2] for pose in job_of(variant_path).reference_poses] == [
        3.0, 2.75, 2.5, 2.25, 2.0,
    ]  # fmt: skip
    variant_path.write_text(text.replace("n_views: 5", "n_views: 6"))
    with pytest.raises(ConfigError, match=r"thin\.yaml:9: changes\.database\.n_views: 6 reference"):
        job_of(variant_path)


def test_a_run_of_variants_goes_on_and_sees_changes_in_every_file(
    campaign_path: Path, rig_path: Path, variant_path: Path, tmp_path: Path
) -> None:
    out, stop = tmp_path / "out", StopRequest()

    def ask(stage: str, n_done: int) -> None:
        if stage == "shots" and n_done == 1:
            stop.ask()

    with pytest.raises(CampaignInterrupted, match="1 of 3 shots"):
        run_campaign(variant_path, out_dir=out, stop=stop, live=Recorder(ask))
    for path, old, new, changed in (
        (campaign_path, "wait_s: 0.0", "wait_s: 0.1", "settle of the campaign"),
        (variant_path, "exposure_s: 0.01", "exposure_s: 0.02", "camera of the campaign"),
        (rig_path, "albedo: 0.35", "albedo: 0.36", "the rig"),
        (variant_path.parent / "rigs/dim.yaml", "0.1}", "0.2}", "the rig"),
    ):
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new))
        with pytest.raises(ChangedError, match=f"changed: {changed}"):
            resume_campaign(out)
        path.write_text(f"# a comment\n{text}")
    with Dataset(resume_campaign(out)) as dataset:
        assert dataset.status == "complete"
        assert list(dataset.shot_ids) == [1, 3, 5]
        views = [dataset.reference(i) for i in range(dataset.n_references)]
        provenance = dataset.provenance
    assert [view.mask.any() for view in views] == [True, False, False]
    assert np.isnan(views[2].depth_m).all()
    assert campaign_cores(provenance.campaign_yaml) == ("akaze",)
    record = CalibrationRecord.from_json(provenance.calibration_json)
    assert recorded_database(provenance, record).rays_per_pixel == 1
    assert recorded_terrain(provenance.rig_yaml).spacing_m == 0.01
