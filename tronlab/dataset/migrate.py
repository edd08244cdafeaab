"""A dataset of an older layout in the layout of today."""

from pathlib import Path

from tronlab.dataset import schema
from tronlab.dataset.reader import Dataset
from tronlab.dataset.transcript import OnStage, silent, transcribe, verify
from tronlab.dataset.whole_file import whole_file
from tronlab.errors import DatasetError


def migrate(source: Path, target: Path, *, on_stage: OnStage | None = None) -> None:
    """Write a dataset of an older layout as one file of today's, and read it back.

    Nothing needs this to be read: every version reads the older layouts. What an older file does
    not say is marked as unknown.

    Args:
        source: The dataset; it stays as it is.
        target: The new file.
        on_stage: Told how far it is.

    Raises:
        DatasetError: The dataset cannot be read or has today's layout already, or the file exists
            or cannot be made; nothing is left of it then.
        IntegrityError: Something in the dataset is damaged.
    """
    with Dataset(source) as dataset:
        if dataset.schema_version == schema.VERSION_TEXT:
            raise DatasetError(
                f"{source}: is of layout {schema.VERSION_TEXT} already: nothing to migrate;"
                " one file without segments makes: tronlab dataset pack"
            )
    with whole_file(target) as part:
        transcribe(source, part, on_stage=on_stage or silent)
        verify(part, on_stage=on_stage or silent)
