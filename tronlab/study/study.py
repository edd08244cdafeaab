"""A study file that was read: which files and folders its parts are about."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from tronlab.errors import ConfigError
from tronlab.study.config import (
    DatasetName,
    LaboratoryConfig,
    LoadConfig,
    SelectionVariant,
    SourceConfig,
    StudyConfig,
)
from tronlab.yaml_models import dotted, line_of, parse_model, read_text


@dataclass(frozen=True, slots=True)
class Study:
    """A study file, and whether all of it is done or what a quick look needs.

    Folders are given relative to the study's own: steps are known before there is one.
    """

    config: StudyConfig
    path: Path
    text: str
    """The file as it is written."""
    quick: bool = False

    @property
    def datasets(self) -> tuple[DatasetName, ...]:
        """Get the datasets that are taken, in the order of the file."""
        return tuple(
            name
            for name in self.config.datasets
            if not self.quick or name in self.config.quick.every_n
        )

    @property
    def larger(self) -> tuple[DatasetName, ...]:
        """Get those that are taken with the larger terrain too."""
        named = self.config.quick.larger if self.quick else self.config.larger
        return tuple(name for name in self.datasets if name in named)

    @property
    def laboratories(self) -> tuple[str, ...]:
        """Get the laboratories that these are taken in, in the order of the file."""
        used = {self.config.datasets[name].laboratory for name in self.datasets}
        return tuple(name for name in self.config.laboratories if name in used)

    @property
    def sources(self) -> Mapping[str, SourceConfig]:
        """Get the sources of dissimilarity that are looked at, by name."""
        sources = self.config.ablation.sources
        if not self.quick:
            return sources
        return {name: sources[name] for name in self.config.quick.sources}

    @property
    def ablation_every_n(self) -> Mapping[DatasetName, int]:
        """Get the datasets of the ablation: of each every so many shots."""
        quick = self.config.quick
        return quick.ablation_every_n if self.quick else self.config.ablation.every_n

    @property
    def selection(self) -> Mapping[str, SelectionVariant]:
        """Get the ways of choosing features and matches that are held against each other."""
        variants = self.config.selection.variants
        if not self.quick:
            return variants
        return {name: variants[name] for name in self.config.quick.selection}

    @property
    def selection_datasets(self) -> tuple[DatasetName, ...]:
        """Get the datasets they are tried on."""
        return tuple(name for name in self.datasets if name in self.config.selection.datasets)

    @property
    def load(self) -> LoadConfig:
        """Get what the computational load is measured against."""
        return self.config.quick.load if self.quick else self.config.load

    def every_n(self, dataset: DatasetName) -> int:
        """Give of how many shots of a dataset one is taken."""
        return self.config.quick.every_n[dataset] if self.quick else 1

    def laboratory_name(self, dataset: DatasetName) -> str:
        """Give the name of the laboratory that a dataset is taken in."""
        return self.config.datasets[dataset].laboratory

    def laboratory(self, dataset: DatasetName) -> LaboratoryConfig:
        """Give the laboratory that a dataset is taken in."""
        return self.config.laboratories[self.laboratory_name(dataset)]

    def campaign_file(self, dataset: DatasetName) -> Path:
        """Give the campaign of a dataset."""
        return self.config.datasets[dataset].campaign

    def rig_file(self, dataset: DatasetName, *, larger: bool = False) -> Path:
        """Give the rig that a dataset is taken with.

        Raises:
            ConfigError: The laboratory has no larger terrain.
        """
        laboratory = self.laboratory(dataset)
        if not larger:
            return laboratory.rig
        if laboratory.larger is None:
            raise self.error(
                f"{dataset} is to be taken with the larger terrain, but its laboratory names no"
                " rig that has one",
                "laboratories",
                self.laboratory_name(dataset),
                "larger",
            )
        return laboratory.larger

    def record_path(
        self, dataset: DatasetName, out: Path = Path(), *, larger: bool = False
    ) -> Path:
        """Give where the calibration record of a dataset's laboratory is, below ``out``."""
        has_own = self.laboratory(dataset).larger_record is not None
        return out / record_file(self.laboratory_name(dataset), larger=larger and has_own)

    def dataset_folder(self, out: Path, dataset: DatasetName, *, larger: bool = False) -> Path:
        """Give the folder with recording, scores and report of a dataset, below ``out``."""
        return out / ("larger" if larger else "datasets") / dataset

    def error(self, message: str, *location: int | str) -> ConfigError:
        """Make an error about a key of the study file, with its line."""
        line = line_of(self.text, location)
        return ConfigError(message, path=self.path, line=line, key=dotted(location))


def load_study(path: Path, *, quick: bool = False) -> Study:
    """Read a study file.

    Raises:
        ConfigError: It cannot be read, or says something that cannot be.
    """
    text = read_text(path)
    return Study(parse_model(text, StudyConfig, path=path), path, text, quick)


def record_file(laboratory: str, *, larger: bool = False) -> Path:
    """Give where a laboratory's calibration record is in the folder of a study."""
    return Path("calibration") / f"{laboratory}{'_larger' if larger else ''}.json"


def study_folder(study: Study) -> Path:
    """Give where the results of a study go unless told otherwise."""
    return Path("out") / (f"{study.config.name}-quick" if study.quick else study.config.name)
