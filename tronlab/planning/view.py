"""What the camera will see of the model at a nominal pose: how far it is, how much of the image."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.camera import CameraModel
from tronlab.planning.assessment import Finding
from tronlab.planning.shots import RangeFinder, range_los_m
from tronlab.render.mask import model_mask
from tronlab.terrain.heightmap import HeightMap

MASK_WIDTH_PX = 512
"""Masks of more columns are predicted with so many: of 1024, the usable fraction keeps to 0.1 %."""


@dataclass(frozen=True, slots=True)
class View:
    """What is in view at one pose."""

    range_los_m: float
    """Distance to the ground along the optical axis; NaN if it never meets it."""
    usable_fraction: float
    """Part of the image that shows the model."""


def view_from(
    trs_from_cam: RigidTransform,
    *,
    heightmap: HeightMap,
    camera: CameraModel,
    range_finder: RangeFinder,
) -> View:
    """Predict what is in view, as it will be derived from the measured pose of a shot."""
    coarse = camera.scaled(min(MASK_WIDTH_PX, camera.width_px))
    return View(
        range_los_m=range_los_m(
            range_finder, trs_from_cam, ground_trs_m=heightmap.mean_height_trs_m
        ),
        usable_fraction=float(model_mask(heightmap, coarse, trs_from_cam).mean()),
    )


def view_findings(
    view: View, *, allowed_range_m: tuple[float, float], min_usable_fraction: float
) -> list[Finding]:
    """Say what speaks against a view."""
    findings: list[Finding] = []
    low, high = allowed_range_m
    if not np.isfinite(view.range_los_m):
        findings.append(
            Finding(
                "view",
                "the optical axis does not meet the ground, the plane of the terrain model; it must"
                " meet it, for errors are percent of that distance",
            )
        )
    elif not low <= view.range_los_m <= high:
        findings.append(
            Finding("range", f"range is {view.range_los_m:.3f} m, allowed {low:g} to {high:g} m")
        )
    if view.usable_fraction < min_usable_fraction:
        findings.append(
            Finding(
                "usable",
                f"the model fills {100 * view.usable_fraction:.1f} % of the image, at least"
                f" {100 * min_usable_fraction:g} % is wanted",
            )
        )
    return findings
