"""Does the story of the recording hold together, and is there something a reader should know?"""

from collections.abc import Iterator, Sequence

import numpy as np

from tronlab.dataset import schema
from tronlab.dataset.checks.images import sentence
from tronlab.dataset.drift import doubts, spans
from tronlab.dataset.journal import read_journal
from tronlab.dataset.places import images_folder
from tronlab.dataset.reader import Dataset
from tronlab.dataset.summary import flagged_shots, known_rows, skipped_shots
from tronlab.errors import IntegrityError


def sessions(dataset: Dataset) -> Iterator[str]:
    """Find shots of a session that there was not, and sessions out of order."""
    numbers = [session.number for session in dataset.sessions]
    if numbers != list(range(1, len(numbers) + 1)):
        yield f"sessions: numbered {_listed(numbers)}, expected 1 to {len(numbers)}"
    taken_in = dataset.stored.sessions()[list(dataset.row_numbers)]
    for number in np.setdiff1d(taken_in, numbers):
        shot_ids = dataset.shot_ids[taken_in == number].tolist()
        yield f"shots {spans(shot_ids)}: taken in session {number}, there are {len(numbers)}"


def supersession(dataset: Dataset) -> Iterator[str]:
    """Find rows said to replace another that cannot be: later, of another shot, or twice."""
    if dataset.uuid is None:
        return  # layouts before 2 had no such rows
    shot_ids = dataset.stored.shot_ids
    supersedes = dataset.stored.column(schema.SUPERSEDES)
    later = np.flatnonzero((supersedes != schema.NO_ROW) & (shot_ids != schema.VOID_SHOT_ID))
    for row in later:
        earlier = int(supersedes[row])
        if not 0 <= earlier < row:
            yield f"row {row}: supersedes row {earlier}, which is not before it"
        elif shot_ids[earlier] not in {shot_ids[row], schema.VOID_SHOT_ID}:
            yield f"row {row}: is shot {shot_ids[row]}, supersedes shot {shot_ids[earlier]}"
    rows, counts = np.unique(supersedes[later], return_counts=True)
    for row in rows[counts > 1]:
        yield f"row {row}: is superseded more than once"


def segments(dataset: Dataset) -> Iterator[str]:
    """Find images that are in no file, in two, or in a file that is missing or foreign."""
    end = 0
    for segment in dataset.segments:
        if segment.first_row != end:
            yield f"segments: {segment.name} begins with row {segment.first_row}, expected {end}"
        end = segment.end_row
    if dataset.segments and end < dataset.n_rows:
        yield f"segments: hold {end} rows, the dataset has {dataset.n_rows}"


def quality(dataset: Dataset) -> Iterator[str]:
    """Find quality flags that there are not."""
    known = (1 << len(schema.QUALITY_FLAG_NAMES)) - 1
    bits = known_rows(dataset, schema.QUALITY_FLAGS)
    if bits is None:
        return
    for i in np.flatnonzero(bits & ~np.uint32(known)):
        yield (
            f"shot {dataset.shot_ids[i]}: quality/flags is {int(bits[i]):#x}, only the lowest"
            f" {len(schema.QUALITY_FLAG_NAMES)} bits have a meaning"
        )


def drift(dataset: Dataset) -> Iterator[str]:
    """Find drift checks that cannot have been then; older files have no checks."""
    counts = [check.n_shots_before for check in dataset.drift_checks]
    if counts and (counts != sorted(counts) or counts[-1] > dataset.n_rows):
        yield f"drift: the checks were after {_listed(counts)} shots, which cannot be"


def counts(dataset: Dataset) -> Iterator[str]:
    """Find more shots than were planned."""
    planned = dataset.provenance.n_shots_planned
    if dataset.n_shots > planned:
        yield f"{dataset.n_shots} shots are there, {planned} were planned"


def ending(dataset: Dataset) -> Iterator[str]:
    """Say why the recording is not complete."""
    planned = dataset.provenance.n_shots_planned
    because = f": {dataset.reason}" if dataset.reason else ""
    if dataset.status == "running":
        yield "the recording never ended (status running): it still runs, or was killed"
    elif dataset.status != "complete":
        yield f"the recording ended with status {dataset.status}{because}"
    if dataset.n_shots < planned:
        yield f"{dataset.n_shots} of {planned} planned shots are there"


def skipped(dataset: Dataset) -> Iterator[str]:
    """Say which shots were given up."""
    for shot_id, why in skipped_shots(dataset, read_journal(dataset.path)).items():
        yield f"shot {shot_id} was skipped: {why}"


def doubtful(dataset: Dataset) -> Iterator[str]:
    """Say which shots the drift checks do not vouch for."""
    if dataset.drift_checks:
        yield from doubts(dataset.shot_ids.tolist(), dataset.truth_states)


def flagged(dataset: Dataset) -> Iterator[str]:
    """Say which shots the quality gate held something against."""
    for flag, shot_ids in flagged_shots(dataset).items():
        yield f"shots {spans(shot_ids)} are flagged: {flag}"


def set_aside(dataset: Dataset) -> Iterator[str]:
    """Say which rows that no shot needs any more are damaged or empty."""
    for row in dataset.superseded_rows:
        where = f"row {row}, superseded, of shot {dataset.stored.shot_ids[row]}"
        try:
            is_whole = dataset.stored.is_whole(row)
        except IntegrityError as error:
            yield f"{where}: {sentence(dataset, error)}"
        else:
            if not is_whole:
                yield f"{where}: is damaged: a checksum does not match"
    if dataset.void_rows:
        yield f"rows {spans(dataset.void_rows)} hold nothing: a power cut had damaged them"


def strangers(dataset: Dataset) -> Iterator[str]:
    """Say which files are among the segments but are none."""
    folder = images_folder(dataset.path)
    if not (dataset.segments and folder.is_dir()):
        return
    known = {(dataset.path.parent / segment.name).name for segment in dataset.segments}
    for name in sorted({path.name for path in folder.iterdir()} - known):
        yield f"{folder / name}: is no file of this dataset"


def _listed(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers))
