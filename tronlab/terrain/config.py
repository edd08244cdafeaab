"""What a rig file says about its terrain model."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self, TypeAlias

from pydantic import Field, model_validator

from tronlab.yaml_models import Model

MAX_SAMPLES_IN_MEMORY = 100_000_000
"""A height map of more samples stays in its file: 400 MB of heights."""
MAX_SAMPLES = 2**31 - 1
"""Largest number of samples of a height map: 8.6 GB on the disk. Kernels count in 32 bits."""

LengthM: TypeAlias = Annotated[float, Field(ge=0.02, le=50.0)]
CoordinateM: TypeAlias = Annotated[float, Field(ge=-100.0, le=100.0)]
PixelIndex: TypeAlias = Annotated[int, Field(ge=0)]
PixelCount: TypeAlias = Annotated[int, Field(ge=8)]
RegistrationM: TypeAlias = Annotated[float, Field(ge=0.0, le=0.1)]
RegistrationDeg: TypeAlias = Annotated[float, Field(ge=0.0, le=5.0)]


@dataclass(frozen=True, slots=True)
class Registration:
    """How well a terrain model lies where the laboratory believes; by default exactly."""

    sigma_m: float = 0.0
    """Standard deviation of its place, along each axis of F_TRS."""
    sigma_deg: float = 0.0
    """Standard deviation of its turn about its middle, about each axis."""

    @property
    def is_exact(self) -> bool:
        """Get whether it lies there without any error."""
        return self.sigma_m == 0.0 and self.sigma_deg == 0.0


class _Painted(Model):
    albedo_map: Path | None = None
    """Grey picture of 8 or 16 bit that is stretched over the model, rows down it; white is 1. The
    albedo is multiplied by it. Relative to the rig file."""

    @property
    def files(self) -> tuple[Path, ...]:
        """Get the files it is made from, as they are named."""
        return () if self.albedo_map is None else (self.albedo_map,)

    @property
    def registration(self) -> Registration:
        """Get how well it lies where the laboratory believes."""
        return Registration()


class _Terrain(_Painted):
    most_samples: ClassVar[int] = MAX_SAMPLES_IN_MEMORY

    size_m: tuple[LengthM, LengthM] = (2.2, 4.2)
    """Extent along X_TRS (down the model) and along Y_TRS (to the right), 0.02 to 50 m each."""
    relief_m: float = Field(default=0.26, gt=0.0, le=10.0)
    """Difference between the highest and the lowest point."""
    origin_trs_m: tuple[CoordinateM, CoordinateM, CoordinateM] = (-0.02, -0.02, -0.13)
    """Top left corner of the model at the height of its lowest point, in F_TRS."""
    spacing_m: float = Field(default=0.001, ge=1e-4, le=0.01)
    """Distance between two samples of the height map, 0.0001 to 0.01 m."""

    @property
    def shape(self) -> tuple[int, int]:
        """Get (rows, columns) of the height map."""
        rows, columns = (round(length / self.spacing_m) + 1 for length in self.size_m)
        return rows, columns

    @model_validator(mode="after")
    def _check_number_of_samples(self) -> Self:
        rows, columns = self.shape
        if rows * columns > self.most_samples:
            raise ValueError(
                f"{rows} x {columns} samples are too many (at most {self.most_samples}):"
                " make spacing_m larger or size_m smaller"
            )
        if min(rows, columns) < 8:
            raise ValueError(
                f"{rows} x {columns} samples are too few (at least 8 x 8):"
                " make spacing_m smaller or size_m larger"
            )
        return self


class ProceduralTerrain(_Terrain):
    """A cratered, rough terrain made from a seed.

    Of more than 100 million samples it is made in pieces and stays in a file of the cache: 4 bytes
    a sample, and 1.7 bytes for the renderer.
    """

    most_samples: ClassVar[int] = MAX_SAMPLES

    kind: Literal["procedural"] = "procedural"
    seed: int = Field(default=1, ge=0)
    """The same seed and settings give the same heights, bit for bit on one machine."""
    spacing_m: float = Field(default=0.0005, ge=1e-4, le=0.01)
    """Distance between two samples of the height map, 0.0001 to 0.01 m."""
    crater_exponent: float = Field(default=2.0, ge=1.0, le=4.0)
    """b of the size-frequency law N(> D) = a (D / 1 m)^-b per square metre."""
    crater_density_per_m2: float = Field(default=0.15, ge=0.0, le=1.0)
    """a of the size-frequency law: how many craters wider than 1 m a square metre would have."""
    crater_smallest_m: float = Field(default=0.006, ge=0.001, le=10.0)
    """Diameter of the smallest crater, rim to rim."""
    crater_largest_m: float = Field(default=0.8, ge=0.001, le=20.0)
    """Diameter of the largest crater, rim to rim."""
    hurst_exponent: float = Field(default=0.8, gt=0.0, lt=1.0)
    """How roughness grows with scale: heights differ by ~ distance^H in the root mean square."""
    roughness_slope: float = Field(default=0.12, ge=0.0, le=1.0)
    """Root mean square of the rise over a run of 10 mm, craters apart, before the scaling to
    ``relief_m``."""

    @model_validator(mode="after")
    def _check_law(self) -> Self:
        if self.crater_largest_m <= self.crater_smallest_m:
            raise ValueError(
                f"crater_largest_m is {self.crater_largest_m}, must be more than"
                f" crater_smallest_m, {self.crater_smallest_m}"
            )
        if self.crater_density_per_m2 == 0.0 and self.roughness_slope == 0.0:
            raise ValueError(
                "crater_density_per_m2 and roughness_slope are both 0: the terrain would be flat"
            )
        return self


class FileTerrain(_Terrain):
    """A height map from a file: GeoTIFF, PDS3 image, 16-bit PNG or NumPy.

    Rows of the file run down the model, its lowest sample lies at height 0 and its highest at
    ``relief_m``. What does not fit the shape of ``size_m`` is cut off on both sides.
    """

    kind: Literal["file"] = "file"
    path: Path
    """16-bit grey .png, .tif with heights in metres, .img or .lbl of PDS3, or .npy of float32,
    float64, int16 or uint16; relative to the rig file."""
    crop_px: tuple[PixelIndex, PixelIndex, PixelCount, PixelCount] | None = None
    """Part of the file to use: first row, first column, rows, columns; without it, all of it."""
    holes_px: int = Field(default=0, ge=0)
    """Widest hole to fill, in samples of the file; a wider one is an error. 0: any hole is."""
    roughness_slope: float = Field(default=0.0, ge=0.0, le=1.0)
    """Roughness added below the file's own resolution, so that a map enlarged to a model is not
    smooth close by: root mean square of the rise over a run of 10 mm. 0: the file as it is."""
    hurst_exponent: float = Field(default=0.8, gt=0.0, lt=1.0)
    """How the added roughness grows with scale."""
    seed: int = Field(default=1, ge=0)
    """Seed of the added roughness."""
    registration_sigma_m: RegistrationM = 0.0
    """Standard deviation of where the model is placed, along each axis, as the laboratory states
    it: it becomes part of the truth's uncertainty."""
    registration_sigma_deg: RegistrationDeg = 0.0
    """Likewise of how it is turned about its middle, about each axis."""

    @property
    def files(self) -> tuple[Path, ...]:
        """Get the files it is made from, as they are named."""
        return (self.path, *super().files)

    @property
    def registration(self) -> Registration:
        """Get how well it lies where the laboratory believes."""
        return Registration(self.registration_sigma_m, self.registration_sigma_deg)


