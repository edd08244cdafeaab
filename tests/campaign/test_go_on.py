"""Going on with a dataset: after a stop, a failure, a change; and taking shots again."""

import json
from collections.abc import Callable
from pathlib import Path

import h5py
import pytest
from recorder import Recorder

from tronlab.campaign.continuation import GivenFiles
from tronlab.campaign.run import (
    CampaignInterrupted,
    resume_campaign,
    retake_shots,
    run_campaign,
)
from tronlab.campaign.stop import StopRequest
from tronlab.dataset.journal import read_journal
from tronlab.dataset.lock import run_lock
from tronlab.dataset.reader import Dataset
from tronlab.dataset.schema import STATUS
from tronlab.dataset.validate import validate
from tronlab.errors import ChangedError, ConfigError, DatasetError, PlanError, TrackingLostError

EditYaml = Callable[..., None]


def stopped_run(campaign_path: Path, out: Path, *, after: int = 2) -> Path:
    """Record until so many shots are there, then stop."""
    stop = StopRequest()

    def ask(stage: str, n_done: int) -> None:
        if stage == "shots" and n_done == after:
            stop.ask()

    with pytest.raises(CampaignInterrupted, match=rf"{after} of 5 shots.*go on: tronlab run --res"):
        run_campaign(campaign_path, out_dir=out, stop=stop, live=Recorder(ask))
    return out / "dataset.h5"


