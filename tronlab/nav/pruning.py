"""Which landmarks of a database are worth keeping: by how they did in scores, and how alike."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial import KDTree
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray
from tronlab.nav.core import Mask
from tronlab.nav.database import Database
from tronlab.nav.database_file import Counts
from tronlab.nav.features import turns_of_cells
from tronlab.nav.settings import Count, Positive
from tronlab.yaml_models import Model

SIZE_SLACK = 1.25
"""A landmark that looks smaller than the smallest in its own view by more than this, or larger than
the largest, lies at a scale that the detector does not search."""
SAME_POINT_SIZES = 0.25
"""Landmarks nearer to each other than this many of their sizes may be one point seen twice."""
SAME_SIZE = 1.25
"""Their sizes then differ by less than this factor."""

_OCTAVE_SHIFTS = (0.0, 0.5)
_ROWS_AT_ONCE = 1 << 16
_NEIGHBOURS_AT_ONCE = 1 << 14
_PAIRS_AT_ONCE = 1 << 18

Indices = NDArray[np.intp]


class PruningRules(Model):
    """Which landmarks stay."""

    min_verified: Annotated[int, Field(ge=0)] = 1
    """Least number of shots in which a landmark verified, once it was offered often enough."""
    min_offered: Count = 3
    """Landmarks offered in fewer shots stay: nobody knows yet."""
    max_differing_pct: Annotated[float, Field(ge=0, le=50)] = 0.0
    """Landmarks of one point whose descriptors differ in no more of their bits become one, at their
    mean place; 0: only equal ones."""
    max_per_cell: Count | None = None
    """Most landmarks of one cell of the terrain and one octave of size; without a value all."""
    cell_m: Positive = 0.05
    """Side of the square cells."""


@dataclass(frozen=True, slots=True)
class Selection:
    """What stays of a database."""

    chosen: Indices
    """Ascending, shape (m,)."""
    p_trs_m: FloatArray
    """Places of the chosen, shape (m, 3): the mean of all that were merged into each."""
    n_unverified: int
    """Taken out because they did not verify."""
    n_merged: int
    """Taken out because another landmark is the same."""
    n_thinned: int
    """Taken out because their cell was full."""


class Tally:
    """Counts in how many shots each landmark was offered, and in how many it verified."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._n_offered = np.zeros(len(database), np.uint32)
        self._n_verified = np.zeros(len(database), np.uint32)
        self._angular_sizes = _angular_sizes(database)

    @property
    def counts(self) -> Counts:
        """Get the counts so far."""
        return Counts(self._n_offered, self._n_verified)

    def add(
        self, camera: CameraModel, trs_from_cam: RigidTransform, mask: Mask, verified: Indices
    ) -> None:
        """Count one shot.

        A landmark is offered if it projects into the usable area and looks neither smaller nor
        larger than what the detector finds; whether terrain hides it is not asked.

        Args:
            camera: Intrinsics of the image.
            trs_from_cam: Where the camera was.
            mask: True where the image may be used, shape (rows, columns).
            verified: Landmarks that a right pose rests on.
        """
        for rows in _pieces(len(self._database)):
            self._n_offered[rows] += self._is_offered(rows, camera, trs_from_cam, mask)
        self._n_verified[np.unique(verified)] += 1

    def _is_offered(
        self, rows: slice, camera: CameraModel, trs_from_cam: RigidTransform, mask: Mask
    ) -> NDArray[np.bool_]:
        points_trs_m = self._database.p_trs_m[rows]
        away_m = np.linalg.norm(points_trs_m - trs_from_cam.translation, axis=1)
        smallest, largest = self._angular_sizes
        size = self._database.size_m[rows] / away_m
        is_offered = (size >= smallest) & (size <= largest)
        p_cam = trs_from_cam.inv().apply(points_trs_m[is_offered])
        is_offered[is_offered] = _is_usable(p_cam, camera, mask)
        return is_offered


