"""A small study records and scores its datasets, whatever comes between."""

import io
import multiprocessing
import os
import signal
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd
import pytest
from small_study import write_small_study

from tronlab.campaign.config import load_campaign
from tronlab.campaign.live import SilentLive
from tronlab.campaign.rig import load_rig
from tronlab.dataset.reader import Dataset
from tronlab.study import calibration
from tronlab.study.calibration import calibration_steps
from tronlab.study.check import check_study
from tronlab.study.datasets import dataset_steps
from tronlab.study.keys import forget_files
from tronlab.study.recording import recording_of, recording_steps
from tronlab.study.run import ledger_of, run_steps
from tronlab.study.steps import Step
from tronlab.study.study import Study, load_study
from tronlab.study.view import PlainView


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))


def steps_without_reports(study: Study) -> list[Step]:
    return [
        step
        for step in (*calibration_steps(study), *dataset_steps(study))
        if not step.name.startswith("report")
    ]


def do(study: Study, steps: Sequence[Step], out: Path) -> list[str]:
    """Do the steps; give the names of those that were done now."""
    shown = io.StringIO()
    run_steps(
        study,
        steps,
        out,
        n_workers=1,
        view=PlainView(shown),
        check=lambda: check_study(study, live=SilentLive()),
    )
    lines = shown.getvalue().splitlines()
    return [step.name for step in steps if any(f": {step.name};" in line for line in lines)]


def test_a_study_is_recorded_and_scored_and_follows_what_changes(tmp_path: Path) -> None:
    path, out = write_small_study(tmp_path), tmp_path / "out"
    study = load_study(path, quick=True)
    steps = steps_without_reports(study)
    assert do(study, steps, out) == [step.name for step in steps]
    with Dataset(out / "datasets/dataset_0/dataset.h5") as dataset:
        assert dataset.shot_ids.tolist() == [1, 4, 7]
    scores = pd.read_csv(out / "datasets/dataset_0/scores.csv")
    assert set(scores["core"]) == {"brisk"}
    assert do(study, steps_without_reports(study), out) == []

    # A person can run again what the study ran.
    written = load_campaign(out / "campaigns/datasets-dataset_0.yaml").config
    assert written.rig.samefile(tmp_path / "rig.yaml")
    assert written.calibration.samefile(out / "calibration/small.json")

    path.write_text(path.read_text().replace("cores: [brisk]\n", "cores: [brisk, brisk-refined]\n"))
    study = load_study(path, quick=True)
    assert do(study, steps_without_reports(study), out) == ["score dataset_0"]

    campaign = tmp_path / "campaign.yaml"
    campaign.write_text(campaign.read_text().replace("0.02", "0.015"))
    forget_files()
    changed = steps_without_reports(study)
    ledger = ledger_of(study, out)
    assert [step.name for step in changed if not ledger.is_done(step)] == [
        "record dataset_0",
        "score dataset_0",
    ]
    do(study, changed[:2], out)
    with Dataset(out / "datasets/dataset_0/dataset.h5") as dataset:
        assert "0.015" in dataset.provenance.campaign_yaml
        assert len(dataset.sessions) == 1


def test_a_variant_is_recorded_with_its_changes(tmp_path: Path) -> None:
    study, out = load_study(write_small_study(tmp_path), quick=True), tmp_path / "out"
    calibrations = calibration_steps(study)
    variant = recording_of(
        study,
        "dataset_0",
        name="quiet, dataset_0",
        folder=Path("ablation/quiet/dataset_0"),
        rig_changes={"terrain": {"seed": 5}},
        campaign_changes={"camera": {"exposure_s": 0.01}},
        every_n=6,
    )
    steps = [*calibrations, recording_steps(study, variant, after=calibrations)[0]]
    do(study, steps, out)
    rig = load_rig(out / "rigs/ablation-quiet-dataset_0.yaml").config
    assert rig.terrain.model_dump()["seed"] == 5
    with Dataset(out / "ablation/quiet/dataset_0/dataset.h5") as dataset:
        assert dataset.shot_ids.tolist() == [1, 7]
        assert "exposure_s" in dataset.provenance.campaign_yaml


@dataclass
class KillingLive(SilentLive):
    """Ends this process after a shot, as a power cut would."""

    after: int = 2
    seen: list[int] = field(default_factory=list)

    def show_shot(self, record: object, *, write_s: float) -> None:
        self.seen.append(1)
        if len(self.seen) == self.after:
            os.kill(os.getpid(), signal.SIGKILL)


class KillingView(PlainView):
    """A view of a study that is killed while it records."""

    def __init__(self) -> None:
        super().__init__(io.StringIO())
        self._killer = KillingLive()

    def show_shot(self, record: object, *, write_s: float) -> None:
        self._killer.show_shot(record, write_s=write_s)


def _do_until_killed(study: Study, steps: Sequence[Step], out: Path) -> None:
    run_steps(study, steps, out, n_workers=1, view=KillingView(), check=lambda: None)


def test_a_recording_that_was_killed_goes_on_after_its_last_shot(tmp_path: Path) -> None:
    study, out = load_study(write_small_study(tmp_path), quick=True), tmp_path / "out"
    steps = steps_without_reports(study)[:2]
    assert [step.name for step in steps][-1] == "record dataset_0"
    child = multiprocessing.get_context("fork").Process(
        target=_do_until_killed, args=(study, steps, out)
    )
    child.start()
    child.join()
    assert child.exitcode == -signal.SIGKILL
    assert do(study, steps, out) == ["record dataset_0"]
    with Dataset(out / "datasets/dataset_0/dataset.h5") as dataset:
        assert dataset.status == "complete"
        assert dataset.shot_ids.tolist() == [1, 4, 7]
        assert len(dataset.sessions) == 2


def test_a_full_study_calibrates_every_rig_that_needs_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    measured: list[tuple[Path, Path]] = []

    def note(_desk: object, *, rig: calibration.CalibratedRig) -> None:
        measured.append((rig.file, rig.record))

    monkeypatch.setattr(calibration, "_measure", note)
    path = write_small_study(tmp_path, with_record=False)
    text = path.read_text() + "\nlarger: [dataset_0]\n"
    own = "record.json, larger: campaign.yaml"
    path.write_text(text.replace("record.json}", f"{own}, larger_record: record.json}}"))
    study = load_study(path)
    for step in calibration_steps(study):
        step.run(None)  # pyright: ignore[reportArgumentType]
    assert measured == [
        (tmp_path / "rig.yaml", Path("calibration/small.json")),
        (tmp_path / "campaign.yaml", Path("calibration/small_larger.json")),
    ]
    first = dataset_steps(study, larger=True)[0]
    assert first.name == "record dataset_0, larger terrain"
    assert first.results == (Path("larger/dataset_0/dataset.h5"),)

    # Without a record of its own, a rig with another terrain is calibrated as the other one is.
    path.write_text(text.replace("record.json}", f"{own}}}"))
    study = load_study(path)
    assert len(calibration_steps(study)) == 1
    assert study.record_path("dataset_0", larger=True) == Path("calibration/small.json")
