"""A small simulated laboratory in files: 64 x 64 pixels, a coarse terrain, a few shots."""

from collections.abc import Callable
from pathlib import Path

import pytest
from perfect_record import save_perfect_record
from ruamel.yaml import YAML
from small_study import write_small_rig

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))


@pytest.fixture
def edit_yaml() -> Callable[..., None]:
    """``edit_yaml(path, "a.b", value)`` changes one key of a YAML file."""

    def edit(path: Path, key: str, value: object) -> None:
        yaml = YAML()
        root = yaml.load(path.read_text())
        *parents, last = key.split(".")
        node = root
        for parent in parents:
            node = node[parent]
        node[last] = value
        with path.open("w") as file:
            yaml.dump(root, file)

    return edit


@pytest.fixture
def rig_path(tmp_path: Path) -> Path:
    """The repository's twin, smaller."""
    return write_small_rig(tmp_path)


@pytest.fixture
def make_record(tmp_path: Path) -> Callable[[Path], Path]:
    """``make_record(rig_path)`` writes a perfect calibration record: the world's own truth."""

    def make(rig_path: Path) -> Path:
        return save_perfect_record(tmp_path / "record.json", rig_path=rig_path)

    return make


@pytest.fixture
def campaign_path(tmp_path: Path, rig_path: Path, make_record: Callable[[Path], Path]) -> Path:
    """A campaign of 5 shots, 2 reference views."""
    make_record(rig_path)
    path = tmp_path / "campaign.yaml"
    path.write_text(
        """\
name: small
title: A small campaign
rig: rig.yaml
calibration: record.json
seed: 3
trajectory:
  kind: straight_line
  start_trs_m: [1.08, 2.08, 3.0]
  end_trs_m: [1.08, 2.08, 2.0]
  n_points: 5
database:
  n_views: 2
  rays_per_pixel: 1
camera:
  exposure_s: 0.02
settle:
  wait_s: 0.0
"""
    )
    return path
