"""Options of the driver ``kuka.robot`` in a rig file."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from tronlab.devices.laboratory import Positive
from tronlab.kinematics.kr16 import KR16_LIMITS_RAD, Limits
from tronlab.yaml_models import Model

Port = Annotated[int, Field(ge=1, le=65535)]
NotNegative = Annotated[float, Field(ge=0)]
Percent = Annotated[int, Field(ge=1, le=100)]
Range = tuple[float, float]


class EkiOptions(Model):
    """KUKA.EthernetKRL: the controller is the server of two TCP channels."""

    kind: Literal["eki"]
    command_port: Port = 54600
    state_port: Port = 54601
    kvp_port: Port | None = None
    """Port of a KUKAVARPROXY or C3 Bridge beside it, which is asked for model and serial number:
    the two channels do not tell them. Without one, the model is the one the driver is made for."""


class KvpOptions(Model):
    """KUKAVARPROXY or C3 Bridge: variables are read and written by name."""

    kind: Literal["kvp"]
    port: Port = 7000


class AxisLimits(Model):
    """Range of each axis, degrees; within what the KR 16 itself can do."""

    a1: Range = (-185.0, 185.0)
    a2: Range = (-155.0, 35.0)
    a3: Range = (-130.0, 154.0)
    a4: Range = (-350.0, 350.0)
    a5: Range = (-130.0, 130.0)
    a6: Range = (-350.0, 350.0)

    @model_validator(mode="after")
    def _are_within_those_of_the_robot(self) -> "AxisLimits":
        for name, (low, high), allowed in zip(
            type(self).model_fields, self._ranges, np.degrees(KR16_LIMITS_RAD), strict=True
        ):
            least, most = allowed.round(9)
            if not least <= low < high <= most:
                raise ValueError(
                    f"{name}: [{low:g}, {high:g}] deg, allowed is a range within"
                    f" [{least:g}, {most:g}] deg"
                )
        return self

    @property
    def _ranges(self) -> tuple[Range, ...]:
        return self.a1, self.a2, self.a3, self.a4, self.a5, self.a6

    @property
    def limits_rad(self) -> Limits:
        """Get the lowest and highest angle of each axis, shape (6, 2), radians."""
        return np.radians(self._ranges)


class SettleOptions(Model):
    """When the robot counts as standing still at its target."""

    still_mm: Positive = 0.02
    """Flange and rail may differ so much between the last readings."""
    still_deg: Positive = 0.002
    """The flange may turn so much between the last readings."""
    n_readings: Annotated[int, Field(ge=2)] = 3
    """How many readings in a row must agree."""
    dwell_s: NotNegative = 0.2
    """Wait after they agreed; then they must agree still."""
    arrival_mm: Positive = 0.2
    """E1 may be so far from where it was sent."""
    arrival_deg: Positive = 0.02
    """Each axis of the arm may be so far from where it was sent."""


class PaceOptions(Model):
    """How fast the robot is taken to be where a plan estimates its time; it changes no motion.

    The controller does not tell its accelerations. These are the simulator's: compare the estimate
    with some moves of the real robot, and correct it here.
    """

    axis_ramp_s: Positive = 0.3
    """How long an axis takes to its full speed at an acceleration of 100 %."""
    rail_speed_m_per_s: Positive = 1.0
    """Highest speed of the rail."""
    rail_acceleration_m_per_s2: Positive = 0.5
    """Highest acceleration of the rail."""
    override_pct: Percent = 50
    """Where the program override at the pendant will stand."""
    command_s: NotNegative = 0.3
    """Of each motion, beyond moving and ``settle.dwell_s``: until the command is accepted, its end
    is seen, and enough readings agree."""


class KukaOptions(Model):
    """A KUKA KR 16 on a rail."""

    host: str
    """Name or address of the controller."""
    protocol: Annotated[EkiOptions | KvpOptions, Field(discriminator="kind")]
    timeout_s: Positive = 2.0
    """How long the controller may take to answer, to tell its state, and to accept a command."""
    rail_range_m: Range
    """Lowest and highest position the rail may take. A target must lie ``rail_approach_m`` above
    the lowest."""
    rail_zero_mm: float = 0.0
    """What the controller counts on E1 where ``rail_m`` is 0."""
    rail_sign: Literal[1, -1] = 1
    """-1 if E1 counts down where ``rail_m`` counts up."""
    rail_approach_m: NotNegative = 0.02
    """The rail comes to every target from below, at least from so far: always to the same flank of
    its rack. 0 lets it come from either side."""
    axis_limits_deg: AxisLimits = AxisLimits()
    """Narrower limits of the axes than the robot's own, for example to keep it from the walls or
    from turning its cables over."""
    velocity_pct: Percent = 20
    """Of the highest speed of every axis."""
    acceleration_pct: Percent = 50
    max_override_pct: Percent = 50
    """No move is begun while the controller's program override is above; it is never changed."""
    operating_modes: tuple[Literal["T1", "T2", "AUT", "EXT"], ...] = ("AUT", "EXT")
    """Modes in which moves are begun. T1 is for first trials, with a person at the pendant."""
    settle: SettleOptions = SettleOptions()
    pace: PaceOptions = PaceOptions()

    @model_validator(mode="after")
    def _rail_has_room_to_approach(self) -> "KukaOptions":
        low, high = self.rail_range_m
        if high - low <= self.rail_approach_m:
            raise ValueError(
                f"rail_range_m: [{low:g}, {high:g}] m, allowed is an ordered range longer than"
                f" rail_approach_m ({self.rail_approach_m:g} m)"
            )
        return self
