"""What a plan foretells, against what a run of it on the small simulated laboratory comes to."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from recorder import Recorder

from tronlab.campaign.acceptance import Acceptance
from tronlab.campaign.foresight import Foresight, foresee, refuse
from tronlab.campaign.job import Files, read_job
from tronlab.campaign.run import run_campaign
from tronlab.dataset.reader import Dataset
from tronlab.errors import PlanError
from tronlab.twin.devices import TwinRobot

EditYaml = Callable[..., None]


def foreseen(campaign_path: Path, live: Recorder | None = None) -> Foresight:
    job = read_job(Files(campaign_path), seed=None, acceptance=Acceptance(False, warn=print))
    return foresee(job, job.plan.shots, live=live or Recorder())


def test_only_the_shots_to_take_are_looked_at(campaign_path: Path) -> None:
    """The way from the second to the fifth is another one than through those between."""
    job = read_job(Files(campaign_path), seed=None, acceptance=Acceptance(False, warn=print))
    live = Recorder()
    second, fifth = job.plan.shots[1], job.plan.shots[4]
    rest = foresee(job, (second, fifth), live=live)
    assert rest.shots == (second, fifth)
    assert ("plan", 2, 2) in live.progress
    whole = foreseen(campaign_path).assessment.shots
    assert rest.assessment.shots[1].duration.move_s == pytest.approx(
        sum(shot.duration.move_s for shot in whole[2:])
    )
    assert foresee(job, (), live=live).shots == ()


def write_poses(path: Path, heights_m: list[float]) -> None:
    rows = [f"1.08,2.08,{z},0.7071068,0.7071068,0,0" for z in heights_m]
    path.write_text("\n".join(["x,y,z,qx,qy,qz,qw", *rows]) + "\n")


def test_no_device_is_connected(campaign_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def connect(self: TwinRobot) -> None:
        raise AssertionError("a plan connects nothing")

    monkeypatch.setattr(TwinRobot, "connect", connect)
    live = Recorder()
    foresight = foreseen(campaign_path, live)
    refuse(foresight)
    assert [shot.shot_id for shot in foresight.plan.shots] == [1, 2, 3, 4, 5]
    assert ("plan", 5, 5) in live.progress


def test_time_range_and_usable_fraction_are_those_of_the_run(
    campaign_path: Path, edit_yaml: EditYaml, tmp_path: Path
) -> None:
    """Asked for are 10 % of the time; here nothing but rounding and noise of the robot differs."""
    edit_yaml(campaign_path, "drift", {"every_n_shots": 2})
    edit_yaml(campaign_path, "settle.wait_s", 0.7)
    assessment = foreseen(campaign_path).assessment
    path = run_campaign(campaign_path, out_dir=tmp_path / "out")
    with Dataset(path) as dataset:
        taken_s = dataset.shot(4).tracker.time_s - dataset.shot(0).tracker.time_s
        truths = [dataset.truth(i) for i in range(5)]
        parts = [dataset.timing(i) for i in range(5)]
    shots = assessment.shots
    # From measurement to measurement: what comes before the first and after the last is left out.
    foretold_s = sum(shot.duration.total_s for shot in shots[1:])
    foretold_s += assessment.drift_checks_s * 2 / 4  # of four checks, two are between shots
    assert foretold_s == pytest.approx(taken_s, rel=0.02)
    for shot, truth, timing in zip(shots[1:], truths[1:], parts[1:], strict=True):
        assert shot.duration.move_s == pytest.approx(timing.move_s, rel=0.01)
        assert shot.duration.settle_s == pytest.approx(timing.settle_s)
        # The record has no robot: the camera stands some millimetres from where it should, and a
        # column of its 64 pixels is 1.6 % of the image.
        assert shot.usable_fraction == pytest.approx(truth.usable_fraction, abs=0.012)
        assert shot.range_los_m == pytest.approx(truth.range_los_m, abs=0.02)


def test_refused_shots_are_listed_or_left_out(
    campaign_path: Path, edit_yaml: EditYaml, tmp_path: Path
) -> None:
    write_poses(tmp_path / "poses.csv", [3.0, 5.2, 2.0])
    edit_yaml(campaign_path, "trajectory", {"kind": "file", "path": "poses.csv"})
    foresight = foreseen(campaign_path)
    with pytest.raises(PlanError, match=r"1 of 3 shots cannot be taken:\n  shot 2: .*rail"):
        refuse(foresight)
    assert [shot.shot_id for shot in foresight.plan.shots] == [1, 3]
    nearest = foresight.assessment.shots[1].nearest
    assert nearest is not None
    assert nearest.translation[2] == pytest.approx(4.9, abs=0.05)  # where the rail ends


def test_a_plan_of_which_nothing_is_left_is_refused(
    campaign_path: Path, edit_yaml: EditYaml
) -> None:
    edit_yaml(campaign_path, "plan", {"range_los_m": [50.0, 60.0], "on_refused": "skip"})
    foresight = foreseen(campaign_path)
    with pytest.raises(PlanError, match=r"5 of 5 shots cannot be taken"):
        _ = foresight.plan


def test_least_motion_keeps_ids_and_saves_time(
    campaign_path: Path, edit_yaml: EditYaml, tmp_path: Path
) -> None:
    write_poses(tmp_path / "poses.csv", [3.0, 2.0, 2.8, 2.2, 2.6, 2.4])
    edit_yaml(campaign_path, "trajectory", {"kind": "file", "path": "poses.csv"})
    as_flown = foreseen(campaign_path)
    edit_yaml(campaign_path, "plan", {"order": "least_motion"})
    ordered = foreseen(campaign_path)
    ids = [shot.shot_id for shot in ordered.plan.shots]
    assert ids in ([1, 3, 5, 6, 4, 2], [2, 4, 6, 5, 3, 1])
    assert ordered.assessment.parts_s["move_s"] == pytest.approx(1.0 / 0.5, rel=0.01)
    assert ordered.assessment.parts_s["move_s"] < 0.5 * as_flown.assessment.parts_s["move_s"]
    poses = {shot.shot_id: shot.trs_from_cam_nominal.as_matrix() for shot in as_flown.plan.shots}
    for shot in ordered.plan.shots:
        np.testing.assert_array_equal(shot.trs_from_cam_nominal.as_matrix(), poses[shot.shot_id])
