"""Whether the tracker will see the T-MAC: distance, angle, and a free line of sight."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.devices.cell import SightSpec
from tronlab.geometry.poses import FloatArray, unit
from tronlab.planning.assessment import Finding
from tronlab.planning.barriers import meet
from tronlab.planning.collision import Solid
from tronlab.planning.shots import RangeFinder


@dataclass(frozen=True, slots=True)
class Sight:
    """How the tracker sees the T-MAC at one pose."""

    distance_m: float
    """From the tracker."""
    angle_rad: float
    """Between the T-MAC's axis and the beam; NaN if the rig file does not name the axis."""


def sight_of(p_trk_trs_m: FloatArray, trs_from_tmac: RigidTransform, spec: SightSpec) -> Sight:
    """Give distance and angle of the T-MAC as the tracker, at ``p_trk_trs_m``, sees it."""
    beam = p_trk_trs_m - trs_from_tmac.translation
    if spec.tmac_axis is None:
        angle_rad = float("nan")
    else:
        axis_trs = trs_from_tmac.rotation.apply(unit(spec.tmac_axis))
        angle_rad = float(np.arctan2(np.linalg.norm(np.cross(axis_trs, beam)), axis_trs @ beam))
    return Sight(distance_m=float(np.linalg.norm(beam)), angle_rad=angle_rad)


def sight_findings(sight: Sight, spec: SightSpec) -> list[Finding]:
    """Say what speaks against distance and angle."""
    findings: list[Finding] = []
    low, high = spec.range_m
    if not low <= sight.distance_m <= high:
        findings.append(
            Finding(
                "sight",
                f"the T-MAC is {sight.distance_m:.2f} m from the tracker, allowed {low:g} to"
                f" {high:g} m",
            )
        )
    if sight.angle_rad > np.radians(spec.tmac_half_angle_deg):
        findings.append(
            Finding(
                "sight",
                f"the beam comes {np.degrees(sight.angle_rad):.1f} deg off the T-MAC's axis,"
                f" allowed {spec.tmac_half_angle_deg:g} deg",
            )
        )
    return findings


def terrain_in_beam(
    p_trk_trs_m: FloatArray,
    p_tmac_trs_m: FloatArray,
    *,
    beam_radius_m: float,
    range_finder: RangeFinder,
) -> bool:
    """Tell whether the model stands between T-MAC and tracker: along the beam and on four sides."""
    beam = p_trk_trs_m - p_tmac_trs_m
    length_m = float(np.linalg.norm(beam))
    sideways = np.linalg.svd(beam[None])[2][1:]
    offsets = beam_radius_m * np.vstack([np.zeros((1, 3)), sideways, -sideways])
    hits = [range_finder.range_along_m(p_tmac_trs_m + offset, beam) for offset in offsets]
    return any(hit < length_m for hit in hits)  # NaN, a miss, is not


def bar_in_beam(
    p_trk_trs_m: FloatArray,
    p_tmac_trs_m: FloatArray,
    solids: Sequence[Solid],
    *,
    beam_radius_m: float,
) -> str:
    """Name the solid that bars the beam; empty if none does.

    What holds the T-MAC within its envelope, as the plate does, is left out: whether it is in the
    way is a matter of the angle.
    """
    beam = p_tmac_trs_m, p_trk_trs_m[np.newaxis]
    at_tmac = p_tmac_trs_m, p_tmac_trs_m[np.newaxis]
    for solid in solids:
        holds_tmac = meet(*at_tmac, solid, margin_m=beam_radius_m)[0]
        if not holds_tmac and meet(*beam, solid, margin_m=beam_radius_m)[0]:
            return solid.name
    return ""
