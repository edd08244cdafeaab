"""Computational load: time a stage and memory, by image size, features and landmarks."""

import json
import os
import platform
import shutil
import subprocess  # of ourselves
import sys
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

from tronlab.errors import ScoreError
from tronlab.nav.settings import PRESETS, DetectorSettings, core_settings
from tronlab.study.calibration import calibration_steps
from tronlab.study.config import DatasetName, LoadConfig
from tronlab.study.keys import RECORDING_CODE, key_of
from tronlab.study.load_frames import frames_file, make_frames
from tronlab.study.load_landmarks import LOW_THRESHOLDS, database_file, make_databases
from tronlab.study.load_process import LoadFigures, LoadJob
from tronlab.study.steps import Desk, Step
from tronlab.study.study import Study
from tronlab.study.writing import replace_text

FOLDER: Final = Path("load")
TABLE: Final = FOLDER / "load.csv"
MACHINE: Final = FOLDER / "machine.json"
"""On which computer the times were taken."""

Varied: TypeAlias = Literal["image", "features", "landmarks"]

_SCENE, _CASES = "scene", "cases"
_CODE = (
    *RECORDING_CODE,
    "nav",
    *(f"study/load{part}.py" for part in ("", "_frames", "_landmarks", "_process")),
)
_SCENE_S, _CASE_S, _A_LANDMARK_S = 40.0, 5.0, 5e-5
_ONE_THREAD: Final = {
    f"{library}_NUM_THREADS": "1" for library in ("OPENBLAS", "OMP", "MKL", "NUMBA")
}


@dataclass(frozen=True, slots=True)
class LoadCase:
    """What one process measures."""

    varied: Varied
    value: int
    core: str
    image_px: int
    n_features: int | None = None
    """Most features of an image; None: as the core has it."""
    n_landmarks: int | None = None
    """None: those of the approach."""

    @property
    def name(self) -> str:
        """Get what tells it from the others."""
        return f"{self.varied}-{self.value}-{self.core}"


def load_steps(study: Study) -> list[Step]:
    """Measure the load of the cores.

    Raises:
        ConfigError: A core is none of the built-in ones.
    """
    check_cores(study)
    dataset = load_dataset(study)
    record = study.record_path(dataset)
    before = [step for step in calibration_steps(study) if record in step.results]
    files = [study.campaign_file(dataset), study.rig_file(dataset)]
    config = study.load
    n_cases = len(list(cases_of(config, image_px=1)))
    return [
        Step(
            "computational load",
            key_of(files=files, code=_CODE, after=before, load=config.model_dump(mode="json")),
            cost=_SCENE_S + _CASE_S * n_cases + _A_LANDMARK_S * max(config.n_landmarks),
            run=partial(_measure, study=study, dataset=dataset),
            results=(TABLE, MACHINE),
        )
    ]


def check_cores(study: Study) -> None:
    """Look whether all cores are built-in ones, whose stages are known.

    Raises:
        ConfigError: One is not.
    """
    for i, core in enumerate(study.load.cores):
        if core not in PRESETS:
            where = ("quick", "load") if study.quick else ("load",)
            raise study.error(
                f"no built-in core {core!r}; there are: {', '.join(PRESETS)}", *where, "cores", i
            )


def load_dataset(study: Study) -> DatasetName:
    """Give the dataset whose laboratory and poses the images are taken with."""
    usual: DatasetName = "dataset_1_nominal"
    return usual if usual in study.datasets else study.datasets[0]


def cases_of(config: LoadConfig, *, image_px: int) -> Iterator[LoadCase]:
    """Give all cases: one quantity is varied at a time.

    Args:
        config: What is varied.
        image_px: Pixels in a row of the calibrated camera, where they are not varied.
    """
    for core in config.cores:
        for side_px in config.image_px:
            yield LoadCase("image", side_px, core, side_px)
        for n in config.n_features:
            yield LoadCase("features", n, core, image_px, n_features=n)
        for n in config.n_landmarks:
            yield LoadCase("landmarks", n, core, image_px, n_landmarks=n)


