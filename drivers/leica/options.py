"""What a rig file says about a Leica tracker."""

from typing import Annotated, Literal

from pydantic import Field

from tronlab.devices.accuracy import StatedAccuracy
from tronlab.devices.laboratory import Vector
from tronlab.yaml_models import Model

EMSCON_PORT = 700

Positive = Annotated[float, Field(gt=0)]
Seconds = Annotated[float, Field(gt=0, le=600)]


class ReflectorOption(Model):
    """A reflector that campaigns and calibrations measure by name."""

    p_trk_m: Vector
    """Where its centre is, frame trk; as exact as ``search_radius_m``."""
    type: str
    """Name of the kind of reflector in the tracker's own list, such as ``CCR-1.5in``: it decides
    the constant that the distance meter adds, so a wrong one gives wrong distances."""
    search_radius_m: Positive = 0.05
    """How far from ``p_trk_m`` the tracker searches, and how far off a reading may lie."""


class TmacOption(Model):
    """The T-MAC on the robot."""

    p_trk_m: Vector
    """Where it is when the beam first finds it, frame trk: with the robot at home."""
    search_radius_m: Positive = 0.3
    """How far from there, or from where it was last measured, the tracker searches."""


class AirOption(Model):
    """The air, where no weather station measures it."""

    temperature_k: Annotated[float, Field(ge=250, le=330)]
    pressure_pa: Annotated[float, Field(ge=50_000, le=110_000)]
    relative_humidity: Annotated[float, Field(ge=0, le=1)]


class TrackerOptions(Model):
    """Section ``options`` of a tracker with driver ``leica.tracker``."""

    host: str
    """Address of the tracker controller; 192.168.0.1 as delivered."""
    port: Annotated[int, Field(ge=1, le=65535)] = EMSCON_PORT
    reflectors: dict[str, ReflectorOption]
    """Every reflector by the name that calibrations use: top_left, bottom_left, top_right, lamp."""
    tmac: TmacOption
    accuracy: StatedAccuracy = StatedAccuracy()
    """Of this tracker by its data sheet or certificate, as one sigma. The tracker itself reports
    only how far measurements scatter within a reading; both make the covariance of a reading."""
    air: AirOption | None = None
    """Air to correct distances for; left out, the tracker's own weather station measures it."""
    initialize: Literal["auto", "never"] = "auto"
    """Whether the first measurement initialises a tracker that is not: the head moves by itself."""
    timeout_s: Seconds = 10.0
    """For an answer to a plain command, and for a result after its window."""
    lock_timeout_s: Seconds = 3.0
    """For the beam to lock once the head stands."""
    move_timeout_s: Seconds = 30.0
    """For commands that move the head, and for a search."""
    initialize_timeout_s: Seconds = 90.0
