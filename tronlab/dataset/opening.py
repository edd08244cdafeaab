"""Opening a dataset file: every way that can fail, told in plain words."""

import errno
from pathlib import Path

import h5py

from tronlab import __version__
from tronlab.dataset import schema
from tronlab.errors import DatasetError, IntegrityError, SchemaVersionError


def open_dataset(path: Path) -> h5py.File:
    """Open a dataset for reading.

    Raises:
        DatasetError: No such file, a directory, not HDF5, not a dataset, or being written.
        SchemaVersionError: Written in a layout of another major version.
        IntegrityError: Empty, truncated or damaged.
    """
    _check_file(path)
    file = _open(path)
    try:
        _check_schema(path, file)
    except BaseException:
        file.close()
        raise
    return file


def _check_file(path: Path) -> None:
    if path.is_dir():
        inside = path / "dataset.h5"
        hint = f"; did you mean {inside}?" if inside.is_file() else "; name the .h5 file in it"
        raise DatasetError(f"{path}: is a directory, not a dataset{hint}")
    if not path.exists():
        raise DatasetError(f"{path}: no such file")
    if path.stat().st_size == 0:
        raise IntegrityError(f"{path}: is empty; recording or copying it never began")


def _open(path: Path) -> h5py.File:
    try:
        if not h5py.is_hdf5(path):
            path.open("rb").close()  # a file that may not be read is not HDF5 to h5py either
            raise DatasetError(f"{path}: is not an HDF5 file")
        return h5py.File(path, "r")
    except PermissionError as error:
        raise DatasetError(f"{path}: may not be read; check its permissions") from error
    except BlockingIOError as error:
        raise DatasetError(
            f"{path}: is being written by another process; try again when that has ended"
        ) from error
    except (OSError, RuntimeError) as error:
        if getattr(error, "errno", None) in {errno.EACCES, errno.EPERM}:
            raise DatasetError(f"{path}: may not be read; check its permissions") from error
        raise IntegrityError(_damage(path, error)) from error


def _damage(path: Path, error: Exception) -> str:
    if "truncated" in str(error):
        return (
            f"{path}: is truncated: it has {path.stat().st_size} bytes and says it should have"
            f" more; it was copied incompletely, copy it again (HDF5: {error})"
        )
    return (
        f"{path}: is damaged and cannot be opened; fetch it again from its source (HDF5: {error})"
    )


def _check_schema(path: Path, file: h5py.File) -> None:
    try:
        text = file.attrs.get(schema.SCHEMA_ATTRIBUTE)
    except (OSError, RuntimeError, UnicodeDecodeError) as error:
        raise IntegrityError(_damage(path, error)) from error
    if text is None:
        raise DatasetError(
            f"{path}: is an HDF5 file but not a tronlab dataset (no attribute"
            f" '{schema.SCHEMA_ATTRIBUTE}')"
        )
    major, _, minor = str(text).partition(".")
    if not (major.isdecimal() and minor.isdecimal()):
        raise IntegrityError(
            f"{path}: attribute '{schema.SCHEMA_ATTRIBUTE}' is {text!r}, expected major.minor"
        )
    oldest, ours = schema.OLDEST_MAJOR, schema.SCHEMA_VERSION[0]
    if not oldest <= int(major) <= ours:
        advice = "install a newer tronlab" if int(major) > ours else "use an older tronlab"
        raise SchemaVersionError(
            f"{path}: written in dataset layout {text}; tronlab {__version__} reads layouts"
            f" {oldest}.x to {ours}.x; {advice}"
        )
