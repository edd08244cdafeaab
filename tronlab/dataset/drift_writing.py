"""Storing the drift checks of a recording."""

from collections.abc import Sequence

from tronlab.dataset import columns, schema, skeleton
from tronlab.dataset.admission import drift_values_of
from tronlab.dataset.master import Master
from tronlab.dataset.records import DriftRecord
from tronlab.errors import DatasetError


class DriftWriter:
    """Stores one drift check after the other."""

    def __init__(self, master: Master, reflectors: tuple[str, ...], n_checks: int) -> None:
        """Go on after the checks that are there.

        Args:
            master: The dataset's own file.
            reflectors: Those of earlier sessions; none if nothing was checked before.
            n_checks: How many checks earlier sessions made.
        """
        self._master = master
        self._reflectors = reflectors
        self._n_checks = self._room = n_checks
        self._is_planned = False

    def plan(self, reflectors: Sequence[str], n_checks: int) -> None:
        """Make room; once.

        Raises:
            DatasetError: Already done, nothing to make room for, other reflectors than before, or
                the disk does not take it.
        """
        path = self._master.path
        if self._is_planned:
            raise DatasetError(f"{path}: the drift checks are already planned")
        if not reflectors or n_checks < 1:
            raise DatasetError(
                f"{path}: {n_checks} drift checks of {len(reflectors)} reflectors are planned,"
                " at least 1 of each needed"
            )
        if self._reflectors and self._reflectors != tuple(reflectors):
            raise DatasetError(
                f"{path}: drift checks of reflectors {', '.join(reflectors)}, those of earlier"
                f" sessions are {', '.join(self._reflectors)}"
            )
        room = self._n_checks + n_checks
        with (
            self._master.explaining("the drift checks could not be set up"),
            self._master.structure() as file,
        ):
            if self._reflectors:
                skeleton.resize_drift(file, room)
            else:
                skeleton.create_drift(file, tuple(reflectors), room)
        self._reflectors = tuple(reflectors)
        self._room = room
        self._is_planned = True

    def commit(self, check: DriftRecord) -> None:
        """Store a check; when this returns, a kill does not lose it.

        Raises:
            DatasetError: It was not planned, contradicts the plan, or the disk does not take it.
        """
        master, row = self._master, self._n_checks
        values = drift_values_of(master.path, check, self._reflectors)
        if row == self._room:
            raise DatasetError(f"{master.path}: one more than the {row} drift checks planned")
        with master.explaining("a drift check could not be written"):
            for path, value in values.items():
                master.write_row(path, row, value)
            master.write_row(schema.DRIFT_CRC32, row, columns.checksum(values.values()))
            master.write(schema.N_DRIFT_CHECKS, row + 1)
            if master.is_published:
                master.sync()
        self._n_checks = row + 1
