import re
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.campaign.config import GateConfig
from tronlab.campaign.gate import (
    MIN_SHOTS_BEFORE,
    Evidence,
    Gate,
    Judgement,
    largest_sigma,
    relative_brightness,
)
from tronlab.campaign.settling import Motion
from tronlab.dataset.records import Truth
from tronlab.devices.readings import Frame, PoseReading, RoomReading

SHAPE = (192, 256)
STILL = Motion(1e-5, 1e-5)
NOMINAL = RigidTransform.from_components([1.0, 2.0, 3.0], Rotation.from_rotvec([3.0, 0.1, 0.2]))


@cache
def terrain(seed: int = 0, *, blur_px: float = 0.7) -> np.ndarray:
    """Grey values about 100 of 255 before noise; another seed is other terrain."""
    noise = np.random.default_rng(seed).standard_normal(SHAPE)
    structure = gaussian_filter(noise, 0.8) + 20 * gaussian_filter(noise, 6.0)
    return gaussian_filter(100 + 25 * structure / structure.std(), blur_px)


def exposed(image: np.ndarray, *, seed: int) -> np.ndarray:
    noise = np.random.default_rng([9, seed]).normal(0.0, 0.15 * np.sqrt(np.maximum(image, 0)))
    return np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)


def evidence(seed: int = 0, *, image: np.ndarray | None = None, **changes: Any) -> Evidence:
    """A shot without fault, but for the changes."""
    truth = Truth(NOMINAL, 1e-10 * np.eye(6), range_los_m=2.0, usable_fraction=1.0)
    good = Evidence(
        frame=Frame(
            exposed(terrain(seed) if image is None else image, seed=seed),
            "Mono8",
            0.02,
            0.0,
            1,
            0.0,
        ),
        mask=np.ones(SHAPE, dtype=np.bool_),
        truth=truth,
        trs_from_cam_nominal=NOMINAL,
        tracker=PoseReading(RigidTransform.identity(), 1e-10 * np.eye(6), 0.0),
        room=RoomReading(293.0, 1e5, 0.4, True, True, 0.0),
        settled=STILL,
        confirmed=STILL,
        predicted_radiance=0.01,
    )
    return replace(good, **changes)


def gate_after(n_good: int, **config: Any) -> Gate:
    gate = Gate(GateConfig.model_validate(config))
    for seed in range(n_good):
        gate.accept(gate.judge(evidence(seed)))
    return gate


def moved(shift_m: float, turn_deg: float) -> Truth:
    by = RigidTransform.from_components(
        [0, shift_m, 0], Rotation.from_rotvec([0, 0, turn_deg], degrees=True)
    )
    return replace(evidence().truth, trs_from_cam=NOMINAL * by)


def reading(sigma_m: float) -> PoseReading:
    return PoseReading(RigidTransform.identity(), np.diag([1e-10] * 5 + [sigma_m**2]), 0.0)


def room(temperature_k: float) -> RoomReading:
    return RoomReading(temperature_k, 1e5, 0.4, True, True, 0.0)


FAULTS: Mapping[str, tuple[dict[str, Any], str]] = {
    "saturation": (
        {"image": np.where(terrain(99) > 127, 400.0, terrain(99))},
        r"\d+\.\d% of the model is at full scale, allowed 2\.0%",
    ),
    "contrast": ({"image": 100 + 0.1 * (terrain(99) - 100)}, r"contrast is 0\.0\d+, needed 0\.05"),
    "blur": (
        {"image": terrain(99, blur_px=2.0)},
        r"sharpness is 0\.\d+ of that of the shots before, needed 0\.5",
    ),
    "target": (
        {"truth": replace(evidence().truth, usable_fraction=0.04)},
        r"4\.0% of the image shows the model, needed 5\.0%",
    ),
    "tracker": ({"tracker": reading(3e-4)}, r"scatters by 0\.300 mm, allowed 0\.1 mm"),
    "robot": ({"truth": moved(0.04, 0.5)}, r"40\.0 mm and 0\.50 deg .* allowed 30 mm and 1 deg"),
    "temperature": ({"room": room(290.5)}, r"changed by -2\.5 K since the first shot, allowed 2 K"),
    "brightness": ({"image": 0.7 * terrain(99)}, r"changed by -3\d% against .* allowed 15%"),
}


@pytest.mark.parametrize("flag", FAULTS)
def test_each_fault_gets_its_flag_and_no_other(flag: str) -> None:
    changes, text = FAULTS[flag]
    judgement = gate_after(8).judge(evidence(99, **changes))
    others = {"brightness"} if flag == "saturation" else set[str]()  # it is brighter as well
    assert set(judgement.quality.flags) - others == {flag}
    assert re.search(text, judgement.text)


def test_good_shots_raise_no_alarm() -> None:
    gate = gate_after(0)
    for seed in range(40):  # other terrain in every shot, and other noise
        judgement = gate.judge(evidence(seed))
        assert judgement.quality.flags == ()
        gate.accept(judgement)


def test_what_is_compared_is_only_stored_at_first() -> None:
    for flag in ("blur", "brightness"):
        changes, _ = FAULTS[flag]
        early = gate_after(MIN_SHOTS_BEFORE - 1).judge(evidence(99, **changes))
        assert early.quality.flags == ()
        assert early.quality.sharpness > 0
        assert gate_after(MIN_SHOTS_BEFORE).judge(evidence(99, **changes)).quality.flags == (flag,)


