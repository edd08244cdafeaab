"""The robot's cell as a plan sees it: what can be hit, what can be seen, how long things take.

Nothing here is ground truth or takes part in calibration. Shapes are generous envelopes.
"""

from typing import Annotated

from pydantic import Field, model_validator

from tronlab.devices.laboratory import NotNegative, Positive, Vector
from tronlab.yaml_models import Model


class BoxSpec(Model):
    """A box along the axes of trs that the robot must keep out of."""

    low_trs_m: Vector
    high_trs_m: Vector

    @model_validator(mode="after")
    def _corners_are_ordered(self) -> "BoxSpec":
        for axis, low, high in zip("XYZ", self.low_trs_m, self.high_trs_m, strict=True):
            if low >= high:
                raise ValueError(
                    f"{axis} goes from {low:g} to {high:g} m, low_trs_m must be below high_trs_m"
                )
        return self


class EnvelopeSpec(Model):
    """What could hit what."""

    clearance_m: NotNegative = 0.05
    """How near the robot may come to floor, obstacles and terrain model. Its own bodies, which are
    generous, may come near each other, but not meet."""
    plate_m: tuple[Positive, Positive, Positive] = (0.20, 0.34, 0.20)
    """Size of plate, camera, lens and T-MAC together along x, y, z of the flange."""
    plate_centre_m: Vector = (0.0, 0.0, 0.08)
    """Where the middle of that is, frame flange."""
    floor_below_rail_m: NotNegative = 0.4
    """How far the floor is below the rail's frame, along -z of rail."""
    obstacles: Annotated[dict[str, BoxSpec], Field(default_factory=dict)]
    """Whatever else stands in the cell, by name."""


class SightSpec(Model):
    """What the tracker can see of the T-MAC; how far and how wide is a Leica T-MAC's by default."""

    tmac_half_angle_deg: Annotated[float, Field(gt=0, le=180)] = 45.0
    """The beam may come from so far off the direction in which the T-MAC looks."""
    tmac_axis: Vector | None = None
    """That direction, frame tmac, of any length; null: not known, so the angle is not checked."""
    range_m: tuple[Positive, Positive] = (1.5, 15.0)
    """Least and greatest distance of the T-MAC from the tracker."""
    beam_radius_m: NotNegative = 0.03
    """The line of sight must be free so far around."""

    @model_validator(mode="after")
    def _makes_sense(self) -> "SightSpec":
        if self.tmac_axis is not None and not any(self.tmac_axis):
            raise ValueError("tmac_axis: is zero, expected a direction")
        if self.range_m[0] >= self.range_m[1]:
            raise ValueError("range_m: the first value must be below the second")
        return self


class PaceSpec(Model):
    """How long the parts of a shot take beyond what the campaign says."""

    start_s: NotNegative = 0.0
    """Before the first move."""
    tracker_s: NotNegative = 0.0
    """Each measurement, beyond its window."""
    camera_s: NotNegative = 0.05
    """Each image, beyond its exposure."""
    read_s: NotNegative = 0.0
    """Reading robot and room."""
    write_s: NotNegative = 0.01
    """Deriving truth and mask, and writing them with the image."""


class CellSpec(Model):
    """Everything a plan needs beyond the laboratory as designed."""

    envelope: EnvelopeSpec = EnvelopeSpec.model_validate({})
    sight: SightSpec = SightSpec()
    pace: PaceSpec = PaceSpec()
