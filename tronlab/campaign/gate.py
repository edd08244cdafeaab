"""The quality gate: measures how good a shot is, and says what speaks against it."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.campaign.config import GateConfig
from tronlab.campaign.image_quality import FULL_SCALE, measure_exposure, measure_sharpness
from tronlab.campaign.settling import Motion
from tronlab.dataset.records import QualityFlag, ShotQuality, Truth
from tronlab.devices.readings import Frame, PoseReading, RoomReading
from tronlab.geometry.poses import FloatArray, rotation_angle_rad

MIN_SHOTS_BEFORE = 5
"""Until so many good shots were taken there is nothing to compare with: values are only stored."""
_N_NEAREST = 9
_N_REMEMBERED = 1000


@dataclass(frozen=True, slots=True)
class Evidence:
    """What a shot is judged by."""

    frame: Frame
    mask: NDArray[np.bool_]
    """Where the model is by the measured pose, shape (rows, columns)."""
    truth: Truth
    trs_from_cam_nominal: RigidTransform
    """Where the robot was to put the camera."""
    tracker: PoseReading
    room: RoomReading
    settled: Motion
    """Between two looks before the measurement."""
    confirmed: Motion
    """During the exposure."""
    predicted_radiance: float | None
    """Mean over the model; None if none was predicted."""


@dataclass(frozen=True, slots=True)
class Judgement:
    """What the gate says of a shot."""

    quality: ShotQuality
    objections: Mapping[QualityFlag, str]
    """By flag, what was found and what is allowed."""
    wants_retake: bool
    """Whether one of them is worth another try."""
    range_los_m: float
    air_temperature_k: float

    @property
    def text(self) -> str:
        """Get all objections in one line."""
        return "; ".join(f"{flag}: {text}" for flag, text in self.objections.items())


class Gate:
    """Judges shots, and remembers the good ones to compare with."""

    def __init__(self, config: GateConfig) -> None:
        self._config = config
        self._sharpness: deque[tuple[float, float]] = deque(maxlen=_N_REMEMBERED)
        """Range and sharpness of shots that were not called blurred, the last one first."""
        self._brightness: deque[float] = deque(maxlen=_N_REMEMBERED)
        self._first_temperature_k: float | None = None

    def judge(self, evidence: Evidence) -> Judgement:
        """Measure a shot and hold it against the limits; the gate remembers nothing of it."""
        found = measure_quality(evidence)
        objections: dict[QualityFlag, str] = {
            flag: text
            for flag, text in self._objections(found, evidence).items()
            if text and getattr(self._config, flag) != "off"
        }
        return Judgement(
            quality=replace(found, flags=tuple(objections)),
            objections=objections,
            wants_retake=any(getattr(self._config, flag) == "retake" for flag in objections),
            range_los_m=evidence.truth.range_los_m,
            air_temperature_k=evidence.room.air_temperature_k,
        )

    def accept(self, judgement: Judgement) -> None:
        """Remember a shot that is kept, so that later ones are compared with it."""
        if self._first_temperature_k is None:
            self._first_temperature_k = judgement.air_temperature_k
        self.learn(judgement.quality, range_los_m=judgement.range_los_m)

    def learn(self, quality: ShotQuality, *, range_los_m: float) -> None:
        """Remember a shot of an earlier session; what was held against it sets no standard."""
        if "blur" not in quality.flags and quality.sharpness > 0 and range_los_m > 0:
            self._sharpness.appendleft((range_los_m, quality.sharpness))
        if "brightness" not in quality.flags and quality.brightness is not None:
            self._brightness.append(quality.brightness)

    def renew_light(self) -> None:
        """Forget how bright the shots were: from now on the lamp counts as right as it is."""
        self._brightness.clear()

    def _objections(
        self, found: ShotQuality, evidence: Evidence
    ) -> Mapping[QualityFlag, str | None]:
        """Give what speaks against a shot, by flag and in the flags' order; None: nothing."""
        return {
            "saturation": self._saturation(found),
            "contrast": self._contrast(found),
            "blur": self._blur(found, evidence.truth.range_los_m),
            "target": self._target(evidence.truth),
            "tracker": self._tracker(found),
            "robot": self._robot(found),
            "temperature": self._temperature(evidence.room.air_temperature_k),
            "brightness": self._light(found),
        }

    def _saturation(self, found: ShotQuality) -> str | None:
        allowed = self._config.max_saturated_fraction
        if found.saturated_fraction <= allowed:
            return None
        return (
            f"{found.saturated_fraction:.1%} of the model is at full scale, allowed {allowed:.1%}"
        )

    def _contrast(self, found: ShotQuality) -> str | None:
        needed = self._config.min_contrast
        if found.contrast >= needed:
            return None
        return f"contrast is {found.contrast:.3f}, needed {needed:g}"

    def _blur(self, found: ShotQuality, range_los_m: float) -> str | None:
        usual = self._usual_sharpness(range_los_m)
        if usual is None or found.sharpness >= self._config.min_sharpness * usual:
            return None
        return (
            f"sharpness is {found.sharpness / usual:.2f} of that of the shots before,"
            f" needed {self._config.min_sharpness:g}"
        )

    def _target(self, truth: Truth) -> str | None:
        needed = self._config.min_usable_fraction
        if not np.isfinite(truth.range_los_m):
            return "the camera looks past the model"
        if truth.usable_fraction >= needed:
            return None
        return f"{truth.usable_fraction:.1%} of the image shows the model, needed {needed:.1%}"

    def _tracker(self, found: ShotQuality) -> str | None:
        allowed_m = self._config.max_tracker_sigma_m
        if found.tracker_sigma_m <= allowed_m:
            return None
        return (
            f"the T-MAC scatters by {found.tracker_sigma_m * 1e3:.3f} mm,"
            f" allowed {allowed_m * 1e3:g} mm"
        )

    def _robot(self, found: ShotQuality) -> str | None:
        shift_m, turn_deg = self._config.max_robot_shift_m, self._config.max_robot_turn_deg
        found_deg = np.degrees(found.robot_turn_rad)
        if found.robot_shift_m <= shift_m and found_deg <= turn_deg:
            return None
        return (
            f"the camera is {found.robot_shift_m * 1e3:.1f} mm and {found_deg:.2f} deg from where"
            f" the robot was to put it, allowed {shift_m * 1e3:g} mm and {turn_deg:g} deg"
        )

    def _temperature(self, air_temperature_k: float) -> str | None:
        if self._first_temperature_k is None:
            return None
        change_k = air_temperature_k - self._first_temperature_k
        allowed_k = self._config.max_temperature_change_k
        if abs(change_k) <= allowed_k:
            return None
        return f"the air changed by {change_k:+.1f} K since the first shot, allowed {allowed_k:g} K"

    def _light(self, found: ShotQuality) -> str | None:
        if found.brightness is None or len(self._brightness) < MIN_SHOTS_BEFORE:
            return None
        change = found.brightness / float(np.median(self._brightness)) - 1.0
        allowed = self._config.max_brightness_change
        if abs(change) <= allowed:
            return None
        return f"the light changed by {change:+.0%} against the shots before, allowed {allowed:.0%}"

    def _usual_sharpness(self, range_los_m: float) -> float | None:
        """Give the median of the good shots whose range is nearest, the latest of equal ones.

        Terrain is finer from afar, and sharper for the same lens.
        """
        if len(self._sharpness) < MIN_SHOTS_BEFORE or np.isnan(range_los_m):
            return None
        ranges_m, sharpness = np.array(self._sharpness).T
        distances = np.abs(np.log(ranges_m / range_los_m))
        nearest = np.argsort(distances, kind="stable")[:_N_NEAREST]
        return float(np.median(sharpness[nearest]))


