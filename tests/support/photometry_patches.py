"""Patches of a surface whose photometric function is known, seen and lit from all around."""

from collections.abc import Callable
from typing import Any

import numpy as np

from tronlab.calib.inputs import PatchesInput, PhotometryInput
from tronlab.render.photometry import LunarLambert, Photometry, reflected

POWER = 3.0


def make_patches(
    photometry: Photometry | None = None,
    *,
    seed: int = 0,
    n_images: int = 12,
    n_patches: int = 60,
    noise: float = 0.005,
    slope_per_rad: float = 0.0,
    ambient: float = 0.02,
    exposures_s: tuple[float, ...] = (0.02,),
    spread: float = 0.7,
    change: Callable[[dict[str, Any]], None] | None = None,
) -> PhotometryInput:
    """Give what a dataset would: grey by the law of the fit, with relative noise.

    Args:
        photometry: Of the surface.
        seed: Of the directions and the noise.
        n_images: Images.
        n_patches: Patches of each.
        noise: One sigma, relative.
        slope_per_rad: How the surface grows darker with the phase angle.
        ambient: Light from everywhere, against that of a surface facing lamp and camera.
        exposures_s: Of the images, over and over.
        spread: How much the surface is tilted.
        change: Changes the columns of an image.
    """
    rng = np.random.default_rng(seed)
    images: list[PatchesInput] = []
    for i in range(n_images):
        mu0, mu, phase_rad = _angles(rng, n_patches, spread)
        cos_axis = rng.uniform(0.75, 1.0, n_patches)
        seen = reflected(photometry or LunarLambert(weight=0.3), mu0, mu, phase_rad)
        exposure_s = exposures_s[i % len(exposures_s)]
        light = cos_axis**POWER * (np.exp(-slope_per_rad * phase_rad) * seen + ambient)
        grey = 0.6 * exposure_s / exposures_s[0] * light * (1 + noise * rng.normal(size=n_patches))
        columns: dict[str, Any] = {
            "grey": grey,
            "cos_axis": cos_axis,
            "lambert": mu0,
            "lommel_seeliger": 2 * mu0 / (mu0 + mu),
            "phase_deg": np.degrees(phase_rad),
        }
        if change is not None:
            change(columns)
        images.append(
            PatchesInput(
                shot_id=i,
                exposure_s=exposure_s,
                gain_db=0.0,
                **{name: tuple(column.tolist()) for name, column in columns.items()},
            )
        )
    return PhotometryInput(
        measured_utc="2026-01-02T03:04:05Z",
        dataset_name="patches",
        dataset_uuid="",
        patch_px=32,
        images=tuple(images),
    )


def _angles(
    rng: np.random.Generator, n: int, spread: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Give cosines of incidence and emission, and phase angles, of surfaces tilted at random."""
    up = np.array([0.0, 0.0, 1.0])
    to_lamp = _unit(np.array([-0.8, 0.1, 0.7]) + 0.2 * spread * rng.normal(size=(n, 3)))
    to_eye = _unit(up + 0.4 * spread * rng.normal(size=(n, 3)))
    normal = _unit(up + 0.4 * spread * rng.normal(size=(n, 3)))
    mu0, mu = (np.clip((v * normal).sum(axis=1), 0.05, 1.0) for v in (to_lamp, to_eye))
    return mu0, mu, np.arccos((to_lamp * to_eye).sum(axis=1))


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
