"""From patches of images to the photometric function of the paint, and how sure that is."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tronlab.calib.inputs import PhotometryInput
from tronlab.calib.photometry.regression import (
    FAMILIES,
    Family,
    Mixture,
    Patches,
    fit_mixture,
    outliers,
)
from tronlab.calib.results import PhotometryResult
from tronlab.errors import CalibrationError, DegenerateGeometryError
from tronlab.render.photometry import Lambert, LommelSeeliger, LunarLambert, Photometry

LEAST_IMAGES = 6
LEAST_PATCHES = 200
_MOST_GROUPS = 12
MOST_SIGMA = 0.1
"""Of the share of Lommel-Seeliger: less sure than this it is hardly better than a guess."""
MOST_RMS = 0.05
"""Relative residual beyond which it is not the paint that does not fit."""
GOOD_RMS = 0.02
"""Relative residual beyond which a warning is due."""
_MOST_OUTLIERS = 0.1


@dataclass(frozen=True, slots=True)
class Fits:
    """What each family of functions makes of the same patches."""

    patches: Patches
    """Without outliers."""
    n_outliers: int
    mixtures: Mapping[Family, Mixture]


def fit_families(measured: PhotometryInput) -> Fits:
    """Fit Lambert, Lommel-Seeliger and their mixture to what was recorded.

    Raises:
        DegenerateGeometryError: Too few images or patches, or too few angles, to tell.
        CalibrationError: The lamp lights nothing.
    """
    patches = _patches(measured)
    is_outlier = outliers(patches)
    good = patches.only(~is_outlier)
    return Fits(
        patches=good,
        n_outliers=int(is_outlier.sum()),
        mixtures={family: fit_mixture(good, family) for family in FAMILIES},
    )


def solve_photometry(measured: PhotometryInput) -> PhotometryResult:
    """Find the lunar-Lambert function that explains what was recorded best.

    A pure function is called by its name; it is the same as a share of exactly 0 or 1. The standard
    deviation is a jackknife's (Efron and Stein, Annals of Statistics 9 (1981), 586) over groups of
    successive images: errors of neighbouring patches, and of images of the same ground, are alike.

    Raises:
        DegenerateGeometryError: Too few images or patches, or too few angles, to tell.
        CalibrationError: The images show something else than the renderings.
    """
    fits = fit_families(measured)
    patches, best = fits.patches, fits.mixtures["lunar_lambert"]
    _check_residual(best, fits, measured)
    weight_sigma, power_sigma, slope_sigma = _jackknife(patches)
    _check_sigma(weight_sigma, patches)
    return PhotometryResult(
        photometry=_function(best.weight),
        weight_sigma=weight_sigma,
        statistics={
            "n_images": len(measured.images),
            "n_patches": len(patches.grey),
            "n_outliers": fits.n_outliers,
            "rms_relative": {name: fit.rms(patches) for name, fit in fits.mixtures.items()},
            "phase_slope_per_rad": best.phase_slope,
            "phase_slope_per_rad_sigma": slope_sigma,
            "vignetting_power": best.power,
            "vignetting_power_sigma": power_sigma,
            "ambient_share": float(best.ambient.grey(patches).sum() / best.grey(patches).sum()),
            "phase_range_deg": np.degrees(
                [patches.phase_rad.min(), patches.phase_rad.max()]
            ).tolist(),
            "warnings": _warnings(fits),
        },
    )


def _patches(measured: PhotometryInput) -> Patches:
    """Join the patches, if there are enough of them.

    Raises:
        DegenerateGeometryError: There are not.
    """
    n_patches = sum(len(image.grey) for image in measured.images)
    if len(measured.images) < LEAST_IMAGES or n_patches < LEAST_PATCHES:
        raise DegenerateGeometryError(
            f"photometry: {len(measured.images)} images of '{measured.dataset_name}' show the model"
            f" in {n_patches} patches; needed are {LEAST_IMAGES} images and {LEAST_PATCHES} patches"
            " that lie wholly on the model and are not saturated;\nrecord more shots, nearer to the"
            " model, or with a shorter exposure"
        )
    if not any(value > 0 for image in measured.images for value in image.lambert):
        raise CalibrationError(
            f"photometry: the lamp lights nothing that the images of '{measured.dataset_name}'"
            " show; check the lamp of the calibration record, and the terrain of the rig file"
        )
    return Patches.of(measured.images)


def _check_residual(best: Mixture, fits: Fits, measured: PhotometryInput) -> None:
    rms = best.rms(fits.patches)
    if rms > MOST_RMS or not best.factors[:2].any():
        raise CalibrationError(
            f"photometry: images of '{measured.dataset_name}' and renderings differ by {rms:.0%} of"
            f" the grey, at most {MOST_RMS:.0%} can be the paint: lamp, terrain, poses or exposures"
            " are not as recorded;\nlook at images and renderings: tronlab render, and measure anew"
            " what is off: tronlab calibrate lamp, or frame"
        )


def _check_sigma(weight_sigma: float, patches: Patches) -> None:
    if not weight_sigma <= MOST_SIGMA:
        low, high = np.degrees([patches.phase_rad.min(), patches.phase_rad.max()])
        raise DegenerateGeometryError(
            f"photometry: the share of Lommel-Seeliger is known to {weight_sigma:.2g} only, at most"
            f" {MOST_SIGMA:g} is allowed: the images show the ground under phase angles of"
            f" {low:.0f} to {high:.0f} deg;\nrecord shots from more directions: overhead and"
            " oblique, towards the lamp and away from it"
        )


def _jackknife(patches: Patches) -> tuple[float, float, float]:
    """Give one sigma of weight, power and phase slope."""
    n_images = int(patches.image.max()) + 1
    n_groups = min(n_images, _MOST_GROUPS)
    group = patches.image * n_groups // n_images
    fits = [fit_mixture(patches.only(group != i), is_physical=False) for i in range(n_groups)]
    values = np.array([(fit.weight, fit.power, fit.phase_slope) for fit in fits])
    weight, power, slope = np.sqrt((n_groups - 1) * values.var(axis=0)).tolist()
    return weight, power, slope


def _function(weight: float) -> Photometry:
    if weight == 0.0:
        return Lambert()
    return LommelSeeliger() if weight == 1.0 else LunarLambert(weight=weight)


def _warnings(fits: Fits) -> list[str]:
    warnings: list[str] = []
    rms = fits.mixtures["lunar_lambert"].rms(fits.patches)
    if rms > GOOD_RMS:
        warnings.append(
            f"photometry: {rms:.1%} of the grey is not explained: the paint is not of this kind, or"
            " lamp, terrain or poses are a little off"
        )
    outlier_share = fits.n_outliers / (fits.n_outliers + len(fits.patches.grey))
    if outlier_share > _MOST_OUTLIERS:
        warnings.append(
            f"photometry: {outlier_share:.0%} of the patches were left out: something shades the"
            " model, or stands before it"
        )
    return warnings
