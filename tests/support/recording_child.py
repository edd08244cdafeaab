"""What a child process does that records into a dataset until it is done, or killed.

A server that has imported this module forks such children: they begin at once.
"""

import os
import sys
from pathlib import Path

import tronlab.campaign.run as campaign_run
import tronlab.render.heightfield  # a child would import it later
import tronlab.twin.devices  # noqa: F401


def go_on(campaign_path: Path, out: Path) -> None:
    """Begin to record, or resume; errors go to a file beside the dataset."""
    sys.stderr = (out.parent / f"errors-{os.getpid()}.txt").open("w")
    if (out / "dataset.h5").exists():
        campaign_run.resume_campaign(out)
    else:
        campaign_run.run_campaign(campaign_path, out_dir=out)
