"""The pages about cores of one's own work as they are printed."""

import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from core_peer import Peer, frame, hello, pose_of, setup

from tronlab.dataset.reader import Dataset
from tronlab.errors import ScoreError
from tronlab.nav.core import CoreContext, Frame, PosePrior, SequentialCore
from tronlab.nav.cores import is_built_in
from tronlab.nav.foreign import open_core
from tronlab.nav.specs import parse_core
from tronlab.score.rescore import score_dataset
from tronlab.score.sweep import load_sweep

ROOT = Path(__file__).parents[3]
HOWTO = ROOT / "docs/how-to/add_a_navigation_core.md"
TUTORIAL = ROOT / "docs/tutorials/first_core.md"


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", page.read_text(), re.DOTALL | re.MULTILINE)


@pytest.fixture
def plug_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """The modules of the page, importable, and installed as its pyproject.toml says."""
    folder = tmp_path / "plug_in"
    (text,) = blocks(HOWTO, "toml")
    project = tomllib.loads(text)["project"]
    told = folder / f"nearest_view-{project['version']}.dist-info"
    told.mkdir(parents=True)
    (told / "METADATA").write_text(f"Name: {project['name']}\nVersion: {project['version']}\n")
    lines: list[str] = []
    for group, entries in project["entry-points"].items():
        lines += [f"[{group}]", *(f"{name} = {value}" for name, value in entries.items())]
    (told / "entry_points.txt").write_text("\n".join(lines))
    for name, code in zip(("nearest_view", "stands_still"), blocks(HOWTO, "python"), strict=True):
        (folder / f"{name}.py").write_text(code)
    monkeypatch.syspath_prepend(folder)
    yield import_module("nearest_view")
    for name in ("nearest_view", "stands_still"):
        sys.modules.pop(name, None)


def test_the_page_prints_the_example() -> None:
    example = ROOT / "examples/cores/nearest_view.py"
    assert blocks(HOWTO, "python")[0] == example.read_text()


@pytest.mark.usefixtures("plug_in")
def test_it_is_found_and_hosted_under_the_name_it_declares(small_dataset: Path) -> None:
    spec = parse_core("nearest-view")
    assert not is_built_in(spec)
    with Dataset(small_dataset) as dataset:
        references = dataset.references()
        context = CoreContext(dataset.camera, references)
    with open_core(spec, context, limit_s=60.0) as core:
        for view in references:
            result = core.locate(Frame(view.image, view.mask))
            assert result.trs_from_cam is not None, result.reason
            expected = view.trs_from_cam.as_matrix()
            np.testing.assert_allclose(result.trs_from_cam.as_matrix(), expected, atol=1e-12)


@pytest.mark.usefixtures("plug_in")
def test_the_core_with_state_goes_on_from_the_prior_until_it_is_reset(
    small_dataset: Path,
) -> None:
    with Dataset(small_dataset) as dataset:
        view = dataset.references()[0]
        core = import_module("stands_still").StandsStill(CoreContext(dataset.camera, ()))
    assert isinstance(core, SequentialCore)
    prior = PosePrior(view.trs_from_cam, np.eye(6))
    assert core.locate(Frame(view.image, view.mask)).status == "no_pose"
    for frame_ in (Frame(view.image, view.mask, prior=prior), Frame(view.image, view.mask)):
        assert core.locate(frame_).trs_from_cam is view.trs_from_cam
    core.reset()
    assert core.locate(Frame(view.image, view.mask)).status == "no_pose"


def test_it_answers_the_pose_of_the_view_it_is_shown(
    plug_in: ModuleType, small_dataset: Path
) -> None:
    with Dataset(small_dataset) as dataset:
        references = dataset.references()
        core = plug_in.NearestView(CoreContext(dataset.camera, references))
    for view in references:
        result = core.locate(Frame(view.image.astype(np.uint16) * 16, view.mask))
        assert result.trs_from_cam is not None
        np.testing.assert_allclose(
            result.trs_from_cam.as_matrix(), view.trs_from_cam.as_matrix(), atol=1e-12
        )


@pytest.mark.parametrize("grey", [0, 255])
def test_it_says_why_there_is_no_pose(plug_in: ModuleType, small_dataset: Path, grey: int) -> None:
    with Dataset(small_dataset) as dataset:
        core = plug_in.NearestView(CoreContext(dataset.camera, dataset.references()))
        flat = np.full(dataset.camera.shape, grey, np.uint8)
    for mask in (np.ones(flat.shape, np.bool_), np.zeros(flat.shape, np.bool_)):
        result = core.locate(Frame(flat, mask))
        assert (result.status, result.reason) == (
            "no_pose",
            "the image resembles no reference view",
        )


@pytest.mark.usefixtures("plug_in")
def test_a_mistyped_name_is_answered_with_the_known_ones(small_dataset: Path) -> None:
    with pytest.raises(ScoreError, match=r"no navigation core 'nearest_view'.*: .*nearest-view"):
        score_dataset(small_dataset, cores=["nearest_view"], workers=1)


def test_the_four_ways_to_name_a_core_are_read_as_the_page_says() -> None:
    title, *named = re.findall(r"^\| `([^`]+)` \|", HOWTO.read_text(), re.MULTILINE)
    assert title == "--core"
    kinds = [parse_core(text).kind for text in named]
    assert kinds == ["command", "python", "installed", "tcp"], named


def test_the_core_of_the_tutorial_compiles_and_answers(small_dataset: Path, tmp_path: Path) -> None:
    if not shutil.which("cc"):
        pytest.skip("no C compiler")
    source, program = tmp_path / "first.c", tmp_path / "first"
    (code,) = blocks(TUTORIAL, "c")
    source.write_text(code)
    strict = ("-Wall", "-Wextra", "-Werror", f"-I{ROOT / 'examples/cores'}")
    subprocess.run(["cc", *strict, "-o", program, source, "-lm"], check=True)
    with Dataset(small_dataset) as dataset:
        camera, references = dataset.camera, dataset.references()
    with Peer(program) as peer:
        peer.ask(hello())
        assert peer.ask(setup(camera, references))[0] == {"type": "ready"}
        said, _ = peer.ask(frame(3, references[1].image, references[1].mask))
        assert said["pose"] == pose_of(references[0].trs_from_cam)
        assert peer.end() == (0, "frame 3 has 64 columns\n")


def test_the_sweep_of_the_tutorial_can_be_read(tmp_path: Path) -> None:
    (text,) = blocks(TUTORIAL, "yaml")
    (tmp_path / "sweep.yaml").write_text(text)
    names = [variant.spec.name for variant in load_sweep(tmp_path / "sweep.yaml").variants]
    assert names == ["nearest@min_likeness=0.2", "nearest@min_likeness=0.4"]
