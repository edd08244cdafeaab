from pathlib import Path

import pytest

from tronlab.cli.demo import DEMO_CAMPAIGN, find_campaign, free_folder
from tronlab.errors import ConfigError


def test_folder_in_use_stays_as_it_is(tmp_path: Path) -> None:
    announced: list[str] = []
    out = tmp_path / "demo"
    assert free_folder(out, announce=announced.append) == out
    out.mkdir()
    assert free_folder(out, announce=announced.append) == out
    assert announced == []
    (out / "dataset.h5").touch()
    (tmp_path / "demo-2").touch()
    assert free_folder(out, announce=announced.append) == tmp_path / "demo-3"
    assert announced == [f"{out} is in use and stays as it is; this run goes to {out}-3"]


def test_campaign_of_the_working_directory_comes_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    in_checkout = find_campaign()
    assert in_checkout == Path(__file__).resolve().parents[3] / DEMO_CAMPAIGN
    (tmp_path / "campaigns").mkdir()
    (tmp_path / DEMO_CAMPAIGN).touch()
    assert find_campaign() == DEMO_CAMPAIGN


def test_without_a_checkout_the_demo_says_where_it_looked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("tronlab.cli.demo.__file__", str(tmp_path / "a" / "b" / "demo.py"))
    with pytest.raises(ConfigError, match=rf"straight_line\.yaml: no such file.*{tmp_path}"):
        find_campaign()