def test_a_stopped_run_goes_on_with_what_is_missing(campaign_path: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    stopped_run(campaign_path, out)
    path = resume_campaign(out)
    with Dataset(path) as dataset:
        assert dataset.status == "complete"
        assert list(dataset.shot_ids) == [1, 2, 3, 4, 5]
        assert [dataset.shot(i).session for i in range(5)] == [1, 1, 2, 2, 2]
        assert [session.kind for session in dataset.sessions] == ["run", "resume"]
        times_s = [dataset.shot(i).frame.time_s for i in range(5)]
        assert times_s == sorted(times_s), "a simulated laboratory's time goes on"
        assert dataset.truth_states == ("good",) * 5
    kinds = [entry.kind for entry in read_journal(path)]
    assert kinds.count("session") == 2
    assert kinds.count("finished") == 2


class InterruptedAtTheEnd(Recorder):
    def announce(self, text: str) -> None:
        if text.startswith("5 of 5 shots"):
            raise KeyboardInterrupt


def test_nothing_is_left_to_resume_and_one_process_at_a_time(
    campaign_path: Path, tmp_path: Path
) -> None:
    path = tmp_path / "out/dataset.h5"
    with pytest.raises(CampaignInterrupted, match="5 of 5 shots are in"):
        run_campaign(campaign_path, out_dir=tmp_path / "out", live=InterruptedAtTheEnd())
    before = path.read_bytes()
    live = Recorder()
    assert resume_campaign(tmp_path / "out", live=live) == path
    assert live.said("nothing is left to take")
    with run_lock(path), pytest.raises(DatasetError, match=r"is being recorded by process \d+"):
        resume_campaign(tmp_path / "out")
    assert path.read_bytes() == before
    with h5py.File(path, "r+") as file:  # as if killed after the last shot
        file[STATUS][()] = b"running"
    resume_campaign(tmp_path / "out")
    with Dataset(path) as dataset:
        assert (dataset.status, dataset.n_rows, len(dataset.sessions)) == ("complete", 5, 2)


def test_a_failed_run_goes_on_when_the_cause_is_mended(
    campaign_path: Path,
    rig_path: Path,
    make_record: Callable[[Path], Path],
    edit_yaml: EditYaml,
    tmp_path: Path,
) -> None:
    fault = {
        "device": "tracker", "call": "measure_pose", "at": 10, "times": 900, "error": "fault",
    }  # fmt: skip
    edit_yaml(rig_path, "world.faults", [fault])
    make_record(rig_path)
    with pytest.raises(Exception, match="fault"):
        run_campaign(campaign_path, out_dir=tmp_path / "out")
    with Dataset(tmp_path / "out/dataset.h5") as dataset:
        assert dataset.status == "failed"
        n_before = dataset.n_shots
    edit_yaml(rig_path, "world.faults", [])
    with pytest.raises(ChangedError, match=r"(?s)changed: the rig .*--accept-changes"):
        resume_campaign(tmp_path / "out", is_calibration_accepted=True)
    resume_campaign(tmp_path / "out", is_calibration_accepted=True, are_changes_accepted=True)
    with Dataset(tmp_path / "out/dataset.h5") as dataset:
        assert 0 < n_before < dataset.n_shots == 5
        assert any("changed: the rig" in line for line in dataset.sessions[1].accepted)


def test_changes_are_refused(campaign_path: Path, edit_yaml: EditYaml, tmp_path: Path) -> None:
    path = stopped_run(campaign_path, tmp_path / "out")
    before = path.read_bytes()
    edit_yaml(campaign_path, "camera.exposure_s", 0.03)
    with pytest.raises(ChangedError, match="changed: camera of the campaign;"):
        resume_campaign(tmp_path / "out")
    edit_yaml(campaign_path, "trajectory.end_trs_m", [1.08, 2.08, 1.9])
    with pytest.raises(ChangedError, match=r"changed: the plan \(.*\), camera of the campaign;"):
        resume_campaign(tmp_path / "out")
    assert path.read_bytes() == before


def test_another_record_is_refused_and_other_images_for_good(
    campaign_path: Path,
    rig_path: Path,
    make_record: Callable[[Path], Path],
    edit_yaml: EditYaml,
    tmp_path: Path,
) -> None:
    stopped_run(campaign_path, tmp_path / "out")
    edit_yaml(campaign_path, "camera.pixel_format", "Mono12")
    with pytest.raises(ChangedError, match=r"pixel_format: Mono12, but .* are uint8"):
        resume_campaign(tmp_path / "out", are_changes_accepted=True)
    edit_yaml(campaign_path, "camera.pixel_format", "Mono8")
    edit_yaml(rig_path, "world.seed", 99)
    make_record(rig_path)
    with pytest.raises(ChangedError, match="has another camera model than the dataset"):
        resume_campaign(tmp_path / "out", are_changes_accepted=True)
    record = tmp_path / "record.json"
    values = json.loads(record.read_text())
    values["created_utc"] = "2030-01-01T00:00:00Z"
    record.write_text(json.dumps(values))
    with pytest.raises(Exception, match=r"was edited|signature|changed"):
        resume_campaign(tmp_path / "out")


def test_files_may_move_and_say_other_things_that_do_not_touch_the_shots(
    campaign_path: Path, edit_yaml: EditYaml, tmp_path: Path
) -> None:
    stopped_run(campaign_path, tmp_path / "out")
    edit_yaml(campaign_path, "title", "Another title")
    campaign_path.write_text("# a remark\n" + campaign_path.read_text())
    moved = campaign_path.rename(tmp_path / "moved.yaml")
    with pytest.raises(ConfigError, match=r"campaign file of the recording is not there any more"):
        resume_campaign(tmp_path / "out")
    with Dataset(resume_campaign(tmp_path / "out", files=GivenFiles(moved))) as dataset:
        assert dataset.n_shots == 5


def test_shots_are_taken_again_and_the_old_ones_stay(campaign_path: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    path = run_campaign(campaign_path, out_dir=out)
    with Dataset(path) as dataset:
        old = dataset.image(1)
    retake_shots(out, (2, 4))
    with Dataset(path) as dataset:
        assert dataset.status == "complete"
        assert sorted(dataset.shot_ids) == [1, 2, 3, 4, 5]
        assert (dataset.n_shots, dataset.n_rows, len(dataset.superseded_rows)) == (5, 7, 2)
        new = dataset.image(list(dataset.shot_ids).index(2))
        assert (new != old).any()
        assert dataset.sessions[-1].kind == "retake"
    with pytest.raises(PlanError, match=r"no shots 9; the plan has 1 to 5"):
        retake_shots(out, (9,))


def test_neither_a_retake_nor_a_shorter_plan_hides_anything(
    campaign_path: Path, edit_yaml: EditYaml, tmp_path: Path
) -> None:
    path = stopped_run(campaign_path, tmp_path / "out", after=3)
    live = Recorder()
    retake_shots(tmp_path / "out", (2,), live=live)
    assert live.said("not taken yet: 4, 5; go on: tronlab run --resume")
    assert live.progress[-1] == ("shots", 1, 1)
    with Dataset(path) as dataset:
        assert (dataset.status, dataset.reason) == ("aborted", "not taken: 4, 5")
    edit_yaml(campaign_path, "trajectory.n_points", 2)
    resume_campaign(tmp_path / "out", are_changes_accepted=True)
    with Dataset(path) as dataset:
        assert (dataset.status, dataset.provenance.n_shots_planned) == ("complete", 3)
    assert validate(path) == []


def test_refused_shots_are_left_out_each_time(
    campaign_path: Path, edit_yaml: EditYaml, tmp_path: Path
) -> None:
    edit_yaml(campaign_path, "plan", {"min_usable_fraction": 0.6, "on_refused": "skip"})
    path = run_campaign(campaign_path, out_dir=tmp_path / "out")
    with Dataset(path) as dataset:
        assert (dataset.status, dataset.reason) == ("complete", "not taken: 1")
    before, live = path.read_bytes(), Recorder()
    retake_shots(tmp_path / "out", (1,), live=live)
    assert live.said("left out, the plan refuses them: 1")
    assert path.read_bytes() == before


def test_skipped_shots_are_listed_and_taken_later(
    campaign_path: Path,
    rig_path: Path,
    make_record: Callable[[Path], Path],
    edit_yaml: EditYaml,
    tmp_path: Path,
) -> None:
    fault = {
        "device": "tracker", "call": "measure_pose", "at": 9, "times": 3, "error": "tracking_lost",
    }  # fmt: skip
    edit_yaml(rig_path, "world.faults", [fault])
    make_record(rig_path)
    edit_yaml(campaign_path, "suspend", {"on_beam_lost": False})
    live = Recorder()
    path = run_campaign(campaign_path, out_dir=tmp_path / "out", live=live)
    with Dataset(path) as dataset:
        assert dataset.status == "complete"
        (missing,) = {1, 2, 3, 4, 5} - {int(shot_id) for shot_id in dataset.shot_ids}
    assert live.said(f"skipped: {missing}; take them later")
    assert [entry.kind for entry in read_journal(path)].count("skipped") == 1
    retake_shots(tmp_path / "out", None)
    with Dataset(path) as dataset:
        assert sorted(dataset.shot_ids) == [1, 2, 3, 4, 5]


def test_resume_of_nothing(campaign_path: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no such folder"):
        resume_campaign(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(ConfigError, match="no shot was recorded in it; begin anew"):
        resume_campaign(tmp_path / "empty")


def test_a_run_of_no_shots_leaves_its_folder_free(
    campaign_path: Path,
    rig_path: Path,
    make_record: Callable[[Path], Path],
    edit_yaml: EditYaml,
    tmp_path: Path,
) -> None:
    fault = {"device": "tracker", "call": "measure_pose", "at": 1, "times": 99, "error": "fault"}
    edit_yaml(rig_path, "world.faults", [fault])
    make_record(rig_path)
    with pytest.raises(Exception, match="fault") as failure:
        run_campaign(campaign_path, out_dir=tmp_path / "out")
    assert not isinstance(failure.value, TrackingLostError)
    edit_yaml(rig_path, "world.faults", [])
    make_record(rig_path)
    run_campaign(campaign_path, out_dir=tmp_path / "out")
