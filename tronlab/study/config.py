"""The study file: which laboratories, which datasets, and what is asked of them.

The paper's datasets have fixed names, for figures and tables need to know which is which.
"""

from collections.abc import Iterable
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import Field, model_validator

from tronlab.yaml_models import ExistingFile, Model

Count: TypeAlias = Annotated[int, Field(ge=1)]
Name: TypeAlias = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$")]
DatasetName: TypeAlias = Literal[
    "dataset_0",
    "dataset_1_nominal",
    "dataset_1_perturbed",
    "dataset_2_nominal",
    "dataset_2_perturbed",
]
MeasuredPart: TypeAlias = Literal["frame", "intrinsics", "hand_eye", "lamp", "photometry"]
Changes: TypeAlias = Annotated[dict[str, Any], Field(default_factory=dict)]
"""Keys of a file, nested, with the values they get instead; as ``changes`` of a rig variant."""


class LaboratoryConfig(Model):
    """A simulated laboratory with one lens."""

    rig: ExistingFile
    """Rig file, relative to this file, likewise the other files."""
    record: ExistingFile
    """Its calibration record as it is kept with the campaigns. A full study measures another one;
    a quick one takes this."""
    photometry: ExistingFile | None = None
    """Campaign whose images a full study takes to measure how the model reflects light; null: it
    does not. Rig and calibration record are those of the laboratory, whatever it names."""
    larger: ExistingFile | None = None
    """Rig that differs by a terrain model that fills the image, and by a lamp that lights it."""
    larger_record: ExistingFile | None = None
    """Calibration record of that rig, likewise; null: that of the other serves, for nothing that is
    calibrated differs."""


class DatasetConfig(Model):
    """A dataset of the paper."""

    campaign: ExistingFile
    """Campaign file. Rig and calibration record are those of the laboratory, whatever it names."""
    laboratory: Name
    """Key of ``laboratories``."""


class SourceConfig(Model):
    """One way in which what the camera sees differs from what the database renderer assumes."""

    title: str
    """As the table has it."""
    kind: Literal["terrain", "light", "camera", "truth"]
    """What it is an error of."""
    rig: Changes
    """What of the rig file is to be changed so that the source is gone."""
    campaign: Changes
    """Likewise of the campaign."""
    known: tuple[MeasuredPart, ...] = ()
    """Parts of the calibration that are known without error then, instead of measured."""


class AblationConfig(Model):
    """What each source of dissimilarity costs."""

    every_n: Annotated[dict[DatasetName, Count], Field(min_length=1)]
    """Datasets it is found out with, of each every so many shots."""
    sources: Annotated[dict[Name, SourceConfig], Field(min_length=1)]
    """What is switched off, one at a time and all together, by name."""


class SelectionVariant(Model):
    """One way of choosing features and matches."""

    title: str
    step: Literal[
        "spread", "ratio", "mutual", "geometry", "pruning", "guided", "refinement", "together"
    ]
    """What is chosen by."""
    base: str
    """Core that it is held against."""
    settings: Changes
    """Of the base, changed; see ``tronlab.nav.settings``."""
    prune_to: Annotated[float, Field(gt=0, lt=1)] | None = None
    """Part of the landmarks that is kept."""
    prune_by: Literal["random", "strength", "place", "scores"] = "place"
    """Which are kept: any; the strongest features; the strongest of each place on the terrain; or
    those that verified most often in the other half of the shots."""


class SelectionConfig(Model):
    """How much each choice of features and matches gains."""

    datasets: Annotated[tuple[DatasetName, ...], Field(min_length=1)]
    """Those they are tried on."""
    variants: Annotated[dict[Name, SelectionVariant], Field(min_length=1)]
    """What is tried, by name."""


class LoadConfig(Model):
    """What localisation costs in time and memory."""

    cores: Annotated[tuple[str, ...], Field(min_length=1)]
    """Built-in ones."""
    image_px: Annotated[tuple[Count, ...], Field(min_length=1)]
    """Sides of square images."""
    n_features: Annotated[tuple[Count, ...], Field(min_length=1)]
    """Features kept of an image."""
    n_landmarks: Annotated[tuple[Count, ...], Field(min_length=1)]
    """Landmarks in the database."""
    n_images: Count = 5
    """Of which the median is taken."""


class QuickConfig(Model):
    """What a quick study leaves out."""

    every_n: Annotated[dict[DatasetName, Count], Field(min_length=1)]
    """Of each dataset every so many shots; a dataset that is not named is left out."""
    perturbed_only: tuple[Count, ...] = (1, 2)
    """Which of the perturbed trajectories are flown."""
    ablation_every_n: Annotated[dict[DatasetName, Count], Field(min_length=1)]
    """Instead of ``ablation.every_n``."""
    sources: tuple[Name, ...]
    """Which sources of dissimilarity are looked at."""
    larger: tuple[DatasetName, ...]
    """Which datasets are taken with the larger terrain."""
    selection: tuple[Name, ...]
    """Which variants of ``selection``."""
    load: LoadConfig
    """Instead of ``load``."""


class StudyConfig(Model):
    """A study file."""

    name: Name
    """Short name; results go to out/NAME unless told otherwise."""
    title: str = ""
    """One line for the report."""
    laboratories: Annotated[dict[Name, LaboratoryConfig], Field(min_length=1)]
    """Where datasets are taken, by name: one a lens."""
    datasets: Annotated[dict[DatasetName, DatasetConfig], Field(min_length=1)]
    """The paper's, by name; some may be left out."""
    cores: Annotated[tuple[str, ...], Field(min_length=1)] = (
        "akaze",
        "brisk",
        "akaze-refined",
        "brisk-refined",
    )
    """Navigation cores that every dataset is scored with, as ``tronlab score --core`` takes
    them."""
    larger: tuple[DatasetName, ...] = ()
    """Datasets that are taken with the larger terrain too."""
    ablation: AblationConfig
    selection: SelectionConfig
    load: LoadConfig
    quick: QuickConfig

    @model_validator(mode="after")
    def _names_are_known(self) -> "StudyConfig":
        quick = self.quick
        named: list[tuple[str, Iterable[str], Iterable[str]]] = [
            ("larger", self.larger, self.datasets),
            ("ablation.every_n", self.ablation.every_n, self.datasets),
            ("selection.datasets", self.selection.datasets, self.datasets),
            ("quick.every_n", quick.every_n, self.datasets),
            ("quick.ablation_every_n", quick.ablation_every_n, self.datasets),
            ("quick.larger", quick.larger, self.larger),
            ("quick.sources", quick.sources, self.ablation.sources),
            ("quick.selection", quick.selection, self.selection.variants),
        ]
        named += [
            (f"datasets.{name}.laboratory", [dataset.laboratory], self.laboratories)
            for name, dataset in self.datasets.items()
        ]
        for where, names, known in named:
            if unknown := [name for name in names if name not in known]:
                raise ValueError(
                    f"{where}: {unknown[0]!r} is not in this file; there are: {', '.join(known)}"
                )
        return self
