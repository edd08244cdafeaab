"""Keys change with everything that results depend on, and with nothing else."""

from pathlib import Path

import pytest

from tronlab.study import keys
from tronlab.study.keys import forget_files, key_of
from tronlab.study.steps import Step
from tronlab.study.variants import Variant


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """A campaign that names a rig, which extends another one, which names a terrain."""
    (tmp_path / "campaign.yaml").write_text("rig: rigs/variant.yaml\n")
    (tmp_path / "rigs").mkdir()
    (tmp_path / "rigs/variant.yaml").write_text("extends: rig.yaml\nchanges: {a: 1}\n")
    (tmp_path / "rigs/rig.yaml").write_text("terrain: {path: dem.npy}  # heights\n")
    (tmp_path / "rigs/dem.npy").write_bytes(b"heights")
    return tmp_path


def key_now(folder: Path) -> str:
    forget_files()
    return key_of(files=[folder / "campaign.yaml"])


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("rigs/variant.yaml", "extends: rig.yaml\nchanges: {a: 2}\n"),
        ("rigs/rig.yaml", "terrain: {path: dem.npy, b: 1}\n"),
        ("rigs/dem.npy", "other heights"),
    ],
)
def test_a_file_behind_a_file_counts(files: Path, name: str, text: str) -> None:
    before = key_now(files)
    (files / name).write_text(text)
    assert key_now(files) != before


def test_comments_and_the_place_of_the_files_do_not_count(files: Path, tmp_path: Path) -> None:
    before = key_now(files)
    (files / "rigs/rig.yaml").write_text("# other words\nterrain: {path: 'dem.npy'}\n")
    assert key_now(files) == before
    moved = files.rename(tmp_path.with_name("elsewhere"))
    assert key_now(moved) == before


def test_files_that_extend_each_other_have_a_key(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("extends: b.yaml\n")
    (tmp_path / "b.yaml").write_text("extends: a.yaml\n")
    assert key_of(files=[tmp_path / "a.yaml"])  # reading them complains


def test_settings_and_steps_before_count() -> None:
    def before(key: str) -> Step:
        return Step("before", key, 1.0, lambda _: None, ())

    same = key_of(after=[before("k")], cores=("a", "b"))
    assert key_of(after=[before("k")], cores=["a", "b"]) == same
    assert key_of(after=[before("k")], cores=("b", "a")) != same
    assert key_of(after=[before("l")], cores=("a", "b")) != same


def test_code_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(keys, "_PACKAGE", tmp_path)
    (tmp_path / "nav").mkdir()
    (tmp_path / "nav/core.py").write_text("x = 1\n")
    forget_files()
    before = key_of(code=["nav"])
    (tmp_path / "nav/core.py").write_text("x = 2\n")
    forget_files()
    assert key_of(code=["nav"]) != before
    forget_files()


def test_a_misspelt_package_is_no_key() -> None:
    with pytest.raises(FileNotFoundError):
        key_of(code=["navv"])


def test_a_variant_is_what_it_extends_and_changes(files: Path) -> None:
    rig = files / "rigs/rig.yaml"
    forget_files()
    assert Variant(rig, {"a": 1}).key == Variant(rig, {"a": 1}).key
    assert Variant(rig, {"a": 1}).key != Variant(rig, {"a": 1.5}).key != Variant(rig).key
