"""How far shots are off the nominal trajectory, and whether errors follow it."""

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.score.perturbation import (
    MEASURES,
    TrueViews,
    perturbation_table,
    perturbations,
    rank_table,
    view_sentence,
)

DOWN = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def views(places: list[tuple[float, float, float]], turn_deg=(0.0, 0.0, 0.0), first=1) -> TrueViews:
    turn = Rotation.from_rotvec(turn_deg, degrees=True)
    return TrueViews(
        tuple(range(first, first + len(places))),
        tuple(RigidTransform.from_components(place, turn * DOWN) for place in places),
        np.array([place[2] / 2 for place in places]),
    )


def test_pairs_are_by_height_alone_and_measures_are_the_papers() -> None:
    nominal = views([(0, 0, 4.0), (1, 1, 3.0), (0, 0, 2.0)], first=7)
    found = perturbations(views([(0.3, -0.4, 4.1), (5.0, 5.0, 2.4)], (3.0, 0.0, -4.0)), nominal)
    assert found.paired_shot_id == (7, 9)
    np.testing.assert_allclose(found.plane_distance_m, [0.1, 0.4])
    np.testing.assert_allclose(found.horizontal_distance_m, [0.5, np.hypot(5, 5)])
    # Over the shot's own range, which is half its height here.
    np.testing.assert_allclose(found.plane_distance_pct_los, [100 * 0.1 / 2.05, 100 * 0.4 / 1.2])
    np.testing.assert_allclose(found.horizontal_distance_pct_los[0], 100 * 0.5 / 2.05)
    np.testing.assert_allclose(found.angle_difference_deg, 5.0)
    np.testing.assert_allclose(found.angle_difference_x_deg, 3.0)
    np.testing.assert_allclose(found.angle_difference_y_deg, 0.0, atol=1e-12)
    np.testing.assert_allclose(found.angle_difference_z_deg, -4.0)


def test_the_first_of_equally_near_ones_is_paired() -> None:
    nominal = views([(9, 9, 3.0), (0, 0, 1.0)])
    assert perturbations(views([(0, 0, 2.0)]), nominal).paired_shot_id == (1,)


def test_no_shots_have_no_measures() -> None:
    assert perturbations(views([]), views([(0, 0, 1.0)])).horizontal_distance_m.shape == (0,)


@pytest.fixture
def table(rng: np.random.Generator) -> pd.DataFrame:
    """Two cores: the error of one follows the horizontal distance, that of the other the range."""
    n = 120
    places = np.column_stack([rng.uniform(-1, 1, (n, 2)), rng.uniform(2, 5, n)])
    shots = views([tuple(place) for place in places.tolist()])
    found = perturbations(shots, views([(0, 0, z) for z in np.linspace(2, 5, 12)]))
    # Farther shots are flown farther off: range and perturbation go together.
    drivers = {"follows": found.horizontal_distance_pct_los, "far": shots.range_los_m}
    scores = pd.concat(
        pd.DataFrame(
            {
                "core": core,
                "shot_id": shots.shot_ids,
                "seed": 0,
                "range_los_m": shots.range_los_m,
                "usable_fraction": 1 / shots.range_los_m,
                "position_error_pct_los": driver * rng.uniform(0.8, 1.2, n),
            }
        )
        for core, driver in drivers.items()
    )
    scores.iloc[3, -1] = np.nan
    numbers = {shot_id: 1 + shot_id % 20 for shot_id in shots.shot_ids}
    return perturbation_table("dataset_1_perturbed", scores, found, numbers)


def test_table_has_a_row_an_answer(table: pd.DataFrame) -> None:
    assert len(table) == 240
    assert set(MEASURES) <= set(table.columns)
    assert list(table.columns[:6]) == [
        "dataset", "core", "shot_id", "seed", "trajectory", "paired_shot_id",
    ]  # fmt: skip
    assert (table["trajectory"] == 1 + table["shot_id"] % 20).all()


def test_ranks_tell_what_the_error_follows(table: pd.DataFrame) -> None:
    ranks = rank_table(table)
    assert len(ranks) == 2 * len(MEASURES)
    by = ranks.set_index(["core", "measure"])
    horizontal = "horizontal_distance_pct_los"
    assert by.loc[("follows", horizontal), "n"] == 119
    assert by.loc[("follows", horizontal), "partial_rho"] > 0.8
    assert by.loc[("follows", horizontal), "low"] > 0.5
    assert abs(by.loc[("far", horizontal), "partial_rho"]) < 0.25
    assert by.loc[("far", horizontal), "partial_p"] > 0.01
    # No turns at all: nothing to be said.
    assert np.isnan(by.loc[("far", "angle_difference_deg"), "spearman_rho"])
    assert "once range and usable fraction are held" in view_sentence(ranks)


def test_repeats_with_other_seeds_count_once(table: pd.DataFrame) -> None:
    twice = pd.concat([table, table.assign(seed=1)])
    pd.testing.assert_frame_equal(rank_table(twice), rank_table(table))


def test_without_poses_there_is_no_answer(table: pd.DataFrame) -> None:
    ranks = rank_table(table.assign(position_error_pct_los=np.nan))
    assert ranks["spearman_rho"].isna().all()
    assert view_sentence(ranks) == "No correlation could be computed."
