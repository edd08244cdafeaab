"""What ``score.json`` says of a scoring: of what, with what, when."""

import os
import platform
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

from tronlab.score.rescoring.job import Scoring

_SOFTWARE = ("tronlab", "numpy", "scipy", "opencv-contrib-python-headless")


def score_info(scoring: Scoring) -> dict[str, Any]:
    """Give the content of ``score.json``, as far as the files beside it do not matter."""
    job = scoring.job
    return {
        "dataset": os.path.relpath(job.dataset_path.resolve(), job.out_dir.resolve()),
        "dataset_uuid": scoring.uuid,
        "cores": list(job.names),
        "definitions": _definitions(scoring),
        "n_shots": len(scoring.shots),
        "scored_utc": datetime.now(UTC).isoformat(timespec="seconds"),
        "software": {"python": platform.python_version()}
        | {name: version(name) for name in _SOFTWARE},
    }


def _definitions(scoring: Scoring) -> dict[str, dict[str, Any]]:
    """Give what each name stands for."""
    job = scoring.job
    definitions: dict[str, dict[str, Any]] = {}
    for core in scoring.cores:
        spec = core.spec
        defined = {"kind": spec.kind, "target": spec.target, "settings": dict(spec.settings)}
        if core.version:
            defined["version"] = core.version
        defined |= {
            "seeds": [],
            "prior": None if job.prior is None else job.prior.model_dump(mode="json"),
            "time_limit_s": job.time_limit_s,
        }
        definitions.setdefault(spec.name, defined)["seeds"].append(spec.seed)
    return definitions
