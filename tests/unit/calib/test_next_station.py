"""Predicted information against a dense least-squares problem, and what choosing by it gains."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from tronlab.calib.camera.board import BoardView, corner_points
from tronlab.calib.camera.bow import bowed
from tronlab.calib.camera.projection import free_intrinsics, intrinsics_of, with_intrinsics
from tronlab.calib.wizard import next_station
from tronlab.calib.wizard.next_station import (
    N_UNKNOWNS,
    Outlook,
    covariance_of,
    rank_stations,
    weigh,
)
from tronlab.calib.wizard.stations import N_FIXED, plan_stations
from tronlab.campaign.rig import load_rig
from tronlab.devices.laboratory import LaboratorySpec
from tronlab.geometry.uncertainty import perturb

TWIN_YAML = Path(__file__).parents[3] / "campaigns/rigs/twin.yaml"
STEPS = np.array([*[1e-6] * 12, *[1e-3] * 4, *[1e-6] * 5, *[1e-6] * 3])


@pytest.fixture(scope="module")
def laboratory() -> LaboratorySpec:
    return load_rig(TWIN_YAML).config.laboratory


@pytest.fixture(scope="module")
def outlook(laboratory: LaboratorySpec) -> Outlook:
    mounting = laboratory.mounting
    return Outlook(
        pattern=laboratory.board.pattern,
        camera=laboratory.camera.nominal_model,
        tmac_from_cam=mounting.flange_from_tmac.pose.inv() * mounting.flange_from_cam.pose,
        trs_from_board=laboratory.board.trs_from_board.pose,
        pose_sigma=np.repeat([1e-4, 5e-5], 3),
    )


def numeric_jacobian(function: Callable[[np.ndarray], np.ndarray], steps: np.ndarray) -> np.ndarray:
    return np.stack(
        [
            (function(d) - function(-d)) / (2 * step)
            for d, step in zip(np.diag(steps), steps, strict=True)
        ],
        axis=1,
    )


def pixels(
    outlook: Outlook, trs_from_cam: RigidTransform, view: BoardView, unknowns: np.ndarray
) -> np.ndarray:
    """Project with every unknown moved, the reading's error last: written without derivatives."""
    free = np.zeros(12)
    free[free_intrinsics("brown")] = unknowns[12:21]
    camera = with_intrinsics(outlook.camera, intrinsics_of(outlook.camera) + free)
    trs_from_tmac = perturb(trs_from_cam * outlook.tmac_from_cam.inv(), unknowns[24:30])
    cam_from_board = (trs_from_tmac * perturb(outlook.tmac_from_cam, unknowns[:6])).inv() * perturb(
        outlook.trs_from_board, unknowns[6:12]
    )
    board = bowed(view.p_board_m, outlook.pattern, unknowns[21:24])
    return camera.project(cam_from_board.apply(board)).ravel()


def test_the_covariance_is_that_of_the_whole_least_squares_problem(
    laboratory: LaboratorySpec, outlook: Outlook
) -> None:
    poses = plan_stations(laboratory)[:8]
    ids = np.arange(0, 63, 3)
    view = BoardView(ids, corner_points(outlook.pattern)[ids], np.zeros((len(ids), 2)))
    n = N_UNKNOWNS + 6 * len(poses)
    normal = np.zeros((n, n))
    for i, pose in enumerate(poses):
        jacobian = numeric_jacobian(
            lambda d, pose=pose: pixels(outlook, pose, view, d), np.array([*STEPS, *[1e-6] * 6])
        )
        columns = np.r_[:N_UNKNOWNS, N_UNKNOWNS + 6 * i : N_UNKNOWNS + 6 * i + 6]
        normal[np.ix_(columns, columns)] += jacobian.T @ jacobian / outlook.corner_sigma_px**2
    prior = np.concatenate([next_station._PRIOR_SIGMA, np.tile(outlook.pose_sigma, len(poses))])
    normal += np.diag(prior**-2.0)
    scale = np.sqrt(np.diag(normal))
    expected = (np.linalg.inv(normal / np.outer(scale, scale)) / np.outer(scale, scale))[:6, :6]
    found = covariance_of([outlook.information_from(pose, view) for pose in poses])
    sigma = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        found / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), atol=1e-4
    )


def test_chosen_stations_beat_the_order_of_the_pool(
    laboratory: LaboratorySpec, outlook: Outlook
) -> None:
    informations = [outlook.information_of(pose) for pose in plan_stations(laboratory)]
    chosen, left = informations[:N_FIXED], informations[N_FIXED:]
    while len(chosen) < 20:
        promised, best = rank_stations(chosen, left)[0]
        chosen.append(left.pop(best))
        assert weigh(covariance_of(chosen)) == pytest.approx(promised)
    assert weigh(covariance_of(chosen)) < 0.92 * weigh(covariance_of(informations[:20]))


def test_a_station_that_sees_nothing_tells_nothing(outlook: Outlook) -> None:
    away = outlook.trs_from_board * RigidTransform.from_translation([0.0, 0.0, 2.0])
    assert not outlook.information_of(away).any()
