"""How much of the visible model the lamp lights, and how much of it the robot keeps in the dark."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.camera import CameraModel
from tronlab.planning.assessment import Finding
from tronlab.planning.barriers import are_barred
from tronlab.planning.collision import Solid
from tronlab.render.renderer import Lamp, Renderer

LIGHT_WIDTH_PX = 64
"""The light is sampled at so many places in a row of the image."""


@dataclass(frozen=True, slots=True)
class Light:
    """The light on what is in view at one pose; NaN if no terrain is."""

    lit_fraction: float
    """Part of the visible model that the lamp lights, terrain's and robot's shadow considered."""
    robot_shadow: float
    """Part of the visible model that would be lit if the robot were not there."""


def light_on_view(
    trs_from_cam: RigidTransform,
    *,
    renderer: Renderer,
    camera: CameraModel,
    lamp: Lamp,
    robot: Sequence[Solid],
) -> Light:
    """Predict the light by a small rendering, and by the ways from the lamp to what it shows.

    Args:
        trs_from_cam: Where the camera is.
        renderer: Renders the terrain.
        camera: Its intrinsics.
        lamp: The lamp; a ray from its centre says what the robot keeps in the dark.
        robot: The solids that may stand in the light.
    """
    coarse = camera.scaled(min(LIGHT_WIDTH_PX, camera.width_px))
    rendering = renderer.render(coarse, trs_from_cam, lamp)
    is_seen = np.isfinite(rendering.depth_m)
    n_seen = int(np.count_nonzero(is_seen))
    if n_seen == 0:
        return Light(lit_fraction=float("nan"), robot_shadow=float("nan"))
    lit_points = rendering.points_trs_m[is_seen & rendering.is_lit].astype(np.float64)
    n_barred = int(np.count_nonzero(are_barred(lamp.p_trs_m, lit_points, robot)))
    return Light(lit_fraction=(len(lit_points) - n_barred) / n_seen, robot_shadow=n_barred / n_seen)


def light_findings(
    light: Light, *, min_lit_fraction: float, max_robot_shadow: float
) -> list[Finding]:
    """Say what speaks against the light; without terrain in view there is nothing to say."""
    findings: list[Finding] = []
    if light.lit_fraction < min_lit_fraction:
        findings.append(
            Finding(
                "light",
                f"the lamp lights {100 * light.lit_fraction:.1f} % of the visible model, at least"
                f" {100 * min_lit_fraction:g} % is wanted",
            )
        )
    if light.robot_shadow > max_robot_shadow:
        findings.append(
            Finding(
                "light",
                f"the robot keeps the lamp from {100 * light.robot_shadow:.1f} % of the visible"
                f" model, allowed {100 * max_robot_shadow:g} %",
            )
        )
    return findings
