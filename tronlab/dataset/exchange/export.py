"""Writing a recorded dataset in a format of others."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Final

from tronlab.dataset.exchange.bop import BopExporter
from tronlab.dataset.exchange.colmap import ColmapExporter
from tronlab.dataset.exchange.folder import FolderExporter
from tronlab.dataset.exchange.manifest import write_manifest
from tronlab.dataset.exchange.shots import Exporter, OnShot
from tronlab.dataset.exchange.speed_plus import SpeedPlusExporter
from tronlab.dataset.exchange.staging import staged_folder
from tronlab.dataset.exchange.tum import TumExporter
from tronlab.dataset.reader import Dataset
from tronlab.errors import DatasetError

EXPORTERS: Final[Mapping[str, Exporter]] = MappingProxyType(
    {
        "bop": BopExporter(),
        "speedplus": SpeedPlusExporter(),
        "tum": TumExporter(),
        "colmap": ColmapExporter(),
        "folder": FolderExporter(),
    }
)
"""By the name that the command line knows them by."""


def export(
    dataset_path: Path, format_name: str, out_dir: Path, *, on_shot: OnShot | None = None
) -> None:
    """Write the current shots of a dataset into a new folder, one at a time.

    Beside what the format asks for, ``README.txt`` and ``tronlab.json`` say where it comes from.

    Args:
        dataset_path: The dataset.
        format_name: One of ``EXPORTERS``.
        out_dir: The folder; it must not exist, its parent must.
        on_shot: Told how far it is.

    Raises:
        DatasetError: An unknown format, a dataset that cannot be read, holds no shots or lacks what
            the format needs, or a folder that is there already or cannot be written. Nothing is
            left of the folder then.
        IntegrityError: A shot is damaged.
    """
    exporter = EXPORTERS.get(format_name)
    if exporter is None:
        raise DatasetError(f"no format '{format_name}'; known are {', '.join(EXPORTERS)}")
    with Dataset(dataset_path) as dataset:
        if not dataset.n_shots:
            raise DatasetError(f"{dataset_path}: holds no shots: there is nothing to export")
        with staged_folder(out_dir) as folder:
            images = exporter.write(dataset, folder, on_shot or _keep_quiet)
            write_manifest(
                folder,
                dataset,
                format_name=format_name,
                conventions=exporter.conventions,
                images=images,
            )


def _keep_quiet(_n_done: int, _n_all: int) -> None:
    pass
