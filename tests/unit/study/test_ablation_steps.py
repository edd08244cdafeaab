"""An ablation takes the same shots in laboratories that lack one source of error or all."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from shutil import copyfile

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import RigidTransform
from small_study import write_small_study

from tronlab.calib.record import CalibrationRecord
from tronlab.calib.results import PhotometryResult, Results
from tronlab.campaign.live import SilentLive
from tronlab.campaign.provenance import device_identities
from tronlab.campaign.rig import load_rig
from tronlab.dataset.reader import Dataset
from tronlab.devices.registry import connected
from tronlab.errors import CalibrationError, ConfigError
from tronlab.render.photometry import Lambert
from tronlab.score.evaluation.ablation import PARTS
from tronlab.study.ablation import ablation_steps, variants_of
from tronlab.study.calibration import calibration_steps
from tronlab.study.known_truth import with_truth
from tronlab.study.limits import limits_steps
from tronlab.study.steps import Desk
from tronlab.study.study import Study, load_study
from tronlab.study.variants import Variant, write_variant
from tronlab.terrain.heightmap import HeightMap

SOURCES = """\
    noise:
      title: Noise of the sensor
      kind: camera
      rig: {world: {sensor: {read_noise_e: 0.0}}}
    aim:
      title: Calibration
      kind: truth
      known: [hand_eye, frame]
    shading:
      title: Photometric function
      kind: light
      campaign: {database: {photometry: lunar_lambert}}