def measure_quality(evidence: Evidence) -> ShotQuality:
    """Measure how good a shot is, without judging it."""
    frame, truth = evidence.frame, evidence.truth
    exposure = measure_exposure(
        frame.image, evidence.mask, full_scale=FULL_SCALE[frame.pixel_format]
    )
    nominal_from_cam = evidence.trs_from_cam_nominal.inv() * truth.trs_from_cam
    return ShotQuality(
        settle_shift_m=evidence.settled.shift_m,
        settle_turn_rad=evidence.settled.turn_rad,
        exposure_shift_m=evidence.confirmed.shift_m,
        exposure_turn_rad=evidence.confirmed.turn_rad,
        tracker_sigma_m=largest_sigma(evidence.tracker.covariance[3:, 3:]),
        robot_shift_m=float(np.linalg.norm(nominal_from_cam.translation)),
        robot_turn_rad=rotation_angle_rad(evidence.trs_from_cam_nominal, truth.trs_from_cam),
        saturated_fraction=exposure.saturated_fraction,
        contrast=exposure.contrast,
        sharpness=measure_sharpness(frame.image, evidence.mask),
        brightness=relative_brightness(exposure.mean_grey, frame, evidence.predicted_radiance),
    )


def largest_sigma(covariance: FloatArray) -> float:
    """Give the standard deviation along the axis where it is largest, of (3, 3)."""
    return float(np.sqrt(max(0.0, np.linalg.eigvalsh(covariance)[-1])))


def relative_brightness(
    mean_grey: float, frame: Frame, predicted_radiance: float | None
) -> float | None:
    """Give grey values per second of exposure, at no gain, over the radiance predicted.

    It stays the same as long as lamp and lens do. The camera's black level is not known and not
    taken off.
    """
    if predicted_radiance is None:
        return None
    gain = 10.0 ** (frame.gain_db / 20.0)
    return mean_grey / (frame.exposure_s * gain * predicted_radiance)
