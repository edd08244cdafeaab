"""Features of a camera by what they mean: makers and years give one feature several names.

Names are those of the Standard Features Naming Convention (SFNC) of EMVA, newest first; those
after it are of older cameras such as Allied Vision's Prosilica GC.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

from genicam import genapi

from tronlab.errors import LimitError

Setting: TypeAlias = str | int | float | bool

NAMES: Final[Mapping[str, tuple[str, ...]]] = {
    "exposure": ("ExposureTime", "ExposureTimeAbs"),
    "gain": ("Gain", "GainRaw"),
    "frame rate": ("AcquisitionFrameRate", "AcquisitionFrameRateAbs"),
    "maker": ("DeviceVendorName",),
    "model": ("DeviceModelName",),
    "serial number": ("DeviceSerialNumber", "DeviceID"),
    "firmware": ("DeviceFirmwareVersion", "DeviceVersion"),
    "pixel format": ("PixelFormat",),
    "left column": ("OffsetX",),
    "top row": ("OffsetY",),
    "width": ("Width",),
    "height": ("Height",),
    "packet size": ("GevSCPSPacketSize",),
    "trigger selector": ("TriggerSelector",),
    "trigger source": ("TriggerSource",),
    "trigger mode": ("TriggerMode",),
    "software trigger": ("TriggerSoftware",),
    "clock latch": ("TimestampLatch", "GevTimestampControlLatch"),
    "clock frequency": ("GevTimestampTickFrequency",),
    "latched clock": ("TimestampLatchValue", "GevTimestampValue"),
}
"""Names a feature may have, the newest first."""

NEUTRAL: Final[Mapping[str, Setting]] = {
    "ChunkModeActive": False,
    "AcquisitionMode": "Continuous",
    "TriggerDelay": 0.0,
    "TriggerDelayAbs": 0.0,
    "ExposureMode": "Timed",
    "ExposureAuto": "Off",
    "GainAuto": "Off",
    "BalanceWhiteAuto": "Off",
    "GammaEnable": False,
    "Gamma": 1.0,
    "BinningHorizontal": 1,
    "BinningVertical": 1,
    "DecimationHorizontal": 1,
    "DecimationVertical": 1,
    "ReverseX": False,
    "ReverseY": False,
}
"""What else would change an image, as set whenever a camera is opened that has it."""

_READABLE: Final = (genapi.EAccessMode.RO, genapi.EAccessMode.RW)
_WRITABLE: Final = (genapi.EAccessMode.WO, genapi.EAccessMode.RW)
_ROUNDING: Final = 0.01


@dataclass(frozen=True, slots=True)
class Quantity:
    """How a number is spoken of, and how many of the feature's units make one of these."""

    name: str
    unit: str
    per_unit: float = 1.0

    def say(self, value: float) -> str:
        """Give a value of the feature with its unit."""
        return f"{value / self.per_unit:g} {self.unit}"


EXPOSURE: Final = Quantity("exposure", "s", per_unit=1e6)
GAIN: Final = Quantity("gain", "dB")
FRAME_RATE: Final = Quantity("frame rate", "Hz")
LEFT: Final = Quantity("left column", "px")
TOP: Final = Quantity("top row", "px")
WIDTH: Final = Quantity("width", "px")
HEIGHT: Final = Quantity("height", "px")
PACKET_SIZE: Final = Quantity("packet size", "bytes")


