"""Cores before they are scored: what they are, and what becomes of those that cannot be made."""

from pathlib import Path

import pytest

from tronlab.errors import ConfigError, ScoreError
from tronlab.geometry.camera import CameraModel
from tronlab.nav import cores as nav_cores
from tronlab.nav.core import CoreContext
from tronlab.nav.specs import CoreSpec, parse_core
from tronlab.score.rescore import score_dataset
from tronlab.score.rescoring.opening import ScoredCore, describe_cores
from tronlab.score.results import load_results

pytestmark = pytest.mark.opencv

HOSTED = """
import os
from scipy.spatial.transform import RigidTransform
from tronlab.nav.core import NavigationResult

class Mine:
    name = "mine"

    def __init__(self, context):
        pass

    def locate(self, frame):
        if frame.number == 1:
            os._exit(3)
        return NavigationResult("ok", RigidTransform.from_translation([0, 0, frame.number]))
"""


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
    small_dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "core_of_others.py").write_text(HOSTED)
    monkeypatch.syspath_prepend(tmp_path)
    progress: list[tuple[int, int]] = []
    table = score_dataset(
        small_dataset, cores=["core_of_others:Mine"], workers=1, cache_dir=tmp_path / "cache"
    )
    assert table["status"].tolist() == ["ok", "error", "ok", "ok", "ok"]
    assert "3" in load_results(small_dataset.parent).reasons["Mine", 1]
    again = score_dataset(
        small_dataset,
        cores=["core_of_others:Mine"],
        workers=1,
        cache_dir=tmp_path / "cache",
        progress=lambda done, n: progress.append((done, n)),
    )
    assert again["status"].tolist() == table["status"].tolist()
    assert progress == [(0, 1), (1, 1)]
