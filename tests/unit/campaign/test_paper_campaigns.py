"""The campaigns of the paper as they are committed."""

from pathlib import Path

import pytest

from tronlab.campaign.config import CampaignConfig, load_campaign
from tronlab.trajectory.config import PoweredDescent, StraightLine

PAPER = Path(__file__).resolve().parents[3] / "campaigns" / "paper"


def campaign(name: str) -> CampaignConfig:
    path = PAPER / f"{name}.yaml"
    return load_campaign(path, overridden={"rig", "calibration"}).config


def test_dataset_0_is_the_straight_line_in_another_laboratory() -> None:
    config = campaign("dataset_0")
    assert isinstance(config.trajectory, StraightLine)
    assert (config.trajectory.n_points, config.database.n_views) == (61, 11)
    assert config.rig.name == "tron.yaml"


@pytest.mark.parametrize(
    ("number", "rig", "n_flown"), [(1, "tron.yaml", 20), (2, "tron_35deg.yaml", 6)]
)
def test_perturbed_descents_are_matched_with_the_nominal_ones(
    number: int, rig: str, n_flown: int
) -> None:
    nominal, perturbed = (campaign(f"dataset_{number}_{kind}") for kind in ("nominal", "perturbed"))
    assert isinstance(nominal.trajectory, PoweredDescent)
    assert isinstance(perturbed.trajectory, PoweredDescent)
    assert nominal.trajectory.perturbed is None
    assert perturbed.trajectory.perturbed is not None
    assert len(perturbed.trajectory.perturbed.numbers) == n_flown
    database = nominal.database.trajectory
    assert isinstance(database, PoweredDescent)
    assert perturbed.database.trajectory == database
    assert database.model_copy(update={"sampling": nominal.trajectory.sampling}) == (
        nominal.trajectory
    )
    assert perturbed.trajectory.start == nominal.trajectory.start
    assert nominal.rig.name == perturbed.rig.name == rig


def test_dataset_2_begins_where_dataset_1_ends() -> None:
    near, far = (campaign(f"dataset_{i}_nominal").database.trajectory for i in (1, 2))
    assert isinstance(near, PoweredDescent)
    assert isinstance(far, PoweredDescent)
    assert near.sampling.height_m[1] == far.sampling.height_m[0]
    assert near.sampling.spacing_m == far.sampling.spacing_m
