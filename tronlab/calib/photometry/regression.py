"""Which mixture of Lambert and Lommel-Seeliger explains the grey of patches best.

The grey of a patch is taken to be

    gain * cos^p(angle off the axis) * (exp(-s g) * (a * lambert + b * lommel_seeliger) + c),

and the lunar-Lambert function's share of Lommel-Seeliger is ``L = b / (a + b)`` (McEwen, Icarus 92
(1991), 298, who has a phase function before the same two terms). s is how that falls with the phase
angle g, p how the lens darkens towards the border (4 is the law of a simple lens), c the light from
everywhere. s belongs to the fit although renderings leave it out: over the few degrees of one
feature g hardly changes, L decides what is seen there, and paint that grows darker with g would
otherwise pass for another L.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tronlab.calib.inputs import PatchesInput
from tronlab.errors import DegenerateGeometryError
from tronlab.geometry.poses import FloatArray

Family: TypeAlias = Literal["lambert", "lommel_seeliger", "lunar_lambert"]
FAMILIES: Mapping[Family, tuple[int, ...]] = MappingProxyType(
    {"lambert": (0, 2), "lommel_seeliger": (1, 2), "lunar_lambert": (0, 1, 2)}
)
"""Which of a, b, c a family has."""
_DIM = 0.02
"""Errors of patches darker than this part of full scale count as if they were that bright: noise
and rounding do not shrink with the grey."""
_FOREIGN = 0.2
"""Patches off by more than this part of their brightness are left out: no paint is so far from the
lunar-Lambert function that fits it."""
_ROUNDS = 10
_START = 3.0, 0.0
"""Power and phase slope to start from."""
_STEPS = 60
_ABSURD = 100.0
"""Power and slope beyond which nothing is determined."""
_SMALLEST_STEP = 1e-12
"""The last step, against the numbers themselves: so a record solved again on another processor
gives the same to ``rerun.TOLERANCE``."""


@dataclass(frozen=True, slots=True)
class Patches:
    """The patches of all images, each array of shape (n,)."""

    grey: FloatArray
    """Part of full scale."""
    gain: FloatArray
    """Exposure time and gain against those of the first image."""
    log_cos_axis: FloatArray
    """Logarithm of the cosine of the angle off the optical axis."""
    terms: FloatArray
    """Lambert, Lommel-Seeliger, 1; shape (n, 3)."""
    phase_rad: FloatArray
    image: NDArray[np.intp]
    """Number of the image, from 0."""
    brightness: FloatArray
    """What errors are relative to: the grey, or that of a Lambert surface if it is more. So a
    patch that something shades counts no more than one that is lit."""

    @classmethod
    def of(cls, images: Sequence[PatchesInput]) -> "Patches":
        """Join the patches of images, at least one."""

        def joined(column: Callable[[PatchesInput], Sequence[float]]) -> FloatArray:
            return np.concatenate([np.array(column(image), np.float64) for image in images])

        gains = np.array([image.exposure_s * 10 ** (image.gain_db / 20) for image in images])
        sizes = [len(image.grey) for image in images]
        lambert = joined(lambda image: image.lambert)
        lommel_seeliger = joined(lambda image: image.lommel_seeliger)
        grey, gain = joined(lambda image: image.grey), np.repeat(gains / gains[0], sizes)
        expected = gain * lambert
        is_lit = lambert > 0
        expected *= np.median(grey[is_lit] / expected[is_lit])
        return cls(
            grey=grey,
            gain=gain,
            log_cos_axis=np.log(joined(lambda image: image.cos_axis)),
            terms=np.column_stack([lambert, lommel_seeliger, np.ones_like(lambert)]),
            phase_rad=np.radians(joined(lambda image: image.phase_deg)),
            image=np.repeat(np.arange(len(images)), sizes),
            brightness=np.maximum(np.maximum(grey, expected), _DIM),
        )

    def only(self, which: NDArray[np.bool_]) -> "Patches":
        """Give some of the patches."""
        return Patches(
            self.grey[which],
            self.gain[which],
            self.log_cos_axis[which],
            self.terms[which],
            self.phase_rad[which],
            self.image[which],
            self.brightness[which],
        )


@dataclass(frozen=True, slots=True)
class Mixture:
    """What explains the grey of patches."""

    factors: FloatArray
    """a, b, c: shape (3,)."""
    power: float
    """p."""
    phase_slope: float
    """s, 1/rad."""

    @property
    def weight(self) -> float:
        """Get the share of Lommel-Seeliger, L."""
        a, b, _ = self.factors
        return float(b / (a + b))

    @property
    def ambient(self) -> "Mixture":
        """Get the light from everywhere alone."""
        return Mixture(self.factors * (0, 0, 1), self.power, self.phase_slope)

    def grey(self, patches: Patches) -> FloatArray:
        """Give the grey of patches, shape (n,)."""
        return _columns(patches, self.power, self.phase_slope) @ self.factors

    def residuals(self, patches: Patches) -> FloatArray:
        """Give measured minus explained against the brightness, shape (n,)."""
        return (patches.grey - self.grey(patches)) / patches.brightness

    def rms(self, patches: Patches) -> float:
        """Give the root mean square of the residuals."""
        return float(np.sqrt(np.mean(self.residuals(patches) ** 2)))


def fit_mixture(
    patches: Patches, family: Family = "lunar_lambert", *, is_physical: bool = True
) -> Mixture:
    """Find the mixture with the least residuals.

    Args:
        patches: Patches.
        family: Which functions may be mixed.
        is_physical: Whether to leave out of a, b and c what would be negative. If not, estimates
            scatter about the truth even at the edge of what is possible: for their uncertainty.

    Raises:
        DegenerateGeometryError: The patches do not determine it.
    """
    which = list(FAMILIES[family])
    mixture = _fit(patches, which)
    while is_physical and mixture.factors.min() < 0:
        which.remove(int(mixture.factors.argmin()))
        mixture = _fit(patches, which)
    return mixture


def outliers(patches: Patches) -> NDArray[np.bool_]:
    """Tell which patches show something else than the paint in the light of the lamp, shape (n,).

    A shadow of the robot, a cable, a spot of dirt: what is left out may not decide what is.
    """
    is_good = np.ones(len(patches.grey), np.bool_)
    for _ in range(_ROUNDS):
        errors = fit_mixture(patches.only(is_good)).residuals(patches)
        was_good, is_good = is_good, np.abs(errors) <= _FOREIGN
        if (is_good == was_good).all():
            break
    return ~is_good


def _fit(patches: Patches, which: list[int]) -> Mixture:
    """Find some of the factors, power and phase slope by the method of Gauss and Newton."""
    power, slope = _START
    factors = np.zeros(3)
    for _ in range(_STEPS):
        columns = _columns(patches, power, slope)
        surface = columns[:, :2] @ factors[:2]
        grey = surface + columns[:, 2] * factors[2]
        jacobian = np.column_stack(
            [columns[:, which], grey * patches.log_cos_axis, -surface * patches.phase_rad]
        )
        step, *_ = np.linalg.lstsq(
            jacobian / patches.brightness[:, None],
            (patches.grey - grey) / patches.brightness,
            rcond=None,
        )
        factors[which] += step[:-2]
        power, slope = power + float(step[-2]), slope + float(step[-1])
        size = np.concatenate([np.abs(factors[which]), [abs(power) + 1.0, abs(slope) + 1.0]])
        if not np.isfinite(size).all() or size[-2:].max() > _ABSURD:
            break
        if (np.abs(step) <= _SMALLEST_STEP * size.max()).all():
            return Mixture(factors, power, slope)
    raise DegenerateGeometryError(
        "photometry: the patches do not determine how the paint reflects: too few angles, or images"
        " and renderings that do not belong together;\nlook at images and renderings: tronlab"
        " render; record shots from more directions: overhead and oblique, towards the lamp and"
        " away from it"
    )


def _columns(patches: Patches, power: float, slope: float) -> FloatArray:
    """Give what a, b and c are multiplied by, shape (n, 3)."""
    surface = np.exp(-slope * patches.phase_rad)
    by_phase = np.column_stack([surface, surface, np.ones_like(surface)])
    light = patches.gain * np.exp(power * patches.log_cos_axis)
    return patches.terms * by_phase * light[:, None]
