"""The files of a calibration: nothing that was measured is ever lost."""

import json
import shutil
from collections.abc import Callable, Generator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, TypeAlias

import typer

from tronlab.errors import CalibrationError

if TYPE_CHECKING:
    from tronlab.calib.record import CalibrationRecord

Keep: TypeAlias = Callable[["CalibrationRecord"], None]
"""Is given a draft with all that was measured so far, again and again."""
RECORDS = Path("calibration/records")
"""Where records are kept, each under its rig's name."""


def record_path(record: Path | None, rig_name: str) -> Path:
    """Give the file of a record: the one named, or that of the rig."""
    return record or RECORDS / f"{rig_name}.json"


def part_path(path: Path) -> Path:
    """Give the file that has what was measured so far."""
    return path.with_name(f"{path.stem}.part{path.suffix}")


def load_existing(path: Path, rig_name: str) -> "CalibrationRecord | None":
    """Read the record that some part is to be replaced of; None if there is none yet.

    Raises:
        CalibrationError: It is no record, a damaged one, or another rig's.
    """
    from tronlab.calib.record import CalibrationRecord

    if not path.exists():
        return None
    record = CalibrationRecord.load(path)
    record.check_rig(rig_name)
    return record


def refuse_existing(path: Path, *, force: bool) -> None:
    """Refuse to replace a whole record unless told.

    Raises:
        CalibrationError: There is one.
    """
    if path.exists() and not force:
        raise CalibrationError(
            f"calibration record {path}: exists already;"
            "\nname another file, replace it: --force (the old one is kept beside it), or measure"
            f" one part of it anew: tronlab calibrate frame --rig RIG.yaml --record {path}"
        )


@contextmanager
def journal(path: Path) -> Generator[Keep]:
    """Give what keeps a draft on disk while it is measured; whatever ends it, it says where.

    Args:
        path: File of the record to be.

    Raises:
        CalibrationError: Its folder cannot be written; nothing was measured yet.
    """
    part = part_path(path)
    _check_folder(path)
    keep_old(part)
    part.unlink(missing_ok=True)
    try:
        yield lambda draft: draft.save(part)
    except BaseException:
        if part.exists():
            typer.echo(
                f"what was measured so far is in {part};"
                f" to solve it: tronlab calibrate rerun {part} --out NEW.json",
                err=True,
            )
        raise


def _check_folder(path: Path) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise CalibrationError(
            f"calibration record {path}: its folder cannot be written: {error.strerror};"
            "\nname another file: --record RECORD.json"
        ) from error


def save_record(record: "CalibrationRecord", path: Path) -> Path | None:
    """Write a record; give the file in which the one it replaces is kept, if any."""
    kept = keep_old(path)
    record.save(path)
    part_path(path).unlink(missing_ok=True)
    return kept


def keep_old(path: Path) -> Path | None:
    """Copy a file, if there is one, to a name with its date; give that name.

    Raises:
        CalibrationError: The copy cannot be written.
    """
    if not path.exists():
        return None
    stem = f"{path.stem}-{_date_of(path)}"
    kept, n = path.with_name(stem + path.suffix), 1
    while kept.exists() and kept.read_bytes() != path.read_bytes():
        n += 1
        kept = path.with_name(f"{stem}-{n}{path.suffix}")
    try:
        shutil.copy2(path, kept)
    except OSError as error:
        raise CalibrationError(f"calibration record {kept}: {error.strerror}") from error
    return kept


def _date_of(path: Path) -> str:
    """Give the date a record names, or when the file was written; fit for a file's name."""
    try:
        moment = datetime.fromisoformat(json.loads(path.read_bytes())["created_utc"])
    except (ValueError, KeyError, TypeError):
        moment = datetime.fromtimestamp(path.stat().st_mtime, UTC)
    return f"{moment:%Y%m%dT%H%M%SZ}"
