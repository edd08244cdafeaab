from pathlib import Path

import numpy as np
import pytest

from tronlab.calib.camera.board import corner_points
from tronlab.calib.wizard.stations import plan_stations
from tronlab.campaign.rig import load_rig
from tronlab.devices.laboratory import LaboratorySpec
from tronlab.geometry.poses import rotation_angle_rad

TWIN_YAML = Path(__file__).parents[3] / "campaigns/rigs/twin.yaml"


@pytest.fixture(scope="module")
def laboratory() -> LaboratorySpec:
    return load_rig(TWIN_YAML).config.laboratory


def seen_corners(laboratory: LaboratorySpec) -> list[np.ndarray]:
    camera = laboratory.camera.nominal_model
    p_trs = laboratory.board.trs_from_board.pose.apply(corner_points(laboratory.board))
    views = []
    for trs_from_cam in plan_stations(laboratory):
        uv = camera.project(trs_from_cam.inv().apply(p_trs))
        views.append(uv[((uv > 0) & (uv < camera.width_px - 1)).all(axis=1)])
    return views


def test_every_station_sees_much_of_the_board(laboratory: LaboratorySpec) -> None:
    views = seen_corners(laboratory)
    assert len(views) >= 20
    assert min(map(len, views)) >= 25


def test_the_corners_fill_the_image_to_its_edges(laboratory: LaboratorySpec) -> None:
    uv = np.vstack(seen_corners(laboratory))
    cells = np.unique((uv // 128).astype(int), axis=0)
    assert len(cells) == 64


def test_distances_tilts_and_rolls_vary(laboratory: LaboratorySpec) -> None:
    poses = plan_stations(laboratory)
    board = laboratory.board
    centre = np.array([board.columns, board.rows, 0]) * board.square_m / 2
    p_trs = board.trs_from_board.pose.apply(centre)
    distances = [np.linalg.norm(pose.translation - p_trs) for pose in poses]
    assert max(distances) > 1.6 * min(distances)
    turns = [rotation_angle_rad(poses[0], pose) for pose in poses]
    assert np.degrees(max(turns)) > 80


def test_a_board_half_the_size_is_looked_at_from_half_as_far(laboratory: LaboratorySpec) -> None:
    board = laboratory.board
    small = board.model_copy(update={"square_m": board.square_m / 2})
    half = laboratory.model_copy(update={"board": small})
    for far, near in zip(plan_stations(laboratory), plan_stations(half), strict=True):
        origin = board.trs_from_board.pose.translation
        np.testing.assert_allclose(
            near.translation - origin, (far.translation - origin) / 2, atol=1e-12
        )