def select(
    database: Database,
    counts: Counts | None,
    rules: PruningRules,
    *,
    on_progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> Selection:
    """Choose the landmarks that stay.

    First go those that were offered but did not verify; then those that are the same point with
    nearly the same descriptor are merged into one; then go those for which a cell has no room. Each
    time the one stays that is more likely to verify, by Laplace's rule of succession from its
    counts.

    Args:
        database: All landmarks.
        counts: How they did; None: nobody asked.
        rules: What stays.
        on_progress: Told (landmarks compared, of how many) while duplicates are looked for.
    """
    stays = np.ones(len(database), np.bool_)
    likelihood = np.full(len(database), 0.5)
    if counts is not None:
        stays = (counts.n_offered < rules.min_offered) | (counts.n_verified >= rules.min_verified)
        likelihood = (counts.n_verified + 1.0) / (counts.n_offered + 2.0)
    verified = np.flatnonzero(stays)
    max_bits = rules.max_differing_pct / 100 * 8 * database.descriptors.shape[1]
    stands_for = _merge(database, verified, likelihood, max_bits=max_bits, on_progress=on_progress)
    distinct = np.unique(stands_for)
    places_m = _mean_places(database, verified, np.searchsorted(distinct, stands_for))
    chosen = distinct
    if rules.max_per_cell is not None:
        chosen = _thin(database, distinct, likelihood, rules.max_per_cell, cell_m=rules.cell_m)
    return Selection(
        chosen,
        places_m[np.searchsorted(distinct, chosen)],
        n_unverified=len(database) - len(verified),
        n_merged=len(verified) - len(distinct),
        n_thinned=len(distinct) - len(chosen),
    )


def preferred_part(
    database: Database, part: float, preference: FloatArray, *, cell_m: float | None = None
) -> Indices:
    """Choose a part of the landmarks, those that are preferred.

    Args:
        database: All landmarks.
        part: How many stay, as a part of all.
        preference: Shape (n,).
        cell_m: Choose in turns: of every square cell of the ground the most preferred, then its
            second; None: wherever they are.

    Returns:
        Indices of the chosen, ascending.
    """
    n_kept = int(np.ceil(part * len(database)))
    turn = np.zeros(len(database))
    if cell_m is not None:
        turn = turns_of_cells(database.p_trs_m[:, :2], preference, side=cell_m)
    return np.sort(np.lexsort((-preference, turn))[:n_kept])


def place_in_view(database: Database) -> NDArray[np.int64]:
    """Give how many landmarks of its view come before each: the strongest is the first."""
    return np.arange(len(database)) - np.searchsorted(database.view, database.view)


def _pieces(n: int) -> Iterator[slice]:
    for first in range(0, n, _ROWS_AT_ONCE):
        yield slice(first, first + _ROWS_AT_ONCE)


def _angular_sizes(database: Database) -> tuple[float, float]:
    """Give the range of sizes over distance, radians, in which landmarks can be found."""
    smallest, largest = np.inf, 0.0
    for rows in _pieces(len(database)):
        p_eye_m = database.p_views_trs_m[database.view[rows]]
        size = database.size_m[rows] / np.linalg.norm(database.p_trs_m[rows] - p_eye_m, axis=1)
        smallest, largest = min(smallest, float(size.min())), max(largest, float(size.max()))
    return smallest / SIZE_SLACK, largest * SIZE_SLACK


def _is_usable(p_cam: FloatArray, camera: CameraModel, mask: Mask) -> NDArray[np.bool_]:
    """Tell which points are seen within the mask, shape (n,)."""
    rows, columns = camera.shape
    is_usable = p_cam[:, 2] > 0
    # Distortion is only good for the image: far outside it may fold points back in.
    border = camera.rays([[-0.5, -0.5], [columns - 0.5, -0.5], [-0.5, rows - 0.5],
                          [columns - 0.5, rows - 0.5]])  # fmt: skip
    rays = p_cam[:, :2] / np.where(is_usable, p_cam[:, 2], 1.0)[:, None]
    is_usable &= (np.abs(rays) <= np.abs(border).max(axis=0)).all(axis=1)
    u, v = np.rint(camera.pixels(rays[is_usable])).T.astype(np.intp)
    is_inside = (u >= 0) & (u < columns) & (v >= 0) & (v < rows)
    is_inside[is_inside] = mask[v[is_inside], u[is_inside]]
    is_usable[is_usable] = is_inside
    return is_usable


def _merge(
    database: Database,
    candidates: Indices,
    likelihood: FloatArray,
    *,
    max_bits: float,
    on_progress: Callable[[int, int], None],
) -> Indices:
    """Find the landmarks that are another one seen again.

    Neighbours are looked for among landmarks of one octave of size, and those then of the octaves
    that begin half-way between: sizes on either side of a limit meet once.

    Returns:
        For each candidate the one that stays in its place, maybe itself, shape (candidates,).
    """
    n_all = 2 * len(candidates)
    merged_into = np.arange(len(database))
    left = candidates
    for turn, shift in enumerate(_OCTAVE_SHIFTS):
        n_done = turn * n_all // 2
        octave = _octave(database, left, shift)
        for group in _groups(octave, database.p_trs_m[left, 0]):
            members = left[group]
            ordered = members[np.argsort(-likelihood[members], kind="stable")]
            merged_into[ordered] = ordered[_best_alike(database, ordered, max_bits=max_bits)]
            n_done += len(group)
            on_progress(n_done, n_all)
        left = left[merged_into[left] == left]
    on_progress(n_all, n_all)
    return merged_into[merged_into[candidates]]


def _mean_places(database: Database, members: Indices, group: Indices) -> FloatArray:
    """Give the mean place of each group of landmarks, shape (groups, 3).

    Views place a point the less precisely the larger a pixel is on it, and so is a landmark.
    """
    weight = database.size_m[members] ** -2
    places_m = database.p_trs_m[members]
    total = [np.bincount(group, weight * places_m[:, axis]) for axis in range(3)]
    return np.column_stack(total) / np.bincount(group, weight)[:, None]


def _octave(database: Database, chosen: Indices, shift: float) -> NDArray[np.int64]:
    return np.floor(np.log2(database.size_m[chosen]) + shift).astype(np.int64)


def _groups(octave: NDArray[np.int64], x_m: FloatArray) -> Iterator[Indices]:
    """Cut landmarks into strips along X of one octave each, small enough for all their pairs."""
    for value in np.unique(octave):
        members = np.flatnonzero(octave == value)
        members = members[np.argsort(x_m[members], kind="stable")]
        yield from np.array_split(members, -(-len(members) // _NEIGHBOURS_AT_ONCE))


def _best_alike(database: Database, ordered: Indices, *, max_bits: float) -> Indices:
    """Give, for each of some landmarks, the best first, the index in them of the one that stays.

    One stays unless it is the same as a better one that stays; it goes into the best of these.
    """
    better, worse = _same(database, ordered, max_bits=max_bits)
    is_open = np.ones(len(ordered), np.bool_)
    stays = np.zeros(len(ordered), np.bool_)
    while is_open.any():
        # The best of all that are still open depends on no other one: some are settled each time.
        is_settled = is_open.copy()
        is_settled[worse[is_open[better]]] = False
        stays |= is_settled
        is_open &= ~is_settled
        is_open[worse[is_settled[better]]] = False
    best = np.arange(len(ordered))
    goes = stays[better] & ~stays[worse]
    best[worse[goes]] = len(ordered)
    np.minimum.at(best, worse[goes], better[goes])
    return best


def _same(database: Database, ordered: Indices, *, max_bits: float) -> tuple[Indices, Indices]:
    """Give pairs (better, worse) of places in ``ordered`` that are the same."""
    places_m, sizes_m = database.p_trs_m[ordered], database.size_m[ordered]
    descriptors = database.descriptors[ordered]
    radius_m = SAME_POINT_SIZES * float(sizes_m.max())
    pairs = KDTree(places_m).query_pairs(radius_m, output_type="ndarray")
    is_same = np.zeros(len(pairs), np.bool_)
    for first in range(0, len(pairs), _PAIRS_AT_ONCE):
        a, b = pairs[first : first + _PAIRS_AT_ONCE].T
        small, large = np.minimum(sizes_m[a], sizes_m[b]), np.maximum(sizes_m[a], sizes_m[b])
        apart_m = np.linalg.norm(places_m[a] - places_m[b], axis=1)
        near = (apart_m <= SAME_POINT_SIZES * small) & (large < SAME_SIZE * small)
        a, b = a[near], b[near]
        bits = np.bitwise_count(descriptors[a] ^ descriptors[b]).sum(axis=1, dtype=np.int64)
        is_same[first + np.flatnonzero(near)] = bits <= max_bits
    same = pairs[is_same]
    return same[:, 0], same[:, 1]


def _thin(
    database: Database, candidates: Indices, likelihood: FloatArray, n_max: int, *, cell_m: float
) -> Indices:
    """Keep the best so many landmarks of each cell and octave."""
    cells = np.floor(database.p_trs_m[candidates, :2] / cell_m).astype(np.int64)
    octave = _octave(database, candidates, 0.0)
    order = np.lexsort((-likelihood[candidates], octave, cells[:, 1], cells[:, 0]))
    keys = np.column_stack([cells, octave])[order]
    starts = np.r_[True, (np.diff(keys, axis=0) != 0).any(axis=1)][: len(order)]
    first = np.maximum.accumulate(np.where(starts, np.arange(len(order)), 0))
    return np.sort(candidates[order[np.arange(len(order)) - first < n_max]])
