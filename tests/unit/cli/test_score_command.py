"""The command ``tronlab score``: what it asks for, where results go, what it prints."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
import typer
from scipy.spatial.transform import RigidTransform
from typer.testing import CliRunner, Result

from tronlab.cli.exit_codes import INTERRUPTED
from tronlab.cli.score import score
from tronlab.errors import TronlabError
from tronlab.nav.core import CoreContext, Frame, NavigationResult
from tronlab.nav.specs import CoreSpec
from tronlab.score import rescore
from tronlab.score.rescoring import job as job_module
from tronlab.score.rescoring.cluster import DaskExecutor
from tronlab.score.rescoring.job import ScoreJob
from tronlab.score.rescoring.opening import ScoredCore
from tronlab.score.rescoring.workers import ProcessExecutor

SWEEP = """
cores:
  akaze:
    sweep: {detector.n_max: [100, 200]}
seeds: [0, 1]
time_limit_s: 7
prior: {source: previous, position_sigma_m: 1, rotation_sigma_deg: 2}
"""


def run(*arguments: str | Path) -> Result:
    app = typer.Typer()
    app.command()(score)
    return CliRunner().invoke(app, [*map(str, arguments)])


def error_of(*arguments: str | Path) -> str:
    result = run(*arguments)
    assert isinstance(result.exception, TronlabError), result.output
    return str(result.exception)


class Asked:
    """What the command asked to be scored, before it was interrupted."""

    jobs: Sequence[ScoreJob]
    executor: object

    def score_jobs(self, jobs: Sequence[ScoreJob], *, executor: object, **_: Any) -> None:
        self.jobs, self.executor = jobs, executor
        raise KeyboardInterrupt("interrupted: their rows are in scores.partial.csv")


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> Asked:
    asked = Asked()
    monkeypatch.setattr(rescore, "score_jobs", asked.score_jobs)
    return asked


@pytest.fixture
def sweep_file(tmp_path: Path) -> Path:
    path = tmp_path / "sweep.yaml"
    path.write_text(SWEEP)
    return path


def test_ctrl_c_says_where_the_rows_are(asked: Asked, small_dataset: Path) -> None:
    result = run(small_dataset)
    assert result.exit_code == INTERRUPTED
    assert result.stderr == "interrupted: their rows are in scores.partial.csv\n"


def test_cores_are_the_campaigns_unless_named(asked: Asked, small_dataset: Path) -> None:
    run(small_dataset.parent)  # the folder of a run stands for its dataset
    (job,) = asked.jobs
    assert job.dataset_path == small_dataset
    assert job.names == rescore.cores_of_dataset(small_dataset)
    assert (job.prior, job.cache_dir is None) == (None, False)
    run(small_dataset, "--core", "one=cmd:prog --x", "--core", "a.b:C", "--fresh", "--seeds", 2)
    (job,) = asked.jobs
    assert [(c.name, c.kind, c.seed) for c in job.cores] == [
        ("one", "command", 0),
        ("one", "command", 1),
        ("C", "python", 0),
        ("C", "python", 1),
    ]
    assert job.cache_dir is None


def test_a_sweep_and_named_cores_are_both_scored(
    asked: Asked, small_dataset: Path, sweep_file: Path, tmp_path: Path
) -> None:
    (tmp_path / "landmarks.h5").touch()
    run(small_dataset, "--sweep", sweep_file, "--core", "brisk", "--core", "cmd:c")
    (job,) = asked.jobs
    assert job.names == ("akaze@n_max=100", "akaze@n_max=200", "brisk", "c")
    assert [spec.seed for spec in job.cores] == [0, 1] * 4
    assert job.time_limit_s == 7
    assert job.prior is not None
    assert job.prior.source == "previous"
    options = ("--time-limit", "2.5", "--prior", "truth:0.05,1", "--seeds", "1")
    database = ("--database", tmp_path / "landmarks.h5")
    run(small_dataset, "--sweep", sweep_file, "--core", "cmd:c", *options, *database)
    (job,) = asked.jobs
    assert job.time_limit_s == 2.5
    assert job.prior is not None
    assert job.prior.source == "truth"
    assert (job.prior.position_sigma_m, job.prior.rotation_sigma_deg) == (0.05, 1)
    landmarks = str(tmp_path / "landmarks.h5")
    assert [spec.settings for spec in job.cores] == [
        {"detector": {"n_max": 100}, "database": landmarks},
        {"detector": {"n_max": 200}, "database": landmarks},
        {},
    ]


def test_each_of_several_datasets_has_a_folder(
    asked: Asked, small_dataset: Path, recorded_datasets: Path, tmp_path: Path
) -> None:
    other = recorded_datasets / "in_segments" / "dataset.h5"
    run(small_dataset, other, small_dataset.parent, "--out", tmp_path / "out", "--core", "akaze")
    assert {job.dataset_path: job.out_dir for job in asked.jobs} == {
        small_dataset: tmp_path / "out" / small_dataset.parent.name,
        other: tmp_path / "out" / "in_segments",
    }
    run(small_dataset, other, "--core", "akaze")
    assert [job.out_dir for job in asked.jobs] == [small_dataset.parent, other.parent]
    run(small_dataset, "--out", tmp_path / "one", "--core", "akaze")
    assert [job.out_dir for job in asked.jobs] == [tmp_path / "one"]


def test_who_works(asked: Asked, small_dataset: Path) -> None:
    run(small_dataset, "--workers", "3")
    assert isinstance(asked.executor, ProcessExecutor)
    assert asked.executor.n_workers == 3
    run(small_dataset, "--cluster", "tcp://10.0.0.5:8786")
    assert isinstance(asked.executor, DaskExecutor)
    assert asked.executor.address == "tcp://10.0.0.5:8786"


def _beside(dataset: Path) -> list[str | Path]:
    return [dataset, dataset.with_name("b.h5"), "--core", "akaze"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (_beside, "would both go there; score them one at a time"),
        (lambda path: [path, "--workers", "2", "--cluster", "tcp://a:1"], "leave one out"),
        (lambda path: [path, "--database", "no.h5"], "no.h5: no such file; make it with: tronlab"),
        (lambda path: [path, "--prior", "truth"], "write SOURCE:M,DEG, for example truth:0.05,1"),
        (
            lambda path: [path, "--prior", "past:1,2"],
            "--prior.source: must be 'truth' or 'previous'",
        ),
        (lambda path: [path, "--prior", "truth:-1,2"], "position_sigma_m: must be greater than 0"),
        (lambda path: [path, "--prior", "truth:nan,2"], "--prior"),
        (lambda path: [path, "--time-limit", "0"], "--time-limit 0: must be more than 0 seconds"),
        (lambda path: [path, "--core", "cmd:"], "no program"),
        (lambda path: [path.parent / "no"], "no"),
    ],
)
def test_a_mistake_is_told(
    asked: Asked, small_dataset: Path, arguments: Callable[[Path], list[str | Path]], message: str
) -> None:
    assert message in error_of(*arguments(small_dataset))


def test_the_same_name_for_two_cores_is_told(
    asked: Asked, small_dataset: Path, sweep_file: Path
) -> None:
    sweep_file.write_text("cores: {brisk: {settings: {detector: {n_max: 5}}}, akaze: }")
    arguments = (small_dataset, "--sweep", sweep_file, "--core", "akaze", "--core")
    assert "both called 'brisk', and differ" in error_of(*arguments, "brisk")
    run(*arguments, "other=brisk")  # akaze is the same in both
    assert asked.jobs[0].names == ("brisk", "akaze", "other")


class Fake:
    """A core in this process, where others would be in one of their own."""

    name = "fake"

    def __init__(self, settings: Mapping[str, object]) -> None:
        self._settings = settings

    def locate(self, frame: Frame) -> NavigationResult:
        if "height_m" not in self._settings:
            raise ValueError("boom")
        height_m = float(str(self._settings["height_m"]))
        return NavigationResult("ok", RigidTransform.from_translation([1.0, 2.0, height_m]))


class FakeCore(ScoredCore):
    def open(self, context: CoreContext, *, limit_s: float) -> Fake:
        return Fake(context.settings)


@pytest.fixture
def fakes(monkeypatch: pytest.MonkeyPatch) -> None:
    def describe(specs: Sequence[CoreSpec]) -> tuple[ScoredCore, ...]:
        return tuple(FakeCore(spec, f"{spec.name} {spec.seed}") for spec in specs)

    monkeypatch.setattr(job_module, "describe_cores", describe)


@pytest.mark.usefixtures("fakes")
def test_says_which_cores_stay_and_why_one_has_no_pose(small_dataset: Path) -> None:
    options = [small_dataset, "--workers", "1", "--fresh", "--core"]
    assert run(*options, "b=fakes:Core").exit_code == 0
    result = run(*options, "raiser=fakes:Core")
    assert result.exit_code == 0, result.output
    for core in ("b", "raiser"):
        missing = f"{core}: 5 of 5 shots without a pose; first: shot 0, error: ValueError: boom\n"
        assert missing in result.stdout
    assert "scores.csv: of the earlier scoring: kept b\n" in result.stderr
    assert result.stdout.endswith(f"\nscores: {small_dataset.parent / 'scores.csv'}\n")


@pytest.mark.usefixtures("fakes")
def test_a_sweep_is_scored_listed_and_drawn(
    small_dataset: Path, sweep_file: Path, tmp_path: Path
) -> None:
    sweep_file.write_text(
        "cores: {f: {core: 'a.b:C', sweep: {height_m: [5, 4, 6]}}}\nseeds: [0, 1]"
    )
    out, core = tmp_path / "out", "raiser=a.b:C"
    arguments = ("--sweep", sweep_file, "--core", core, "--workers", "1", "--fresh", "--out", out)
    result = run(small_dataset, *arguments)
    assert result.exit_code == 0, result.output
    lines = result.stdout.splitlines()
    assert [line.split()[0] for line in lines[1:5]] == [
        "f@height_m=4",
        "f@height_m=5",
        "f@height_m=6",
        "raiser",
    ]
    assert lines[1].endswith(" 10/10")  # five shots, two seeds
    assert lines[4].split()[1:] == ["-", "-", "0/10"]
    assert lines[5].startswith("raiser: 10 of 10 shots without a pose; first: shot 0, error: ")
    assert {"sweep.csv", "sweep.png", "sweep.pdf", "scores.csv"} <= {p.name for p in out.iterdir()}
