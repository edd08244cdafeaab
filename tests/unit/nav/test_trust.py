"""Which matches a first pose may rest on, and which features and landmarks are preferred."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tronlab.nav.database import Database
from tronlab.nav.features import Features, spread_over_image, turns_of_cells
from tronlab.nav.matching import Matches
from tronlab.nav.pruning import place_in_view, preferred_part
from tronlab.nav.settings import MatchingSettings
from tronlab.nav.trust import trusted_matches

N = 120
SIDE_PX = 300.0


def found(seed: int = 0) -> tuple[Matches, Features, Database]:
    """Give matches of features to landmarks with short descriptors, the least ambiguous first."""
    rng = np.random.default_rng(seed)
    bits = rng.integers(0, 256, (N, 2), np.uint8)
    landmark = rng.permutation(N)
    flips = rng.integers(0, 256, (N, 2), np.uint8) & rng.integers(0, 256, (N, 2), np.uint8)
    features = Features(rng.random((N, 2)) * SIDE_PX, rng.uniform(5, 60, N), bits ^ flips)
    database = Database(
        rng.random((N, 3)), np.ones(N), bits[np.argsort(landmark)], np.zeros(N, int)
    )
    distance = np.bitwise_count(flips).sum(axis=1).astype(np.float64)
    matches = Matches(np.arange(N), landmark, distance, np.sort(rng.random(N)))
    return matches, features, database


def trusted(seed: int = 0, **changes: object) -> Matches:
    given_settings = MatchingSettings.model_validate({"max_ratio": 1.0, **changes})
    return trusted_matches(*found(seed), given_settings)


def test_ambiguous_and_large_ones_are_not_trusted() -> None:
    matches, features, _ = found()
    chosen = trusted(max_ratio=0.6, max_size_px=30.0)
    is_good = (matches.ratio <= 0.6) & (features.size_px <= 30.0)
    assert chosen.feature.tolist() == matches.feature[is_good].tolist()


@pytest.mark.parametrize("seed", range(5))
def test_mutual_matches_are_those_whose_landmark_has_no_better_feature(seed: int) -> None:
    matches, features, database = found(seed)
    chosen = trusted(seed, mutual=True)
    rows = database.descriptors[matches.landmark]
    all_distances = np.bitwise_count(rows[:, None] ^ features.descriptors[None]).sum(axis=2)
    is_mutual = matches.distance == all_distances.min(axis=1)
    assert 0 < is_mutual.sum() < N
    assert chosen.feature.tolist() == matches.feature[is_mutual].tolist()


def test_the_most_similar_are_the_paper_s_best() -> None:
    matches, _, _ = found()
    chosen = trusted(best_by="distance", n_max=20)
    assert len(chosen) == 20
    assert np.all(np.diff(chosen.distance) >= 0)
    others = np.setdiff1d(matches.feature, chosen.feature)
    assert chosen.distance.max() <= matches.distance[others].min()


@given(
    cell_px=st.floats(20.0, 400.0), n=st.integers(1, 4), by=st.sampled_from(["ratio", "distance"])
)
@settings(max_examples=25, deadline=None)
def test_each_cell_gives_its_best_and_no_more(cell_px: float, n: int, by: str) -> None:
    matches, features, _ = found()
    chosen = trusted(max_per_cell=n, cell_px=cell_px, best_by=by)
    value = getattr(matches, by)
    cell = [tuple(c) for c in np.floor(features.uv[matches.feature] / cell_px).astype(int)]
    for one in set(cell):
        members = [i for i, other in enumerate(cell) if other == one]
        kept = [i for i in members if i in set(chosen.feature.tolist())]
        assert len(kept) == min(n, len(members))
        assert max(value[kept]) <= min((value[i] for i in members if i not in kept), default=np.inf)
    assert np.all(np.diff(getattr(chosen, by)) >= 0)


def test_features_that_are_not_spread_are_the_strongest_anywhere() -> None:
    rng = np.random.default_rng(2)
    uv, strength = rng.random((200, 2)) * SIDE_PX, rng.random(200)
    chosen = spread_over_image(uv, strength, n_max=30, cell_px=None)
    assert chosen.tolist() == np.argsort(-strength)[:30].tolist()
    spread = spread_over_image(uv, strength, n_max=30, cell_px=48.0)
    assert turns_of_cells(uv, strength, side=48.0)[spread].max() == 0  # 49 cells, one each


@pytest.mark.parametrize("part", [0.03, 0.5, 0.99])
def test_the_preferred_part_of_a_database_comes_from_all_cells_in_turns(part: float) -> None:
    rng = np.random.default_rng(3)
    n = 400
    view = np.sort(rng.integers(0, 6, n))
    database = Database(rng.normal(size=(n, 3)), np.ones(n), np.zeros((n, 61), np.uint8), view)
    preference = rng.random(n)
    anywhere = preferred_part(database, part, preference)
    assert anywhere.tolist() == np.sort(np.argsort(-preference)[: len(anywhere)]).tolist()
    in_turns = preferred_part(database, part, preference, cell_m=0.5)
    assert len(in_turns) == len(anywhere) == int(np.ceil(part * n))
    turn = turns_of_cells(database.p_trs_m[:, :2], preference, side=0.5)
    left = np.setdiff1d(np.arange(n), in_turns)
    assert turn[in_turns].max() <= turn[left].min()
    first = np.flatnonzero(place_in_view(database) == 0)
    assert database.view[first].tolist() == np.unique(view).tolist()
    assert (np.diff(place_in_view(database))[np.diff(view) == 0] == 1).all()
