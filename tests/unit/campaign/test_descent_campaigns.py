"""Campaigns that fly a powered descent: mistakes have a place in the file."""

from pathlib import Path

import pytest

from tronlab.campaign.acceptance import Acceptance
from tronlab.campaign.job import Files, read_job
from tronlab.errors import ConfigError

NOMINAL = Path(__file__).parents[3] / "campaigns" / "paper" / "dataset_1_nominal.yaml"
TOO_FAST = "start: {velocity_m_per_s: [10, -10, -400]}"


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        (f"{{trajectory: {{{TOO_FAST}}}}}", "changes.trajectory.start"),
        (f"{{database: {{trajectory: {{{TOO_FAST}}}}}}}", "changes.database.trajectory.start"),
    ],
)
def test_a_start_nobody_lands_from_is_said_with_file_line_and_key(
    tmp_path: Path, changes: str, key: str
) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(f"extends: {NOMINAL}\nname: mine\nchanges: {changes}\n")
    acceptance = Acceptance(False, warn=lambda _: None)
    with pytest.raises(ConfigError, match=rf"mine\.yaml:3: {key}: there is no descent"):
        read_job(Files(path), seed=None, acceptance=acceptance)
