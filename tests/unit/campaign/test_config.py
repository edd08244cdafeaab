from pathlib import Path

import pytest

from tronlab.campaign.config import CampaignConfig, load_campaign
from tronlab.errors import ConfigError
from tronlab.trajectory.config import StraightLine
from tronlab.yaml_models import parse_model

REPOSITORY = Path(__file__).resolve().parents[3]
TEXT = """\
name: small
rig: rig.yaml
calibration: record.json
trajectory:
  kind: straight_line
  start_trs_m: [1, 2, 3]
  end_trs_m: [1, 2, 1]
  n_points: 5
camera:
  exposure_s: 0.02
"""


def load(tmp_path: Path, text: str) -> object:
    for name in ("rig.yaml", "record.json"):
        (tmp_path / name).touch()
    (tmp_path / "campaign.yaml").write_text(text)
    return load_campaign(tmp_path / "campaign.yaml")


def test_straight_line_of_the_paper_as_it_is_committed() -> None:
    path = REPOSITORY / "campaigns/straight_line.yaml"
    campaign = load_campaign(path, overridden={"calibration"})
    assert isinstance(campaign.config.trajectory, StraightLine)
    assert campaign.config.trajectory.n_points == 61
    assert campaign.config.trajectory.start_trs_m[2] == 4.0
    assert campaign.config.trajectory.end_trs_m[2] == 1.0
    assert campaign.config.database.n_views == 11
    assert campaign.text == path.read_text(encoding="utf-8")


def test_comments_of_the_straight_line_show_the_defaults() -> None:
    """Every commented-out key, put into force, is accepted and changes nothing."""
    path = REPOSITORY / "campaigns/straight_line.yaml"
    lines = path.read_text(encoding="utf-8").splitlines()
    uncommented = "\n".join(
        line.replace("# ", "", 1) if _is_commented_key(line) else line for line in lines
    )
    assert uncommented.count("timeout_s") == 3
    original = parse_model("\n".join(lines), CampaignConfig, path=path, overridden={"calibration"})
    assert original == parse_model(
        uncommented, CampaignConfig, path=path, overridden={"calibration"}
    )


def _is_commented_key(line: str) -> bool:
    key = line.strip().removeprefix("# ").split(":")[0]
    return line.strip().startswith("# ") and key in {
        "robot",
        "  timeout_s",
        "timeout_s",
        "window_s",
        "max_shift_m",
        "max_turn_deg",
    }


def test_missing_calibration_says_how_to_make_it(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"no such file: .*gone\.json; make it: tronlab"):
        load(tmp_path, TEXT.replace("record.json", "gone.json"))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("exposure_s", "exposure_ms", "9: camera.exposure_s: required key is missing"),
        ("exposure_s", "exposure_ms", "10: camera.exposure_ms: unknown key, did you mean exposure"),
        ("exposure_s: 0.02", "exposure_s: 0", "10: camera.exposure_s: must be greater than 0"),
        (
            "n_points: 5",
            "n_points: 0",
            "8: trajectory.n_points: must be greater than or equal to 1",
        ),
        ("n_points: 5", "n_points: 2.5", "8: trajectory.n_points: must be a valid integer"),
        ("rig: rig.yaml", "rig: gone.yaml", "2: rig: no such file: "),
        ("record.json", "gone.json", "3: calibration: no such file: "),
        ("name: small", "name: a/b", "1: name: String should match pattern"),
        ("[1, 2, 1]", "[1, 2, 3]", "4: trajectory: start_trs_m and end_trs_m are the same point"),
        ("name: small", "name: small\nseed: -1", "2: seed: must be greater than or equal to 0"),
        (
            "name: small",
            "name: small\nscore: {cores: []}",
            "2: score.cores: Tuple should have at least 1 item",
        ),
    ],
)
def test_bad_input_is_named_by_line_and_key(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, TEXT.replace(old, new))
    assert f"{tmp_path}/campaign.yaml:{message}" in str(caught.value)
