"""Which file a person means who names a dataset."""

from pathlib import Path

from tronlab.dataset.places import part_of
from tronlab.errors import DatasetError

DATASET_NAME = "dataset.h5"
"""What a run calls its dataset, whatever its folder is called."""


def dataset_in(path: Path) -> Path:
    """Give the file of a dataset named by itself or by the folder of its run.

    Raises:
        DatasetError: The folder holds no dataset.
    """
    if not path.is_dir():
        return path
    inside = path / DATASET_NAME
    if inside.exists():
        return inside
    if _is_begun(inside):
        raise DatasetError(f"{path}: its run has not recorded a shot yet")
    raise DatasetError(
        f"{path}: is a folder without {DATASET_NAME}; name the .h5 file, or the folder of a run"
    )


def dataset_to_note_in(path: Path) -> Path:
    """Give the dataset whose journal a note goes to; its run may still be before the first shot.

    Raises:
        DatasetError: There is no dataset, and no run that begins one.
    """
    inside = path / DATASET_NAME if path.is_dir() else path
    if inside.is_file() or _is_begun(inside):
        return inside
    raise DatasetError(f"{inside}: no such file; name the .h5 file, or the folder of a run")


def _is_begun(dataset_path: Path) -> bool:
    """Tell whether a run made ready to record a dataset but has not recorded a shot of it."""
    return part_of(dataset_path).exists()