def _measure(desk: Desk, *, study: Study, dataset: DatasetName) -> None:
    """Make images and databases, let each case have a process of its own, write the table."""
    folder, config = desk.out / FOLDER, study.load
    if not desk.is_begun:
        shutil.rmtree(folder, ignore_errors=True)
    scene, kept = folder / _SCENE, folder / _CASES
    image_px = _make_scene(desk, study, dataset, scene)
    cases = list(cases_of(config, image_px=image_px))
    rows: list[dict[str, Any]] = []
    for n_done, case in enumerate(cases):
        desk.live.advance("measure", n_done=n_done, n_all=len(cases))
        path = kept / f"{case.name}.json"
        if not path.exists():
            # One after the other: two at a time would wait for each other's memory.
            figures = measured(job_of(case, scene, n_images=config.n_images))
            replace_text(path, figures.model_dump_json())
        figures = LoadFigures.model_validate_json(path.read_text(encoding="utf-8"))
        rows.append({**asdict(case), **figures.model_dump(), "n_images": config.n_images})
    _write_table(rows, desk.out / TABLE)
    replace_text(desk.out / MACHINE, json.dumps(machine(), indent=1))
    shutil.rmtree(scene)
    shutil.rmtree(kept)


def _make_scene(desk: Desk, study: Study, dataset: DatasetName, folder: Path) -> int:
    """Make images and databases; give how many pixels the calibrated camera has in a row."""
    from tronlab.campaign.acceptance import Acceptance
    from tronlab.campaign.job import Files, read_job

    config, live = study.load, desk.live
    job = read_job(
        Files(
            study.campaign_file(dataset),
            study.rig_file(dataset),
            study.record_path(dataset, desk.out),
        ),
        seed=None,
        acceptance=Acceptance(is_given=False, warn=live.announce),
    )
    standard_px = job.calibration.camera.width_px
    is_made = folder / "complete"
    if is_made.exists():
        return standard_px
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    make_frames(
        job,
        folder,
        image_px=sorted({*config.image_px, standard_px}),
        n_images=config.n_images,
        on_part=lambda done, n: live.advance("images of all sizes", n_done=done, n_all=n),
    )
    make_databases(
        job,
        folder,
        _detectors(config),
        image_px=config.image_px,
        n_landmarks=config.n_landmarks,
        on_part=lambda done, n: live.advance("landmarks", n_done=done, n_all=n),
    )
    is_made.touch()
    return standard_px


def _detectors(config: LoadConfig) -> list[DetectorSettings]:
    """Give the detector of each kind of features that a core uses."""
    settings = [core_settings(core, {}).detector for core in config.cores]
    return list({detector.features: detector for detector in settings}.values())


def job_of(case: LoadCase, scene: Path, *, n_images: int) -> LoadJob:
    """Say what a process is to measure."""
    features = core_settings(case.core, {}).detector.features
    database = database_file(scene, features, image_px=case.image_px, n_landmarks=case.n_landmarks)
    settings: dict[str, Any] = {}
    if case.n_features is not None:
        settings["detector"] = {"n_max": case.n_features, "threshold": LOW_THRESHOLDS[features]}
    return LoadJob(
        core=case.core,
        database=database.absolute(),
        settings=settings,
        frames=frames_file(scene, case.image_px).absolute(),
        n_images=n_images,
    )


def measured(job: LoadJob) -> LoadFigures:
    """Measure in a new process of one thread.

    Raises:
        ScoreError: The process ends without an answer.
    """
    done = subprocess.run(  # of ourselves
        [sys.executable, "-m", "tronlab.study.load_process"],
        input=job.model_dump_json(),
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **_ONE_THREAD},
    )
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
        raise ScoreError(
            f"computational load of {job.core} with {job.settings}: the process that measures ended"
            f" with code {done.returncode}: {last}"
        )
    return LoadFigures.model_validate_json(done.stdout)


def machine() -> Mapping[str, Any]:
    """Give what the times depend on."""
    import cv2
    import numpy as np

    return {
        "processor": _processor(),
        "n_processors": os.cpu_count(),
        "system": platform.platform(),
        "threads": 1,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
    }


def _processor() -> str:
    """Give the name of the processor."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in text.splitlines() if "model name" in line]
    return names[0] if names else platform.machine()


def _write_table(rows: list[dict[str, Any]], path: Path) -> None:
    import pandas as pd

    replace_text(path, pd.DataFrame(rows).to_csv(index=False))
