"""Mistakes in a study file are found before anything begins, and named where they stand."""

from pathlib import Path

import pytest
from small_study import STUDY, write_small_study

from tronlab.campaign.live import SilentLive
from tronlab.errors import CalibrationError, ConfigError
from tronlab.study.check import check_study
from tronlab.study.study import Study, load_study


def changed_study(folder: Path, old: str, new: str) -> Study:
    """Read the small study with one thing changed."""
    path = write_small_study(folder, with_record=False)
    assert STUDY.count(old) == 1
    path.write_text(STUDY.replace(old, new))
    return load_study(path)


def said(line: int, key: str, message: str) -> str:
    """Give a pattern of one problem in the study file."""
    return rf"study\.yaml:{line}: {key.replace('.', '[.]')}: {message}"


def line_of(text: str) -> int:
    return 1 + next(i for i, line in enumerate(STUDY.splitlines()) if text in line)


@pytest.mark.parametrize(
    ("old", "new", "where"),
    [
        ("larger: []", "larger: [dataset_0]", "quick.larger: 'dataset_0' is not in this file"),
        ("sources: [noise]", "sources: [nois]", "quick.sources: 'nois'.*there are: noise"),
        ("selection: [ratio]", "selection: [x]", "quick.selection: 'x'"),
        ("laboratory: small}\n  dataset_1", "laboratory: big}\n  dataset_1", "no|big"),
        ("datasets: [dataset_0]", "datasets: [dataset_2_nominal]", "selection.datasets"),
        ("campaign: campaign.yaml, laboratory: small}\ncores", "campaign: no.yaml}\ncores", "no"),
    ],
)
def test_names_must_be_in_the_file(tmp_path: Path, old: str, new: str, where: str) -> None:
    with pytest.raises(ConfigError, match=where):
        changed_study(tmp_path, old, new)


@pytest.mark.parametrize(
    ("old", "new", "key", "message"),
    [
        (
            "read_noise_e: 0.0",
            "read_noice_e: 0.0",
            "ablation.sources.noise.rig.world.sensor.read_noice_e",
            "unknown key, did you mean read_noise_e",
        ),
        (
            "max_ratio: 0.5",
            "max_ratio: low",
            "selection.variants.ratio.settings.matching.max_ratio",
            'must be .*got "low"',
        ),
        (
            "base: brisk",
            "base: brisque",
            "selection.variants.ratio.base",
            "no core 'brisque' .*there are: akaze",
        ),
        (
            "settings: {matching: {max_ratio: 0.5}}",
            "settings: {detector: {n_max: 9}}\n      prune_to: 0.5\n      prune_by: scores",
            "selection.variants.ratio.settings.detector",
            "scores of brisk choose among the landmarks of its own detector",
        ),
        ("cores: [brisk]\n", "cores: [bris]\n", r"cores\[0\]", "no navigation core 'bris'"),
    ],
)
def test_a_mistake_is_named_where_it_stands(
    tmp_path: Path, old: str, new: str, key: str, message: str
) -> None:
    study = changed_study(tmp_path, old, new)
    with pytest.raises(ConfigError, match=said(line_of(old.strip()), key, message)):
        check_study(study, live=SilentLive())


def test_all_mistakes_are_told_at_once(tmp_path: Path) -> None:
    study = changed_study(tmp_path, "read_noise_e: 0.0", "a: 1, b: 2")
    with pytest.raises(ConfigError) as caught:
        check_study(study, live=SilentLive())
    assert len(caught.value.parts) == 2


def test_a_dataset_with_the_larger_terrain_needs_a_rig_that_has_one(tmp_path: Path) -> None:
    study = changed_study(tmp_path, "cores: [brisk]\n", "cores: [brisk]\nlarger: [dataset_0]\n")
    with pytest.raises(ConfigError, match=r"laboratories\.small.*no rig that has one"):
        check_study(study, live=SilentLive())


def test_a_larger_rig_of_another_name_needs_its_own_record(tmp_path: Path) -> None:
    path = write_small_study(tmp_path, with_record=False)
    (tmp_path / "big.yaml").write_text("extends: rig.yaml\nname: big\n")
    text = path.read_text().replace("record.json}", "record.json, larger: big.yaml}")
    path.write_text(f"{text}\nlarger: [dataset_0]\n")
    with pytest.raises(ConfigError, match=r"small\.larger_record: rig 'big' needs"):
        check_study(load_study(path), live=SilentLive())


def test_a_rig_that_cannot_be_read_says_so_itself(tmp_path: Path) -> None:
    study = load_study(write_small_study(tmp_path, with_record=False))
    (tmp_path / "rig.yaml").write_text("name: x\n")
    with pytest.raises(ConfigError, match=r"rig\.yaml.*laboratory: required key is missing"):
        check_study(study, live=SilentLive())


def test_a_record_that_is_none_is_refused(tmp_path: Path) -> None:
    study = load_study(write_small_study(tmp_path, with_record=False))
    with pytest.raises(CalibrationError, match=r"record\.json"):
        check_study(study, live=SilentLive())


def test_a_quick_study_is_what_the_file_says(tmp_path: Path) -> None:
    path = write_small_study(tmp_path, with_record=False)
    full, quick = load_study(path), load_study(path, quick=True)
    assert full.datasets == ("dataset_0", "dataset_1_nominal")
    assert quick.datasets == ("dataset_0",)
    assert (full.every_n("dataset_0"), quick.every_n("dataset_0")) == (1, 3)
    assert quick.load.n_landmarks == (500,)
