"""The example of docs/how-to/add_a_navigation_core.md works as it is printed."""

import re
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

from tronlab.dataset.reader import Dataset
from tronlab.errors import ScoreError
from tronlab.nav import cores
from tronlab.nav.core import CoreContext
from tronlab.score.rescore import score_dataset
from tronlab.score.results import load_results

HOWTO = Path(__file__).parents[3] / "docs/how-to/add_a_navigation_core.md"


def block(language: str) -> str:
    (text,) = re.findall(
        rf"^```{language}\n(.*?)^```$", HOWTO.read_text(), re.DOTALL | re.MULTILINE
    )
    return text


@pytest.fixture
def plug_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """The module of the page, importable and declared as its pyproject.toml says."""
    folder = tmp_path / "plug_in"
    folder.mkdir()
    (folder / "nearest_view.py").write_text(block("python"))
    monkeypatch.syspath_prepend(folder)
    declared = tomllib.loads(block("toml"))["project"]["entry-points"]
    points = [
        EntryPoint(name, value, group)
        for group, entries in declared.items()
        for name, value in entries.items()
    ]
    monkeypatch.setattr(
        cores, "entry_points", lambda group: [p for p in points if p.group == group]
    )
    yield points[0].load() and sys.modules["nearest_view"]
    del sys.modules["nearest_view"]


@pytest.mark.usefixtures("plug_in")
def test_it_scores_a_dataset_under_the_name_it_declares(small_dataset: Path) -> None:
    score_dataset(small_dataset, cores=["nearest-view"], workers=1)
    table = pd.read_csv(small_dataset.parent / "scores.csv")
    assert table["core"].tolist() == ["nearest-view"] * 5
    assert table["status"].tolist() == ["ok"] * 5, load_results(small_dataset.parent).reasons
    assert table["position_error_m"].max() < 3.0  # both views are within that of every shot


def test_it_answers_the_pose_of_the_view_it_is_shown(
    plug_in: ModuleType, small_dataset: Path
) -> None:
    with Dataset(small_dataset) as dataset:
        references = dataset.references()
        core = plug_in.make(CoreContext(dataset.camera, references))
    assert core.name == "nearest-view"
    for view in references:
        result = core.locate(view.image.astype(np.uint16) * 16, view.mask)
        assert result.trs_from_cam is not None
        np.testing.assert_allclose(
            result.trs_from_cam.as_matrix(), view.trs_from_cam.as_matrix(), atol=1e-12
        )


@pytest.mark.parametrize("grey", [0, 255])
def test_it_says_why_there_is_no_pose(plug_in: ModuleType, small_dataset: Path, grey: int) -> None:
    with Dataset(small_dataset) as dataset:
        core = plug_in.make(CoreContext(dataset.camera, dataset.references()))
        flat = np.full(dataset.camera.shape, grey, np.uint8)
    for mask in (np.ones(flat.shape, np.bool_), np.zeros(flat.shape, np.bool_)):
        result = core.locate(flat, mask)
        assert (result.status, result.reason) == (
            "no_pose",
            "the image resembles no reference view",
        )


@pytest.mark.usefixtures("plug_in")
def test_a_mistyped_name_is_answered_with_the_known_ones(small_dataset: Path) -> None:
    with pytest.raises(ScoreError, match=r"no navigation core 'nearest_view'.*: nearest-view"):
        score_dataset(small_dataset, cores=["nearest_view"], workers=1)
