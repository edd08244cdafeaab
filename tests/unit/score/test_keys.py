"""Keys: everything an answer depends on changes them, and nothing else."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from tronlab.dataset import schema
from tronlab.dataset.reader import Dataset
from tronlab.dataset.rewriter import rewritten
from tronlab.nav.core import PosePrior
from tronlab.nav.specs import CoreSpec
from tronlab.score.rescoring.keys import calibration_key, core_key, frame_keys, result_keys
from tronlab.score.rescoring.prior import PriorSettings

PRIOR = PriorSettings(source="previous", position_sigma_m=0.1, rotation_sigma_deg=1.0)
SPEC = CoreSpec("a", "installed", "akaze", {"pose": {"gate_px": 6.0, "robust": "usac"}}, 1)


def keys_of(path: Path) -> tuple[tuple[str, ...], str]:
    with Dataset(path) as dataset:
        return frame_keys(dataset), calibration_key(dataset)


def test_a_copy_with_another_truth_has_the_same_keys(small_dataset: Path, tmp_path: Path) -> None:
    before = keys_of(small_dataset)
    assert len(set(before[0])) == 5
    copy = tmp_path / "recomputed.h5"
    with Dataset(small_dataset) as dataset, rewritten(small_dataset, copy) as rewriter:
        shot = dataset.shot(2)
        moved = RigidTransform.from_translation([0, 0, 0.01]) * shot.truth.trs_from_cam
        rewriter.write_truth(2, shot, replace(shot.truth, trs_from_cam=moved), shot.mask)
    with Dataset(copy) as dataset, Dataset(small_dataset) as original:
        assert dataset.uuid != original.uuid
        assert dataset.truth(2).trs_from_cam.translation[2] != pytest.approx(
            original.truth(2).trs_from_cam.translation[2]
        )
    assert keys_of(copy) == before


@pytest.mark.parametrize(
    ("path", "index", "frames_changed", "is_calibration_changed"),
    [
        (schema.IMAGE_CRC32, 1, 1, False),
        (schema.MASK_CRC32, 1, 1, False),
        (f"{schema.CAMERA}/time_s", 1, 1, False),
        (schema.REFERENCES_CRC32, 0, 0, True),
    ],
)
def test_what_a_core_is_shown_changes_its_key(
    small_dataset: Path,
    path: str,
    index: object,
    frames_changed: int,
    is_calibration_changed: bool,
) -> None:
    frames, calibration = keys_of(small_dataset)
    with h5py.File(small_dataset, "r+") as file:
        stored = file[path]
        assert isinstance(stored, h5py.Dataset)
        stored[index] = stored[index] + 1
    changed, other_calibration = keys_of(small_dataset)
    assert sum(a != b for a, b in zip(frames, changed, strict=True)) == frames_changed
    assert (calibration != other_calibration) == is_calibration_changed


def test_a_core_is_told_by_what_it_is_and_not_by_its_name() -> None:
    key = core_key(SPEC, "1.0")
    assert core_key(replace(SPEC, name="b"), "1.0") == key
    same = replace(SPEC, settings={"pose": {"robust": "usac", "gate_px": 6.0}})
    assert core_key(same, "1.0") == key
    others = [
        core_key(SPEC, "1.1"),
        core_key(replace(SPEC, seed=2), "1.0"),
        core_key(replace(SPEC, target="brisk"), "1.0"),
        core_key(replace(SPEC, kind="command"), "1.0"),
        core_key(replace(SPEC, settings={"pose": {"gate_px": 5.0, "robust": "usac"}}), "1.0"),
    ]
    assert len({key, *others}) == 6


def prior_at(x_m: float) -> PosePrior:
    return PosePrior(RigidTransform.from_translation([x_m, 0, 0]), np.eye(6))


def changed(keys: tuple[str, ...], others: tuple[str, ...]) -> list[int]:
    return [i for i, (a, b) in enumerate(zip(keys, others, strict=True)) if a != b]


def test_in_a_chain_a_key_depends_on_all_shots_before() -> None:
    def keys(frames: str, *, is_chained: bool, prior: PriorSettings | None = None):
        priors = [None] * len(frames)
        return result_keys("c", "k", frames, prior=prior, priors=priors, is_chained=is_chained)

    assert changed(keys("abcd", is_chained=False), keys("aXcd", is_chained=False)) == [1]
    assert changed(keys("abcd", is_chained=True), keys("aXcd", is_chained=True)) == [1, 2, 3]
    plain, chained = keys("abcd", is_chained=False), keys("abcd", is_chained=True, prior=PRIOR)
    assert changed(plain, chained) == [0, 1, 2, 3]
    other = PRIOR.model_copy(update={"position_sigma_m": 0.2})
    assert len(changed(chained, keys("abcd", is_chained=True, prior=other))) == 4


def test_another_camera_is_another_calibration(small_dataset: Path) -> None:
    frames, calibration = keys_of(small_dataset)
    with h5py.File(small_dataset, "r+") as file:
        camera = file[f"{schema.CAMERA}/model"].attrs
        camera["fx_px"] = np.nextafter(camera["fx_px"], 100)
    other_frames, other_calibration = keys_of(small_dataset)
    assert frames == other_frames
    assert calibration != other_calibration


@pytest.mark.parametrize("what", ["core", "calibration", "prior", "none"])
def test_core_calibration_and_prior_are_in_the_key(what: str) -> None:
    def keys(**changes: object) -> tuple[str, ...]:
        priors: Callable[[], list[PosePrior | None]] = lambda: [None, prior_at(1.0)]  # noqa: E731
        given = {"core": "c", "calibration": "k", "priors": priors(), **changes}
        return result_keys(
            given["core"],  # pyright: ignore[reportArgumentType]
            given["calibration"],  # pyright: ignore[reportArgumentType]
            "ab",
            prior=None,
            priors=given["priors"],  # pyright: ignore[reportArgumentType]
            is_chained=False,
        )

    other = {
        "core": keys(core="d"),
        "calibration": keys(calibration="l"),
        "prior": keys(priors=[None, prior_at(1.0 + 1e-12)]),
        "none": keys(),
    }
    expected = {"core": [0, 1], "calibration": [0, 1], "prior": [1], "none": []}
    assert changed(keys(), other[what]) == expected[what]