@pytest.mark.parametrize("flag", ["blur", "brightness"])
def test_a_fault_that_stays_does_not_become_the_standard(flag: str) -> None:
    gate = gate_after(8)
    for seed in range(100, 116):
        image = terrain(seed, blur_px=2.0) if flag == "blur" else 0.7 * terrain(seed)
        judgement = gate.judge(evidence(seed, image=image))
        assert judgement.quality.flags == (flag,)
        gate.accept(judgement)


def test_light_counts_as_right_when_a_person_says_so() -> None:
    gate = gate_after(8)
    gate.renew_light()
    for seed in range(100, 100 + MIN_SHOTS_BEFORE):
        gate.accept(gate.judge(evidence(seed, image=0.7 * terrain(seed))))
    assert gate.judge(evidence(1, image=0.7 * terrain(1))).quality.flags == ()
    assert gate.judge(evidence(1)).quality.flags == ("brightness",)


def test_judging_leaves_no_trace() -> None:
    """A shot that is taken again is compared with nothing of its first try."""
    gate, changes = gate_after(0), FAULTS["temperature"][0]
    for seed in range(2 * MIN_SHOTS_BEFORE):
        gate.judge(evidence(seed, image=0.5 * terrain(seed), **changes))
    gate.accept(gate.judge(evidence(0)))
    assert gate.judge(evidence(99, **changes)).quality.flags == ("temperature",)


def learned(sharpness_by_range: Mapping[float, float]) -> Gate:
    gate = Gate(GateConfig())
    quality = gate.judge(evidence()).quality
    for range_los_m, sharpness in sharpness_by_range.items():
        gate.learn(replace(quality, sharpness=sharpness), range_los_m=range_los_m)
    return gate


def test_sharpness_is_compared_with_shots_of_like_range() -> None:
    """Terrain from afar is finer: a trend by range is no fault, in whatever order shots come."""
    sharpness = gate_after(0).judge(evidence()).quality.sharpness
    ranges_m = np.random.default_rng(3).permutation(np.geomspace(0.5, 8.0, 60))
    gate = learned({r: sharpness * (r / 2.0) ** 2 for r in ranges_m})
    at = evidence().truth
    near, far = replace(at, range_los_m=2.0), replace(at, range_los_m=6.0)
    assert gate.judge(evidence(truth=near)).quality.flags == ()
    assert gate.judge(evidence(truth=far)).quality.flags == ("blur",)


def test_earlier_session_sets_the_standard_but_not_the_temperature() -> None:
    gate = Gate(GateConfig())
    for seed in range(MIN_SHOTS_BEFORE):
        gate.learn(gate_after(0).judge(evidence(seed)).quality, range_los_m=2.0)
    warm = gate.judge(evidence(99, image=0.7 * terrain(99), room=room(300.0)))
    assert warm.quality.flags == ("brightness",)


def test_camera_that_looks_past_the_model_has_no_target() -> None:
    past = replace(evidence().truth, range_los_m=float("nan"))
    gate = gate_after(8)
    judgement = gate.judge(evidence(truth=past))
    assert judgement.quality.flags == ("target",)
    assert "looks past the model" in judgement.text
    gate.accept(judgement)
    assert gate.judge(evidence(5)).quality.flags == ()


def both_wrong(**config: Any) -> Judgement:
    changes = {"tracker": reading(3e-4), "truth": moved(0.0, 2.0)}
    return gate_after(0, **config).judge(evidence(**changes))


def test_configuration_says_what_a_flag_means() -> None:
    assert both_wrong().wants_retake  # tracker: retake, robot: flag
    assert both_wrong(tracker="flag").quality.flags == ("tracker", "robot")
    assert not both_wrong(tracker="flag").wants_retake
    assert both_wrong(tracker="off").quality.flags == ("robot",)
    assert both_wrong(tracker="off", robot="off").text == ""
    assert both_wrong(tracker="off", robot="off").quality.robot_turn_rad == pytest.approx(
        np.radians(2.0)
    )


def test_scatter_is_that_along_the_worst_axis_wherever_it_points() -> None:
    rotation = Rotation.from_rotvec([0.3, -0.8, 0.5]).as_matrix()
    covariance = rotation @ np.diag([1e-10, 9e-10, 4e-8]) @ rotation.T
    assert largest_sigma(covariance) == pytest.approx(2e-4)
    assert largest_sigma(np.zeros((3, 3))) == 0.0


@given(
    exposure_s=st.floats(1e-4, 10.0), gain_db=st.floats(0.0, 48.0), radiance=st.floats(1e-4, 10.0)
)
def test_brightness_depends_on_the_lamp_only(
    exposure_s: float, gain_db: float, radiance: float
) -> None:
    lamp = 123.0
    grey = lamp * radiance * exposure_s * 10 ** (gain_db / 20)
    frame = Frame(np.zeros((1, 1), np.uint8), "Mono8", exposure_s, gain_db, 1, 0.0)
    assert relative_brightness(grey, frame, radiance) == pytest.approx(lamp)
    assert relative_brightness(grey, frame, None) is None
