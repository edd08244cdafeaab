"""Which shot is next, and what became of those before."""

from collections import deque
from collections.abc import Collection, Mapping
from types import MappingProxyType

from tronlab.planning.shots import Plan, Shot


class Schedule:
    """The shots of a session: to come, in hand, stored, skipped."""

    def __init__(self, plan: Plan) -> None:
        self._shots = {shot.shot_id: shot for shot in plan.shots}
        self._to_come = deque(self._shots)
        self._in_hand: int | None = None
        self._stored: set[int] = set()
        self._skipped: dict[int, str] = {}
        self._n_commits = 0
        self._n_skipped_in_row = 0

    @property
    def has_next(self) -> bool:
        """Get whether there is a shot to come."""
        return bool(self._to_come)

    @property
    def n_left(self) -> int:
        """Get how many are to come, the one in hand included."""
        return len(self._to_come) + (self._in_hand is not None)

    @property
    def n_commits(self) -> int:
        """Get how often a shot was stored: one that was taken again counts again."""
        return self._n_commits

    @property
    def n_retakes(self) -> int:
        """Get how often a stored shot was replaced, or is to be."""
        pending = [i for i in (*self._to_come, self._in_hand) if i in self._stored]
        return self._n_commits - len(self._stored) + len(pending)

    @property
    def n_skipped_in_row(self) -> int:
        """Get how many were skipped since the last one that was stored."""
        return self._n_skipped_in_row

    @property
    def stored(self) -> frozenset[int]:
        """Get the ids of the shots that are stored."""
        return frozenset(self._stored)

    @property
    def skipped(self) -> Mapping[int, str]:
        """Get the ids of those left out, of which nothing is stored, and why."""
        return MappingProxyType(self._skipped)

    def begin_next(self) -> Shot:
        """Take the next shot in hand.

        Raises:
            IndexError: There is none.
        """
        self._in_hand = self._to_come.popleft()
        return self._shots[self._in_hand]

    def is_in_hand(self, shot_id: int) -> bool:
        """Tell whether this shot is being taken, and not stored yet."""
        return shot_id == self._in_hand

    def note_stored(self) -> None:
        """Note that the shot in hand is stored."""
        shot_id = self._taken_from_hand()
        self._stored.add(shot_id)
        self._skipped.pop(shot_id, None)
        self._n_commits += 1
        self._n_skipped_in_row = 0

    def skip(self, why: str) -> int:
        """Leave the shot in hand out; what is stored of it, if it was to be replaced, stays.

        Returns:
            Its id.
        """
        shot_id = self._taken_from_hand()
        if shot_id not in self._stored:
            self._skipped[shot_id] = why
        self._n_skipped_in_row += 1
        return shot_id

    def retake(self, shot_ids: Collection[int]) -> None:
        """Put shots before all that are to come; those to come already only move ahead."""
        first = [shot_id for shot_id in dict.fromkeys(shot_ids) if shot_id in self._shots]
        self._to_come = deque([*first, *(i for i in self._to_come if i not in first)])

    def _taken_from_hand(self) -> int:
        if self._in_hand is None:
            raise RuntimeError("no shot is in hand")
        shot_id, self._in_hand = self._in_hand, None
        return shot_id