class Features:
    """Reads and sets the features of one camera; what it cannot do is a ``LimitError``."""

    def __init__(self, node_map: Any, *, device: str) -> None:
        self._node_map = node_map
        self._device = device

    def has(self, feature: str) -> bool:
        """Return whether the camera has a feature, now."""
        return self._find(feature) is not None

    def text(self, feature: str) -> str:
        """Read a text; empty if the camera has none of that feature."""
        node = self._find(feature)
        if node is None or node.get_access_mode() not in _READABLE:
            return ""
        return str(node.to_string()).strip()

    def number(self, quantity: Quantity, *, call: str) -> float:
        """Read a number, in the unit spoken of."""
        node = self._get(quantity.name, call=call)
        return float(node.get_value(False, True)) / quantity.per_unit

    def integer(self, feature: str, *, call: str) -> int:
        """Read a whole number as the camera gives it."""
        return int(self._get(feature, call=call).get_value(False, True))

    def largest(self, quantity: Quantity, *, call: str) -> float:
        """Give the largest number the camera can take now, in the unit spoken of."""
        return float(self._get(quantity.name, call=call).max) / quantity.per_unit

    def check_number(self, quantity: Quantity, value: float, *, call: str) -> None:
        """Return if the camera can take that number.

        Raises:
            LimitError: It is out of range, or between the steps of a feature of whole numbers.
        """
        node = self._get(quantity.name, call=call)
        wanted = value * quantity.per_unit
        # A hair of rounding may carry a limit across itself when it changes its unit.
        hair = 1e-9 * max(abs(node.min), abs(node.max))
        is_in_range = node.min - hair <= wanted <= node.max + hair
        if not is_in_range or (isinstance(node, genapi.IInteger) and not _is_on_step(node, wanted)):
            raise self._refusal(quantity, value, node, call=call)

    def set_number(self, quantity: Quantity, value: float, *, call: str) -> None:
        """Set a number.

        Raises:
            LimitError: As ``check_number``, or the camera took another number, further away than
                the step it declares (if it declares none, than 1 %).
        """
        self.check_number(quantity, value, call=call)
        node = self._get(quantity.name, call=call)
        wanted = value * quantity.per_unit
        if isinstance(node, genapi.IInteger):
            node.value = round(wanted)
        else:
            node.value = min(max(wanted, node.min), node.max)
        taken = node.get_value(False, True)
        if abs(taken - wanted) > _tolerance(node, wanted):
            raise LimitError(
                f"{self._refusal(quantity, value, node, call=call).args[0]}; "
                f"the camera made {quantity.say(taken)} of it",
                device=self._device,
            )

    def check_choice(self, feature: str, choice: str, *, call: str) -> None:
        """Return if the camera offers that choice.

        Raises:
            LimitError: It does not; the message says what it offers.
        """
        choices = self.choices(feature, call=call)
        if choice not in choices:
            raise LimitError(
                f"{call}: {feature} is '{choice}', allowed {', '.join(choices) or 'nothing'}",
                device=self._device,
            )

    def choices(self, feature: str, *, call: str) -> Sequence[str]:
        """Give what can be chosen now."""
        node = self._get(feature, call=call)
        return tuple(entry.symbolic for entry in node.entries if _is_available(entry))

    def choose(self, feature: str, choice: str, *, call: str) -> None:
        """Make a choice.

        Raises:
            LimitError: The camera does not offer it, or took another one.
        """
        self.check_choice(feature, choice, call=call)
        node = self._get(feature, call=call)
        node.value = choice
        taken = node.get_value(False, True)
        if taken != choice:
            raise LimitError(
                f"{call}: {feature} is '{choice}', but the camera stays at '{taken}'",
                device=self._device,
            )

    def execute(self, feature: str, *, call: str) -> None:
        """Give a command."""
        self._get(feature, call=call).execute()

    def enable_frame_rate(self) -> None:
        """Let the frame rate be set, where a camera must be told so."""
        node = self._find("AcquisitionFrameRateEnable")
        if node is not None and node.get_access_mode() in _WRITABLE:
            node.value = True

    def neutralise(self) -> None:
        """Set all of ``NEUTRAL`` that this camera has and lets be set that way."""
        for name, value in NEUTRAL.items():
            node = self._find(name)
            if node is None or node.get_access_mode() not in _WRITABLE:
                continue
            if isinstance(node, genapi.IEnumeration) and value not in node.symbolics:
                continue
            if node.value != value:
                node.value = value

    def _find(self, feature: str) -> Any | None:
        for name in NAMES.get(feature, (feature,)):
            if self._node_map.has_node(name):
                node = self._node_map.get_node(name)
                if _is_available(node):
                    return node
        return None

    def _get(self, feature: str, *, call: str) -> Any:
        node = self._find(feature)
        if node is None:
            names = " or ".join(NAMES.get(feature, (feature,)))
            raise LimitError(
                f"{call}: this camera has no {feature} ({names}); use another camera",
                device=self._device,
            )
        return node

    def _refusal(self, quantity: Quantity, value: float, node: Any, *, call: str) -> LimitError:
        low, high = quantity.say(node.min), quantity.say(node.max)
        step = _declared_step(node)
        steps = "" if step is None or step == 0 else f" in steps of {quantity.say(step)}"
        return LimitError(
            f"{call}: {quantity.name} is {value:g} {quantity.unit}, allowed {low} to {high}{steps}",
            device=self._device,
        )


def _is_available(node: Any) -> bool:
    return node.get_access_mode() in (*_READABLE, *_WRITABLE)


def _declared_step(node: Any) -> float | None:
    if isinstance(node, genapi.IInteger):
        return float(node.inc)
    return float(node.inc) if node.has_inc() else None


def _is_on_step(node: Any, wanted: float) -> bool:
    steps = (wanted - node.min) / node.inc
    return math.isclose(steps, round(steps), abs_tol=1e-6)


def _tolerance(node: Any, wanted: float) -> float:
    if isinstance(node, genapi.IInteger):
        return 0.5
    step = _declared_step(node)
    return _ROUNDING * abs(wanted) if step is None else step
