"""Cores before they are scored: what they are, and what becomes of those that cannot be made."""

import sys
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import RigidTransform

from tronlab.errors import ConfigError, IntegrityError, ScoreError
from tronlab.geometry.camera import CameraModel
from tronlab.nav import cores as nav_cores
from tronlab.nav.core import CoreContext
from tronlab.nav.database import Landmarks
from tronlab.nav.database_file import Pruning, Source
from tronlab.nav.database_writer import new_database
from tronlab.nav.settings import DetectorSettings
from tronlab.nav.specs import CoreSpec, parse_core
from tronlab.score.rescore import score_dataset
from tronlab.score.rescoring.opening import ScoredCore, check_databases, describe_cores

SCRIPT = Path(__file__).parents[2] / "support/misbehaving_core.py"


def test_built_in_cores_are_told_by_settings_and_seed() -> None:
    plain = CoreSpec("a", "installed", "akaze")
    gated = CoreSpec("b", "installed", "akaze", {"pose": {"gate_px": 3.0}})
    described = describe_cores([plain, gated, CoreSpec("c", "installed", "akaze", seed=1)])
    assert len({core.key for core in described}) == 3
    assert all(core.is_built_in and core.wants_references for core in described)
    with pytest.raises(ConfigError, match="gate"):
        describe_cores([CoreSpec("d", "installed", "akaze", {"pose": {"gate": 3.0}})])


def test_a_core_that_cannot_be_built_is_a_clear_error(
    small_camera: CameraModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    def without_licence(spec: CoreSpec, context: CoreContext) -> None:
        raise RuntimeError("no licence")

    monkeypatch.setattr(nav_cores, "make_core", without_licence)
    core = ScoredCore(parse_core("mine"), "key")
    with pytest.raises(ScoreError, match="'mine' cannot be built: RuntimeError: no licence"):
        core.open(CoreContext(small_camera, ()), limit_s=1.0)


def test_a_core_of_others_that_crashes_is_asked_again_and_its_answers_are_kept(
    plane_dataset: Path, tmp_path: Path
) -> None:
    core = f"crash=cmd:{sys.executable} {SCRIPT} crash"  # at the tenth of twelve
    progress: list[tuple[int, int]] = []

    def scored() -> pd.DataFrame:
        return score_dataset(
            plane_dataset,
            cores=[core],
            workers=1,
            out_dir=tmp_path,
            cache_dir=tmp_path / "cache",
            progress=lambda *counts: progress.append(counts),
        )

    first = scored()
    assert first["status"].tolist() == [*["ok"] * 9, "error", "ok", "ok"]
    progress.clear()
    pd.testing.assert_frame_equal(scored(), first, check_exact=True)
    assert progress == [(0, 1), (1, 1)]


@pytest.fixture
def landmarks(tmp_path: Path) -> Path:
    """A file of landmarks that scores on the dataset ``mine`` have pruned."""
    rng = np.random.default_rng(1)
    path = tmp_path / "landmarks.h5"
    rows = rng.normal(size=(60, 3)), rng.random(60), rng.integers(0, 256, (60, 61), np.uint8)
    pruning = Pruning(
        time_utc="", from_digest="", n_before=90, n_after=60, datasets=("mine",), rules={}
    )
    with new_database(path, DetectorSettings()) as writer:
        writer.sources.append(Source(kind="dataset", name="a.h5", identity="id", camera={}))
        writer.prunings.append(pruning)
        writer.add(RigidTransform.identity(), Landmarks(*rows), source=0)
    return path


def looking_into(landmarks: Path) -> ScoredCore:
    return ScoredCore(CoreSpec("a", "installed", "akaze", {"database": str(landmarks)}), "key")


def test_landmarks_that_the_dataset_chose_are_named(landmarks: Path) -> None:
    cores = [looking_into(landmarks), ScoredCore(parse_core("brisk"), "key")]
    assert check_databases(cores, uuid="mine") == (landmarks,)
    assert check_databases(cores, uuid="another") == ()
    assert check_databases(cores, uuid=None) == ()


def test_damaged_landmarks_are_found_before_anything_is_scored(landmarks: Path) -> None:
    with h5py.File(landmarks, "r+") as file:
        stored = file["landmarks/descriptors"]
        assert isinstance(stored, h5py.Dataset)
        stored[7, 0] ^= 1
    with pytest.raises(IntegrityError, match=r"landmarks\.h5: the landmarks are damaged"):
        check_databases([looking_into(landmarks)], uuid="mine")
