"""Fake cores that worker processes can import as well, and a dataset that real ones solve."""

import importlib
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest
from plane_dataset import write_plane_dataset

from tronlab.nav.specs import CoreSpec
from tronlab.score.rescoring import job as job_module
from tronlab.score.rescoring.job import ScoreJob


@pytest.fixture
def fakes(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The module ``fake_cores``; its cores are those that can be scored."""
    monkeypatch.syspath_prepend(Path(__file__).parent)
    module = importlib.import_module("fake_cores")
    monkeypatch.setattr(job_module, "describe_cores", module.describe_fakes)
    return module


@pytest.fixture
def make_job(fakes: ModuleType, small_dataset: Path) -> Callable[..., ScoreJob]:
    """``make_job(*cores, **fields)`` on the small dataset; a core is its target, or a spec."""

    def make(*cores: str | CoreSpec, **fields: object) -> ScoreJob:
        specs = [CoreSpec(c, "installed", c) if isinstance(c, str) else c for c in cores]
        given = {"out_dir": small_dataset.parent / "out", **fields}
        return ScoreJob(small_dataset, tuple(specs), **given)  # pyright: ignore[reportArgumentType]

    return make


@pytest.fixture(scope="session")
def plane_dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """12 shots over a flat, textured terrain; not to be written to."""
    path = tmp_path_factory.mktemp("plane") / "dataset.h5"
    write_plane_dataset(path)
    return path
