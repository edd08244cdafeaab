"""What stays of a database: by how its landmarks did, and how alike they are."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform

from tronlab.errors import ConfigError
from tronlab.geometry.camera import CameraModel
from tronlab.nav.database import Database
from tronlab.nav.database_file import Counts
from tronlab.nav.pruning import SAME_POINT_SIZES, SAME_SIZE, PruningRules, Tally, select
from tronlab.nav.survey import CELL_M, survey
from tronlab.nav.view_spread import Spread, spread_poses

CAMERA = CameraModel(64, 48, 48.0, 48.2, 31.4, 23.7, (-0.11, 0.03, 1e-4, -2e-4))
DOWN = np.diag([1.0, -1.0, -1.0])
KEEP_ALL = PruningRules(min_verified=0, max_differing_pct=0)


def looking_down(x_m: float, y_m: float, z_m: float) -> RigidTransform:
    return RigidTransform.from_matrix(
        np.block([[DOWN, np.array([[x_m], [y_m], [z_m]])], [np.zeros((1, 3)), np.ones((1, 1))]])
    )


def database_of(
    p_trs_m: np.ndarray, *, size_m: np.ndarray | float = 0.1, descriptors: np.ndarray | None = None
) -> Database:
    """Landmarks seen from one view 2 m above the origin, with descriptors nothing like another."""
    n = len(p_trs_m)
    rng = np.random.default_rng(1)
    return Database(
        np.asarray(p_trs_m, np.float64),
        np.broadcast_to(np.asarray(size_m, np.float64), (n,)).copy(),
        rng.integers(0, 256, (n, 61), np.uint8) if descriptors is None else descriptors,
        np.zeros(n, np.int64),
        np.array([[0.0, 0.0, 2.0]]),
    )


def counts_of(n_offered: list[int], n_verified: list[int]) -> Counts:
    return Counts(np.array(n_offered, np.uint32), np.array(n_verified, np.uint32))


def test_offered_is_what_projects_into_the_usable_area() -> None:
    rng = np.random.default_rng(4)
    database = database_of(np.column_stack([rng.uniform(-4, 4, (3000, 2)), np.zeros(3000)]))
    trs_from_cam = looking_down(0.3, -0.2, 2.0)
    mask = np.zeros(CAMERA.shape, np.bool_)
    mask[10:40, 20:] = True
    tally = Tally(database)
    tally.add(CAMERA, trs_from_cam, mask, np.array([5, 5, 9]))
    u, v = CAMERA.project(trs_from_cam.inv().apply(database.p_trs_m)).T
    # Far outside of the image the model of distortion folds points back in: they are not seen.
    is_near = np.linalg.norm(database.p_trs_m - [0.3, -0.2, 0], axis=1) < 2.5
    expected = is_near & (u >= 19.5) & (u < 63.5) & (v >= 9.5) & (v < 39.5)
    assert 50 < expected.sum() < 1000
    np.testing.assert_array_equal(tally.counts.n_offered, expected)
    assert tally.counts.n_verified[[5, 9]].tolist() == [1, 1], "once a shot"
    assert tally.counts.n_verified.sum() == 2


def test_what_looks_too_small_or_is_behind_the_camera_is_not_offered() -> None:
    database = database_of(np.zeros((2, 3)), size_m=np.array([0.05, 0.5]))
    everywhere = np.ones(CAMERA.shape, np.bool_)
    for z_m, expected in ((2.0, [1, 1]), (3.0, [0, 1]), (0.3, [1, 0]), (-2.0, [0, 0])):
        tally = Tally(database)
        tally.add(CAMERA, looking_down(0, 0, z_m), everywhere, np.array([], np.intp))
        assert tally.counts.n_offered.tolist() == expected


def test_what_was_offered_and_never_verified_goes_and_the_unknown_stays() -> None:
    database = database_of(np.column_stack([np.arange(5.0), np.zeros((5, 2))]))
    counts = counts_of([0, 2, 3, 9, 9], [0, 0, 0, 1, 2])
    selection = select(database, counts, PruningRules())
    assert selection.chosen.tolist() == [0, 1, 3, 4]
    assert (selection.n_unverified, selection.n_merged, selection.n_thinned) == (1, 0, 0)
    assert select(database, counts, PruningRules(min_verified=2)).chosen.tolist() == [0, 1, 4]
    assert select(database, counts, PruningRules(min_offered=10)).chosen.tolist() == [*range(5)]
    assert select(database, None, PruningRules()).chosen.tolist() == [*range(5)]


def test_one_point_with_one_descriptor_stays_once_and_the_best_does() -> None:
    same = np.zeros((6, 61), np.uint8)
    same[1, 0] = 0b111  # 3 of 488 bits
    same[2, :8] = 255  # 64 bits
    places = np.zeros((6, 3))
    places[:2, 2] = 0.003, -0.001
    places[3, 0] = 1.1 * SAME_POINT_SIZES * 0.1
    sizes = np.full(6, 0.1)
    sizes[4] = 0.1 * 1.1 * SAME_SIZE
    sizes[5] = 0.1 / 1.1
    database = database_of(places, size_m=sizes, descriptors=same)
    counts = counts_of([9] * 6, [1, 5, 1, 1, 1, 2])
    # Number 1 is the best of 0, 1 and 5; 2 looks different, 3 is elsewhere, 4 is larger.
    selection = select(database, counts, PruningRules(max_differing_pct=1.0))
    assert selection.chosen.tolist() == [1, 2, 3, 4]
    assert selection.n_merged == 2
    weights = np.array([1.0, 1.0, 1.1**2]) / (2 + 1.1**2)
    np.testing.assert_allclose(selection.p_trs_m[0], weights @ places[[0, 1, 5]], atol=1e-15)
    np.testing.assert_array_equal(selection.p_trs_m[1:], places[2:5])
    assert select(database, counts, PruningRules(max_differing_pct=0.0)).chosen.tolist() == [
        1, 2, 3, 4, 5,
    ]  # fmt: skip


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), n=st.integers(1, 120))
def test_merging_leaves_no_two_alike_and_loses_nothing_that_was_alone(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    base = rng.integers(0, 256, (3, 8), np.uint8)
    descriptors = base[rng.integers(0, 3, n)] ^ (rng.random((n, 8)) < 0.1).astype(np.uint8)
    places = np.column_stack([rng.uniform(0, 0.2, (n, 2)), np.zeros(n)])
    database = database_of(places, size_m=rng.uniform(0.06, 0.12, n), descriptors=descriptors)
    kept = select(database, None, PruningRules(max_differing_pct=5.0)).chosen
    bits = np.bitwise_count(descriptors[:, None] ^ descriptors[None]).sum(axis=2)
    small = np.minimum.outer(database.size_m, database.size_m)
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    alike = (apart <= SAME_POINT_SIZES * small) & (bits <= 0.05 * 64)
    alike &= np.maximum.outer(database.size_m, database.size_m) < SAME_SIZE * small
    octave = np.floor(np.log2(database.size_m) + 0.5)
    for i, j in combinations(kept.tolist(), 2):
        assert not (alike[i, j] and octave[i] == octave[j])
    # What went is like something better that was there, perhaps itself gone for a still better one.
    for i in set(range(n)) - set(kept.tolist()):
        assert alike[i].sum() > 1


def test_crowded_cells_keep_their_best_of_each_size() -> None:
    places = np.zeros((9, 3))
    places[:, 0] = [0.01, 0.02, 0.03, 0.04, 0.06, 0.07, 0.01, 0.02, -0.01]
    sizes = np.array([0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.3, 0.3, 0.1])
    database = database_of(places, size_m=sizes)
    counts = counts_of([8] * 9, [1, 4, 3, 2, 1, 2, 1, 1, 1])
    rules = PruningRules(max_per_cell=2, cell_m=0.05, max_differing_pct=0)
    selection = select(database, counts, rules)
    assert selection.chosen.tolist() == [1, 2, 4, 5, 6, 7, 8]
    assert selection.n_thinned == 2


def test_a_survey_counts_every_landmark_where_it_is_and_from_where_it_was_seen() -> None:
    rng = np.random.default_rng(9)
    n_points, ranges_m = 150, np.array([1.1, 1.9, 4.5])
    points = np.column_stack([rng.uniform(0, 2.0, (n_points, 2)), np.zeros(n_points)])
    places = np.tile(points, (3, 1)) + rng.normal(0, 2e-5, (3 * n_points, 3))
    eyes = np.column_stack([np.full((3, 2), 1.0), 1000 * ranges_m])  # so far that ranges are equal
    view = np.repeat(np.arange(3), n_points)
    sizes = np.full(3 * n_points, 0.002)
    database = Database(places, sizes, np.zeros((3 * n_points, 61), np.uint8), view, eyes)
    found = survey(database)
    assert found.n_in_cell.sum() == 3 * n_points
    assert (found.n_in_cell.sum(axis=(0, 1)) > 0).sum() == 3
    assert found.n_views_of_point.tolist() == [3] * 3 * n_points
    np.testing.assert_allclose(found.range_m, 1000 * ranges_m, rtol=1e-5)
    assert (found.bands_m[0] <= found.range_m[0]) & (found.range_m[2] < found.bands_m[-1])
    cells = {tuple(cell) for cell in np.floor(places[:, :2] / CELL_M).astype(int)}
    assert found.covered_m2 == pytest.approx(len(cells) * CELL_M**2)
    assert found.density_per_m2.sum() * CELL_M**2 == pytest.approx(3 * n_points)


def spread(**changes: object) -> tuple[RigidTransform, ...]:
    values = {"n_views": 400, "range_m": (1.0, 5.0), "max_tilt_rad": 0.5, "seed": 3, **changes}
    return spread_poses(
        Spread(**values),  # type: ignore[arg-type]
        corner_trs_m=np.array([0.1, 0.2, -0.05]),
        size_m=(2.2, 4.2),
        clearance_m=0.1,
    )


def test_views_are_spread_over_places_ranges_and_directions() -> None:
    poses = spread()
    axes = np.array([pose.rotation.apply([0.0, 0.0, 1.0]) for pose in poses])
    eyes = np.array([pose.translation for pose in poses])
    range_m = (eyes[:, 2] + 0.05) / -axes[:, 2]
    looked_at = eyes + range_m[:, None] * axes
    share = (looked_at[:, :2] - [0.1, 0.2]) / [2.2, 4.2]
    # A quarter of 400 in each quarter: a Halton sequence is much nearer to it than chance.
    for values in (
        share[:, 0],
        share[:, 1],
        np.log(range_m) / np.log(5.0),
        (1 + axes[:, 2]) / (1 - np.cos(0.5)),
    ):
        counts = np.histogram(values, np.linspace(-1e-9, 1 + 1e-9, 5))[0]
        np.testing.assert_allclose(counts, 100, atol=5)
    again, longer = spread(), spread(n_views=500)
    assert all(
        np.array_equal(pose.as_matrix(), other.as_matrix())
        for pose, *others in zip(poses, again, longer, strict=False)
        for other in others
    )
    assert not np.allclose(spread(seed=4)[0].translation, poses[0].translation)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"range_m": (5.0, 1.0)}, "must be NEAREST:FARTHEST in metres"),
        ({"range_m": (0.0, 1.0)}, "both positive"),
        ({"range_m": (float("nan"), 1.0)}, "must be NEAREST:FARTHEST"),
        ({"max_tilt_rad": 1.5}, "--tilt 85.9437: must be 0 to 80 degrees"),
        ({"range_m": (0.1, 1.0)}, "0.09 m above the model's mean height"),
    ],
)
def test_a_spread_that_cannot_be_is_refused(changes: dict[str, object], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        spread(**changes)
