"""The settings of the built-in cores: one model a stage, and the presets that have names."""

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import Field, field_validator

from tronlab.yaml_models import Model, parse_mapping
from tronlab.yaml_variants import merged

Positive: TypeAlias = Annotated[float, Field(gt=0)]
Count: TypeAlias = Annotated[int, Field(ge=1)]


class DetectorSettings(Model):
    """How features are found."""

    features: Literal["akaze", "brisk"] = "akaze"
    """Which detector and descriptor."""
    threshold: Positive | None = None
    """Of the detector; without a value 0.001 for AKAZE, 30 for BRISK."""
    n_max: Count | None = None
    """Most features kept of an image; without a value 2000 for AKAZE, 3000 for BRISK."""
    cell_px: Positive | None = 48.0
    """Side of the cells over which they are spread; ``null``: the strongest, wherever they are."""


class MatchingSettings(Model):
    """How features find their landmarks."""

    method: Literal["flann", "exact", "hashing"] = "hashing"
    """``hashing``: locality-sensitive hashing with bits chosen for the database. ``flann``: that of
    OpenCV, as in the paper, the best matches searched again exactly. ``exact``: every descriptor
    against every other."""
    guided: bool = True
    """Look again, only where a first pose says that landmarks are; or a prior, where one is
    offered."""
    max_ratio: Annotated[float, Field(gt=0, le=1)] = 0.8
    """Largest distance of a match over that to its nearest rival."""
    max_size_px: Positive | None = None
    """Largest feature a first pose rests on: the places of large ones are pixels off."""
    mutual: bool = False
    """A first pose rests only on matches whose landmark has no feature in the image that is more
    like it."""
    best_by: Literal["ratio", "distance"] = "ratio"
    """Which matches are the best: the least ambiguous, or, as in the paper, those whose descriptors
    differ least."""
    max_per_cell: Count | None = None
    """Most matches of one cell of the image that a first pose rests on, the best ones; without a
    value all."""
    cell_px: Positive = 48.0
    """Side of these cells."""
    n_max: Count | None = None
    """Most matches a first pose rests on, the best ones; without a value all."""


class PoseSettings(Model):
    """How matches become a pose."""

    robust: Literal["none", "ransac", "usac", "poselib"] = "usac"
    """How wrong matches are found. ``none`` trusts all, as the paper does; ``ransac`` is the
    classical one around EPnP, good for one wrong match in two; ``usac`` (OpenCV) and ``poselib``
    (an extra) are faster and good for nine in ten."""
    solver: Literal["epnp", "sqpnp"] = "sqpnp"
    """From the matches that are trusted. SQPnP is as good as least squares, EPnP is the paper's.
    PoseLib has one of its own."""
    n_best: Count | None = 500
    """Most matches the robust estimate looks at, the least ambiguous ones; ``null``: all."""
    tolerance_px: Positive = 4.0
    """Largest residual of a match that agrees, at the centre of the image; what the match's
    uncertainty is does not count here."""
    refine: bool = True
    """Robust least squares on every match that agrees."""
    weigh_by_size: bool = True
    """The place of a feature is the less certain the larger the feature; without, all are alike."""
    gate_px: Positive = 6.0
    """Largest residual at the start of least squares, times how much less certain a match is than
    the best."""
    max_sigma_pct: Positive = 5.0
    """Largest standard deviation of the position the matches allow, in per cent of their distance;
    beyond it the view carries no pose."""

    @field_validator("robust")
    @classmethod
    def _is_installed(cls, robust: str) -> str:
        if robust == "poselib" and find_spec("poselib") is None:
            raise ValueError(
                "PoseLib is not installed: pip install 'tronlab[poselib]', or choose usac"
            )
        return robust


class FeatureCoreSettings(Model):
    """A core of one detector and one estimator."""

    detector: DetectorSettings = DetectorSettings()
    matching: MatchingSettings = MatchingSettings()
    pose: PoseSettings = PoseSettings()
    database: Path | None = None
    """File of ``tronlab database build``; without it the landmarks are found in the reference views
    of the dataset."""


def _paper(features: Literal["akaze", "brisk"], max_ratio: float) -> FeatureCoreSettings:
    """Give the paper's estimator (section 2.3): the best matches through EPnP, all trusted.

    Best is the least ambiguous here, not the smallest difference of descriptors:
    docs/decisions/0006 says why.
    """
    return FeatureCoreSettings(
        detector=DetectorSettings(features=features),
        matching=MatchingSettings(
            method="flann", guided=False, max_ratio=max_ratio, max_size_px=30.0
        ),
        pose=PoseSettings(robust="none", solver="epnp", refine=False),
    )


def _refined(features: Literal["akaze", "brisk"]) -> FeatureCoreSettings:
    return FeatureCoreSettings(detector=DetectorSettings(features=features))


PRESETS: Mapping[str, FeatureCoreSettings] = {
    "akaze": _paper("akaze", 0.33),
    "brisk": _paper("brisk", 0.36),
    "akaze-refined": _refined("akaze"),
    "brisk-refined": _refined("brisk"),
}
"""What each built-in core is, by name."""


def core_settings(name: str, changes: Mapping[str, Any]) -> FeatureCoreSettings:
    """Give the settings of a built-in core, some of them changed.

    Args:
        name: Of the preset.
        changes: Nested as the model is: ``{"pose": {"gate_px": 3}}``.

    Raises:
        ConfigError: A change is none of the model.
    """
    values = merged(PRESETS[name].model_dump(mode="json"), changes)
    return parse_mapping(values, FeatureCoreSettings, key=f"settings of {name}")