class DemTerrain(_Painted):
    """A terrain model in metres, exactly as it stands in tronlab's own file.

    ``tronlab terrain make``, ``scan`` and ``convert`` write such files.
    """

    kind: Literal["dem"] = "dem"
    path: Path
    """NAME.npy, with its description NAME.json beside it; relative to the rig file."""
    origin_trs_m: tuple[CoordinateM, CoordinateM, CoordinateM] | None = None
    """Where sample (0, 0) would lie at height 0, in F_TRS; by default as the description says."""
    registration_sigma_m: RegistrationM = 0.0
    """Standard deviation of where the model is placed, along each axis, as the laboratory states
    it: it becomes part of the truth's uncertainty."""
    registration_sigma_deg: RegistrationDeg = 0.0
    """Likewise of how it is turned about its middle, about each axis."""

    @property
    def files(self) -> tuple[Path, ...]:
        """Get the files it is made from, as they are named."""
        return (self.path, *super().files)

    @property
    def registration(self) -> Registration:
        """Get how well it lies where the laboratory believes."""
        return Registration(self.registration_sigma_m, self.registration_sigma_deg)


class ScanConfig(Model):
    """How well a terrain model is measured."""

    spacing_m: float | None = Field(default=None, ge=1e-4, le=0.1)
    """Between two samples of the scan; by default that of the terrain."""
    noise_sigma_m: float = Field(default=0.0, ge=0.0, le=0.1)
    """Standard deviation of the noise that every sample has by itself."""
    correlated_sigma_m: float = Field(default=0.0, ge=0.0, le=0.1)
    """Standard deviation of the noise that neighbouring samples share."""
    correlation_length_m: float = Field(default=0.05, gt=0.0, le=10.0)
    """Distance at which the shared noise's correlation has fallen to 1/e; it falls like a Gauss
    curve."""
    spot_diameter_m: float = Field(default=0.0, ge=0.0, le=0.1)
    """Diameter of the scanner's spot on the surface, to 1/e^2 of its light: finer shapes blur."""
    registration_sigma_m: RegistrationM = 0.0
    """Standard deviation of where the scan is placed, along each axis; it becomes part of the
    truth's uncertainty."""
    registration_sigma_deg: RegistrationDeg = 0.0
    """Likewise of how it is turned about the model's middle, about each axis."""
    scanners_trs_m: tuple[tuple[CoordinateM, CoordinateM, CoordinateM], ...] = ()
    """Where the scanner stood, in F_TRS; what it sees from none of these places is a hole.
    Without any, everything is seen."""
    widest_hole_m: Annotated[float, Field(gt=0.0, le=10.0)] = 0.2
    """Wider holes are an error: no laboratory would fill them."""
    seed: int = Field(default=1, ge=0)

    @property
    def registration(self) -> Registration:
        """Get how well it lies where the laboratory believes."""
        return Registration(self.registration_sigma_m, self.registration_sigma_deg)


MadeTerrain = Annotated[ProceduralTerrain | FileTerrain | DemTerrain, Field(discriminator="kind")]


class ScannedTerrain(_Painted):
    """What a laser scanner makes of another terrain: how a laboratory knows its model.

    It lies where the other one is believed to lie. Paint is not scanned.
    """

    kind: Literal["scan"] = "scan"
    of: MadeTerrain
    """The terrain that is scanned, as it really is."""
    scan: ScanConfig = ScanConfig()
    """How well."""

    @property
    def files(self) -> tuple[Path, ...]:
        """Get the files it is made from, as they are named."""
        return (*self.of.files, *super().files)

    @property
    def registration(self) -> Registration:
        """Get how well it lies where the laboratory believes."""
        return self.scan.registration

    @model_validator(mode="after")
    def _check_registration(self) -> Self:
        if not self.of.registration.is_exact:
            raise ValueError(
                "of.registration_sigma_m or of.registration_sigma_deg is not 0, but the terrain"
                " that is scanned lies where it lies: state both under scan"
            )
        return self


TerrainConfig = Annotated[
    ProceduralTerrain | FileTerrain | DemTerrain | ScannedTerrain, Field(discriminator="kind")
]
