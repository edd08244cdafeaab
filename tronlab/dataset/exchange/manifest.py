"""Where an export comes from and how to read it: ``README.txt`` for people, ``tronlab.json``."""

import json
from collections.abc import Mapping
from pathlib import Path

from tronlab import __version__
from tronlab.dataset.drift import doubts
from tronlab.dataset.exchange.folder import flags_of
from tronlab.dataset.reader import Dataset

README = "README.txt"
MANIFEST = "tronlab.json"


def write_manifest(
    folder: Path, dataset: Dataset, *, format_name: str, conventions: str, images: Mapping[int, str]
) -> None:
    """Write both files.

    Args:
        folder: The export.
        dataset: Where it comes from.
        format_name: As the command line calls it.
        conventions: Of the format.
        images: Where in the folder the image of each shot is, by shot id.

    Raises:
        OSError: The disk does not take them.
    """
    flags = {shot_id: flags_of(dataset, i) for i, shot_id in enumerate(dataset.shot_ids.tolist())}
    provenance = dataset.provenance
    origin = {
        "dataset": dataset.path.name,
        "uuid": dataset.uuid or "none, its layout is older than 2.0",
        "campaign": provenance.campaign_name,
        "rig": provenance.rig_name,
        "recorded": dataset.start_time,
        "status": dataset.status,
        "plan_sha256": provenance.plan_sha256,
        "tronlab": __version__,
        "format": format_name,
    }
    rows = [
        {
            "shot_id": shot_id,
            "image": images[shot_id],
            "truth_state": state,
            "flags": flags[shot_id].split(),
        }
        for shot_id, state in zip(dataset.shot_ids.tolist(), dataset.truth_states, strict=True)
    ]
    manifest = json.dumps({**origin, "shots": rows}, indent=1)
    (folder / MANIFEST).write_text(manifest, encoding="utf-8")
    lines = [f"{name}: {text}" for name, text in origin.items()]
    about_shots = [
        f"{dataset.n_shots} of {provenance.n_shots_planned} planned shots",
        *doubts(dataset.shot_ids.tolist(), dataset.truth_states),
        *(f"shot {shot_id} was flagged: {text}" for shot_id, text in flags.items() if text),
    ]
    text = "\n".join(["Exported by tronlab.", "", *lines, "", conventions, *about_shots])
    (folder / README).write_text(f"{text}\n", encoding="utf-8")
