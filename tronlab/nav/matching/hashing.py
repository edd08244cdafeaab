"""Locality-sensitive hashing with bits chosen for the database."""

import numpy as np

from tronlab.nav.database import Database
from tronlab.nav.features import Features
from tronlab.nav.matching.bits import choose_bits
from tronlab.nav.matching.hashing_kernel import (
    MAX_BUCKET,
    Scratch,
    Tables,
    fill_table,
    look_up,
)
from tronlab.nav.matching.matches import Matches, Nearest
from tronlab.nav.matching.words import check_fit, places_of, read_only, words_of
from tronlab.nav.sources import digest_of_stage
from tronlab.nav.stages import StageStore, stage_key

N_TABLES = 24
MIN_BITS, MAX_BITS = 6, 22
MIN_KEPT = 200_000
"""Tables of a smaller database are made as fast as they are read. 200 bytes a landmark."""
_SEED = 20_160_417


class HashingMatcher:
    """Finds the nearest landmark among those that agree with a feature in some twenty bits."""

    def __init__(self, database: Database, stages: StageStore) -> None:
        self._database = database
        self._words = words_of(database.descriptors)
        self._places = places_of(database)
        self._tables = open_tables(database, stages)
        n_tables, n_bits = self._tables.bits.shape
        n_candidates = MAX_BUCKET * n_tables * (1 + n_bits)
        self._scratch = Scratch(
            np.empty(n_candidates, np.int32),
            np.empty(n_candidates, np.uint16),
            np.empty(n_tables, np.int64),
        )

    def match(self, features: Features) -> Matches:
        """Find the nearest landmark of every feature."""
        check_fit(self._database, features)
        nearest = Nearest.nothing(len(features))
        if len(features):
            look_up(
                self._tables,
                self._words,
                self._places,
                words_of(features.descriptors),
                self._scratch,
                nearest,
            )
        return nearest.matches()


def open_tables(database: Database, stages: StageStore) -> Tables:
    """Take the hash tables of a large database from the store, or make them."""
    if len(database) < MIN_KEPT:
        return build_tables(database)
    key = stage_key(database=database.digest, sources=digest_of_stage("matching"))
    kept = stages.load("tables", key)
    if kept is not None:
        return Tables(*(read_only(kept[name]) for name in Tables._fields))
    tables = build_tables(database)
    stages.save("tables", key, tables._asdict())
    return tables


def build_tables(database: Database) -> Tables:
    """Make the hash tables of a database; a bucket of each holds one landmark in the mean."""
    n_bits = int(np.clip(np.rint(np.log2(max(len(database), 1))), MIN_BITS, MAX_BITS))
    bits = choose_bits(database.descriptors, n_tables=N_TABLES, n_bits=n_bits, seed=_SEED)
    starts = np.zeros((N_TABLES, (1 << bits.shape[1]) + 1), np.int32)
    landmarks = np.empty((N_TABLES, len(database)), np.int32)
    keys = np.empty(len(database), np.int32)
    descriptors = read_only(database.descriptors)
    for table in range(N_TABLES):
        fill_table(bits[table], descriptors, keys, starts[table], landmarks[table])
    return Tables(read_only(bits), read_only(starts), read_only(landmarks))