"""


def load_small_study(folder: Path, *, quick: bool = False, with_record: bool = False) -> Study:
    path = write_small_study(folder, with_record=with_record)
    text = path.read_text()
    start, end = text.index("    noise:"), text.index("selection:\n")
    path.write_text(text[:start] + SOURCES + text[end:])
    return load_study(path, quick=quick)


def test_there_is_a_laboratory_without_each_source_and_with_each_kind(tmp_path: Path) -> None:
    study = load_small_study(tmp_path)

    off = {variant.name: set(variant.off) for variant in variants_of(study)}

    assert off == {
        "all": set(),
        "without_noise": {"noise"},
        "without_aim": {"aim"},
        "without_shading": {"shading"},
        "only_light": {"noise", "aim"},
        "only_camera": {"aim", "shading"},
        "only_truth": {"noise", "shading"},
        "none": {"noise", "aim", "shading"},
    }


def test_a_quick_study_looks_at_some_sources_but_none_lacks_all(tmp_path: Path) -> None:
    study = load_small_study(tmp_path, quick=True)

    variants = {variant.name: variant for variant in variants_of(study)}

    assert list(variants) == ["all", "without_noise", "none"]
    none = variants["none"]
    assert none.rig == {"world": {"sensor": {"read_noise_e": 0.0}}}
    assert none.campaign == {"database": {"photometry": "lunar_lambert"}}
    assert none.known == ("frame", "hand_eye")


def test_changing_one_source_concerns_only_laboratories_that_lack_it(tmp_path: Path) -> None:
    study = load_small_study(tmp_path)
    before = {step.name: step.key for step in ablation_steps(study)}
    study.path.write_text(study.text.replace("lunar_lambert", "hapke"))

    after = {step.name: step.key for step in ablation_steps(load_study(study.path))}

    changed = {name for name in after if after[name] != before[name]}
    recorded = {name for name in changed if name.startswith("record")}
    lacking = ("without_shading", "only_camera", "only_truth", "none")
    assert recorded == {f"record dataset_0, {variant}" for variant in lacking}
    assert "ablation: what each source costs" in changed


def test_an_ablation_is_of_datasets_that_the_study_takes(tmp_path: Path) -> None:
    study = load_small_study(tmp_path)
    named = "ablation_every_n: {dataset_0: 3}"
    study.path.write_text(study.text.replace(named, "ablation_every_n: {dataset_1_nominal: 3}"))

    with pytest.raises(ConfigError, match=r"dataset_1_nominal.*dataset_0"):
        ablation_steps(load_study(study.path, quick=True))


def test_known_parts_are_what_is_true_and_the_record_serves_the_changed_rig(
    tmp_path: Path,
) -> None:
    study = load_small_study(tmp_path, with_record=True)
    perfect = CalibrationRecord.load(study.laboratory("dataset_0").record)
    measured = replace(perfect, results=moved(perfect.results))
    path = tmp_path / "variant.yaml"
    changes = {"world": {"sensor": {"read_noise_e": 0.0}}}
    variant = load_rig(write_variant(path, Variant(study.rig_file("dataset_0"), changes)))

    known = with_truth(measured, variant, ("frame", "intrinsics", "hand_eye", "lamp")).results
    frame_only = with_truth(measured, variant, ("frame",)).results

    for found, true in zip(numbers(known), numbers(perfect.results), strict=True):
        np.testing.assert_allclose(found, true, atol=1e-9)
    assert known.hand_eye is not None
    assert not known.hand_eye.covariance.any()
    assert frame_only.hand_eye == measured.results.hand_eye
    heightmap = HeightMap(np.zeros((3, 3), np.float32), 1.0, np.zeros(3))
    with connected(variant.open_devices(0, load_heightmap=lambda: heightmap)) as devices:
        identities = device_identities(devices)
    with_truth(measured, variant, ()).check_devices(identities)
    with pytest.raises(CalibrationError, match="of other devices"):
        measured.check_devices(identities)


def test_the_true_photometric_function_is_known_if_it_was_measured(tmp_path: Path) -> None:
    study = load_small_study(tmp_path, with_record=True)
    rig = load_rig(study.rig_file("dataset_0"))
    record = CalibrationRecord.load(study.laboratory("dataset_0").record)
    found = replace(record.results, photometry=PhotometryResult(Lambert(), weight_sigma=0.1))

    known = with_truth(replace(record, results=found), rig, ("photometry",)).results.photometry

    assert known is not None
    assert rig.config.world is not None
    assert known.photometry == rig.config.world.surface.photometry != Lambert()
    assert known.weight_sigma == 0.0
    assert with_truth(record, rig, ("photometry",)).results.photometry is None


def test_nobody_knows_what_is_true_of_hardware(tmp_path: Path) -> None:
    study = load_small_study(tmp_path, with_record=True)
    rig = load_rig(study.rig_file("dataset_0"))
    hardware = replace(rig, config=rig.config.model_copy(update={"world": None}))
    record = CalibrationRecord.load(study.laboratory("dataset_0").record)

    with pytest.raises(ConfigError, match="no world"):
        with_truth(record, hardware, ("frame",))


def test_an_ablation_takes_the_same_shots_and_says_what_each_source_costs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    study = load_small_study(tmp_path, quick=True, with_record=True)
    desk = Desk(tmp_path / "out", 1, SilentLive())
    for step in [*calibration_steps(study), *ablation_steps(study)]:
        if step.name in {"score without_noise", "score none"}:
            for result in step.results:  # scoring once shows that it works
                copy_scores(desk.out / "ablation/all/dataset_0", (desk.out / result).parent)
            continue
        step.run(desk)
        assert all((desk.out / result).is_file() for result in step.results), step.name

    table = pd.read_csv(desk.out / "ablation/ablation.csv").set_index(["variant", "dataset"])
    shares = pd.read_csv(desk.out / "ablation/shares.csv")
    assert (table["n"] == 3).all()
    assert table.loc[("without_noise", "dataset_0"), "title"] == "Noise of the sensor"
    assert set(shares["part"]) == set(PARTS)
    for variant in ("all", "none"):
        with Dataset(desk.out / f"ablation/{variant}/dataset_0/dataset.h5") as dataset:
            assert dataset.shot_ids.tolist() == [1, 4, 7]

    scores = pd.read_csv(desk.out / "ablation/all/dataset_0/scores.csv")
    copy_scores(desk.out / "ablation/all/dataset_0", desk.out / "datasets/dataset_0")
    (step,) = limits_steps(study)
    step.run(desk)
    limits = pd.read_csv(desk.out / "limits/limits.csv")
    assert limits["core"].tolist() == ["brisk"]
    assert limits["n_solved"].tolist() == [(scores["status"] == "ok").sum()]


def copy_scores(source: Path, target: Path) -> None:
    target.mkdir(parents=True, exist_ok=True)
    for name in ("scores.csv", "summary.json", "matches.h5", "score.json"):
        copyfile(source / name, target / name)


def moved(results: Results) -> Results:
    """Give results that are off by a little, as measured ones are."""
    assert results.frame is not None
    assert results.camera is not None
    assert results.hand_eye is not None
    assert results.lamp is not None
    shift = RigidTransform.from_translation([1e-3, 0.0, 0.0])
    camera = replace(results.camera.camera, fx_px=results.camera.camera.fx_px + 0.1)
    return replace(
        results,
        frame=replace(results.frame, trs_from_trk=results.frame.trs_from_trk * shift),
        camera=replace(results.camera, camera=camera),
        hand_eye=replace(results.hand_eye, tmac_from_cam=results.hand_eye.tmac_from_cam * shift),
        lamp=replace(results.lamp, p_trs_m=results.lamp.p_trs_m + 0.01),
    )


def numbers(results: Results) -> Iterator[np.ndarray]:
    """Give what was found, part by part."""
    assert results.frame is not None
    assert results.camera is not None
    assert results.hand_eye is not None
    assert results.lamp is not None
    yield results.frame.trs_from_trk.as_matrix()
    yield np.array([results.camera.camera.fx_px, *results.camera.camera.distortion])
    yield results.hand_eye.tmac_from_cam.as_matrix()
    yield results.lamp.p_trs_m
