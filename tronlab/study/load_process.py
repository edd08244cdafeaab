"""One measurement of the computational load, in a process of its own: ``python -m`` runs it.

It reads a ``LoadJob`` as JSON from standard input and writes a ``LoadFigures`` as JSON to standard
output. The process has done nothing else, so its peak of memory is that of the navigation core.
"""

import json
import sys
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

from tronlab.yaml_models import Model

_STATUS = Path("/proc/self/status")


class LoadJob(Model):
    """A core and what it is to look at."""

    core: str
    database: Path
    settings: dict[str, Any]
    """Of the core, else as it is."""
    frames: Path
    """File of images; see ``load_frames``."""
    n_images: int


class LoadFigures(Model):
    """What was measured; medians over the images."""

    start_s: float
    """To make the core and its index of the database, once."""
    time_detect_s: float
    time_match_s: float
    time_pose_s: float
    time_all_s: float
    """From the image to the answer."""
    peak_memory_mb: float | None
    """1e6 bytes, of the whole process; None where the operating system does not tell."""
    start_memory_mb: float | None
    """Before the core was made: Python and its libraries."""
    n_features: float
    n_landmarks: int
    error_pct_los: float | None
    """Of position, with the median distance of the terrain as line of sight; None if no image was
    solved."""
    n_solved: int


def measure(job: LoadJob) -> LoadFigures:
    """Let the core look at the images, one thread."""
    import cv2
    import numpy as np
    from scipy.spatial.transform import RigidTransform

    from tronlab.geometry.camera import CameraModel
    from tronlab.nav.core import CoreContext, Frame
    from tronlab.nav.cores import make_core
    from tronlab.nav.database_file import open_database
    from tronlab.nav.specs import CoreSpec

    cv2.setNumThreads(1)
    with np.load(job.frames) as frames:
        camera = CameraModel.from_dict(json.loads(str(frames["camera"])))
        start_memory_mb, start_s = _memory_mb("VmRSS"), perf_counter()
        settings = {**job.settings, "database": str(job.database)}
        spec = CoreSpec(job.core, "installed", job.core, settings)
        core = make_core(spec, CoreContext(camera, ()))
        # The first image of all, here one upside down, waits for the index and for the libraries.
        core.locate(Frame(frames["image_0"][::-1].copy(), frames["mask_0"][::-1].copy()))
        made_s = perf_counter() - start_s
        answers: list[Any] = []
        times_s: list[float] = []
        errors_pct: list[float] = []
        for i in range(job.n_images):
            frame = Frame(frames[f"image_{i}"], frames[f"mask_{i}"])
            begun_s = perf_counter()
            answer = core.locate(frame)
            times_s.append(perf_counter() - begun_s)
            answers.append(answer)
            if answer.trs_from_cam is not None:
                truth = RigidTransform.from_matrix(frames[f"pose_{i}"])
                error_m = np.linalg.norm(answer.trs_from_cam.translation - truth.translation)
                errors_pct.append(100.0 * float(error_m) / float(frames[f"range_m_{i}"]))
    return LoadFigures(
        start_s=made_s,
        time_detect_s=median(answer.time_detect_s for answer in answers),
        time_match_s=median(answer.time_match_s for answer in answers),
        time_pose_s=median(answer.time_pose_s for answer in answers),
        time_all_s=median(times_s),
        peak_memory_mb=_memory_mb("VmHWM"),
        start_memory_mb=start_memory_mb,
        n_features=median(answer.n_features for answer in answers),
        n_landmarks=len(open_database(job.database)),
        error_pct_los=median(errors_pct) if errors_pct else None,
        n_solved=len(errors_pct),
    )


def _memory_mb(field: str) -> float | None:
    """Read a line of what Linux says of this process.

    Not ``getrusage``: that begins with the peak of whoever started the process.
    """
    if not _STATUS.exists():
        return None
    lines = _STATUS.read_text(encoding="ascii").splitlines()
    fields = dict(line.split(":", 1) for line in lines)
    return int(fields[field].split()[0]) * 1024 / 1e6


if __name__ == "__main__":
    print(measure(LoadJob.model_validate_json(sys.stdin.read())).model_dump_json())
