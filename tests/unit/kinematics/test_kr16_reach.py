"""From camera poses of the campaigns that ship to axes: all within the KR 16's limits, no flip."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from tronlab.calib.wizard.stations import POOL_SIZE, plan_stations
from tronlab.campaign.config import load_campaign
from tronlab.campaign.rig import load_rig
from tronlab.kinematics.kr16 import (
    KR16_LIMITS_RAD,
    Branch,
    axes_for,
    excesses,
    forward,
    singularities_near,
)
from tronlab.trajectory.poses import camera_poses
from tronlab.twin.world import initial_state

CAMPAIGNS = Path(__file__).parents[3] / "campaigns"


@pytest.fixture(scope="module")
def rig():
    return load_rig(CAMPAIGNS / "rigs" / "twin.yaml")


@pytest.fixture(scope="module")
def parked(rig):
    """Axes where the robot stands before anything moved."""
    at = initial_state(rig.world_setup()).robot_encoders.target
    return axes_for(at.base_from_flange, np.radians([0, -90, 90, 0, 0, 0]))


def follow(poses, start, mounting):
    path, current = [], start
    for trs_from_cam in poses:
        target = mounting.nominal.robot_target(trs_from_cam)
        current = axes_for(target.base_from_flange, current)
        np.testing.assert_allclose(
            forward(current).as_matrix(), target.base_from_flange.as_matrix(), atol=1e-9
        )
        path.append(current)
    return np.array(path)


def margin_deg(path):
    """The least distance of each axis from its limits, shape (6,)."""
    low, high = KR16_LIMITS_RAD.T
    return np.degrees(np.minimum(path - low, high - path).min(axis=0))


def test_every_pose_of_the_straight_line_is_reached_in_one_branch(rig, parked):
    campaign = load_campaign(CAMPAIGNS / "straight_line.yaml")
    poses = camera_poses(campaign.config.trajectory)
    assert len(poses) == 61
    path = follow(poses, parked, rig.config.laboratory.mounting)
    assert {Branch.of(axes) for axes in path} == {Branch.of(parked)}
    assert all(excesses(axes) == [] for axes in path)
    assert margin_deg(path).min() > 45.0
    assert not any(singularities_near(axes) for axes in path)
    assert max(np.abs(b - a).max() for a, b in pairwise(path)) < 1e-9  # only the rail moves


def test_every_station_of_the_calibration_is_reached(rig, parked):
    laboratory = rig.config.laboratory
    path = follow(plan_stations(laboratory), parked, laboratory.mounting)
    assert len(path) == POOL_SIZE
    assert all(excesses(axes) == [] for axes in path)


def test_the_rails_of_all_targets_leave_room_to_be_approached(rig):
    laboratory = rig.config.laboratory
    campaign = load_campaign(CAMPAIGNS / "straight_line.yaml")
    poses = [*camera_poses(campaign.config.trajectory), *plan_stations(laboratory)]
    rails = [laboratory.mounting.nominal.robot_target(pose).rail_m for pose in poses]
    low, high = laboratory.mounting.rail_range_m
    assert low + 0.02 <= min(rails)
    assert max(rails) <= high
