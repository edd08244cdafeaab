"""One compressed file of a dataset, to keep it or to hand it on."""

from dataclasses import dataclass
from pathlib import Path

from tronlab.dataset.reader import Dataset
from tronlab.dataset.summary import bytes_on_disk, files_of
from tronlab.dataset.transcript import OnStage, silent, transcribe, verify
from tronlab.dataset.whole_file import whole_file


@dataclass(frozen=True, slots=True)
class Packed:
    """What packing brought."""

    n_bytes_before: int
    """Of all files of the dataset, on the disk."""
    n_bytes: int

    @property
    def ratio(self) -> float:
        """Get how many bytes one byte holds now."""
        return self.n_bytes_before / self.n_bytes

    def __str__(self) -> str:
        """Give it in a line."""
        return (
            f"{self.n_bytes_before / 1e6:.1f} MB packed into {self.n_bytes / 1e6:.1f} MB"
            f" (1/{self.ratio:.2f})"
        )


def pack(
    source: Path,
    target: Path,
    *,
    level: int = 4,
    keeps_all_rows: bool = False,
    on_stage: OnStage | None = None,
) -> Packed:
    """Write a dataset as one file with compressed images, without loss, and read it back.

    Args:
        source: The dataset; it stays as it is.
        target: The new file.
        level: 1 is fast, 9 is small.
        keeps_all_rows: Whether rows stay that were superseded when their shot was taken again.
        on_stage: Told how far it is.

    Raises:
        DatasetError: The dataset cannot be read or is being recorded, or the file exists or cannot
            be made; nothing is left of it then.
        IntegrityError: Something in the dataset is damaged.
    """
    on_stage = on_stage or silent
    with Dataset(source) as dataset:
        n_bytes_before = bytes_on_disk(files_of(dataset))
    with whole_file(target) as part:
        transcribe(source, part, level=level, keeps_all_rows=keeps_all_rows, on_stage=on_stage)
        verify(part, on_stage=on_stage)
    return Packed(n_bytes_before, bytes_on_disk([target]))
