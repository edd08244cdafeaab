from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform
from scipy.stats import chi2

from tronlab.devices.laboratory import LaboratorySpec
from tronlab.geometry.alignment import frame_from_reflectors
from tronlab.geometry.uncertainty import pose_difference
from tronlab.render.photometry import Lambert
from tronlab.twin.config import Deviation, FaultSpec, WorldConfig
from tronlab.twin.truth import (
    LAMP_TARGET,
    TrueLaboratory,
    build_laboratory,
    named_rng,
    serial_number,
)

N_LABORATORIES = 200


@pytest.fixture(scope="module")
def laboratories(spec: LaboratorySpec, config: WorldConfig) -> list[TrueLaboratory]:
    return [
        build_laboratory(spec, config.model_copy(update={"seed": seed}))
        for seed in range(N_LABORATORIES)
    ]


def assert_chi_square(whitened: np.ndarray) -> None:
    """Standard normal values: their sum of squares must be likely, neither too large nor small."""
    total = float((whitened**2).sum())
    low, high = chi2.ppf([1e-4, 1 - 1e-4], whitened.size)
    assert low < total < high


@pytest.mark.parametrize(
    ("nominal", "true", "deviation"),
    [
        (
            lambda s: s.mounting.trs_from_rail.pose,
            lambda t: t.trs_from_rail,
            lambda c: c.robot.rail_deviation,
        ),
        (
            lambda s: s.mounting.flange_from_cam.pose,
            lambda t: t.flange_from_cam,
            lambda c: c.mounting.camera_deviation,
        ),
        (
            lambda s: s.mounting.flange_from_tmac.pose,
            lambda t: t.flange_from_tmac,
            lambda c: c.mounting.tmac_deviation,
        ),
    ],
    ids=["rail", "camera", "tmac"],
)
def test_mountings_deviate_by_their_sigma(
    laboratories: list[TrueLaboratory],
    spec: LaboratorySpec,
    config: WorldConfig,
    nominal: Callable[[LaboratorySpec], RigidTransform],
    true: Callable[[TrueLaboratory], RigidTransform],
    deviation: Callable[[WorldConfig], Deviation],
):
    sigma = np.repeat([np.radians(deviation(config).sigma_deg), deviation(config).sigma_m], 3)
    differences = np.array([pose_difference(nominal(spec), true(lab)) for lab in laboratories])
    assert_chi_square(differences[:, :3] / sigma[:3])
    assert_chi_square(differences[:, 3:] / sigma[3:])


def test_light_and_its_reflector(
    laboratories: list[TrueLaboratory], spec: LaboratorySpec, config: WorldConfig
):
    lights = np.array([lab.p_light_trs_m for lab in laboratories])
    assert_chi_square((lights - spec.lamp.p_trs_m) / config.lamp.placement_sigma_m)
    measured = np.array([lab.p_targets_trs_m[LAMP_TARGET] for lab in laboratories])
    offsets_m = np.linalg.norm(measured - lights, axis=1)
    np.testing.assert_allclose(offsets_m, config.lamp.housing_offset_m, rtol=1e-9)


def test_the_stated_way_to_the_light_is_the_true_one_but_for_the_offset(
    spec: LaboratorySpec, config: WorldConfig
):
    way = (0.1, -0.2, 0.05)
    lamp = spec.lamp.model_copy(update={"light_from_reflector_m": way})
    lab = build_laboratory(spec.model_copy(update={"lamp": lamp}), config)
    off = lab.p_targets_trs_m[LAMP_TARGET] + way - lab.p_light_trs_m
    assert np.linalg.norm(off) == pytest.approx(config.lamp.housing_offset_m)


def test_reflectors_stand_within_a_millimetre_and_define_the_frame(
    laboratories: list[TrueLaboratory], spec: LaboratorySpec
):
    deviations = []
    for lab in laboratories:
        p_trs = {name: lab.p_targets_trs_m[name] for name in spec.reflectors.points_m}
        deviations += [p_trs[name] - p for name, p in spec.reflectors.points_m.items()]
        p_trk = {name: lab.trk_from_trs.apply(p) for name, p in p_trs.items()}
        found = frame_from_reflectors(**p_trk)
        np.testing.assert_allclose(pose_difference(found, lab.trk_from_trs), 0.0, atol=1e-12)
    largest = np.abs(deviations).max()
    assert 0.0009 < largest <= 0.001


MORE = {"far": (2.1, 4.1, 0.0), "mid": (1.1, 2.0, 0.2)}


def test_surveyed_reflectors_are_where_they_were_found(spec: LaboratorySpec, config: WorldConfig):
    reflectors = spec.reflectors.model_copy(update={"more_m": MORE})
    surveyed = spec.model_copy(update={"reflectors": reflectors})
    deviations = []
    for seed in range(N_LABORATORIES):
        lab = build_laboratory(surveyed, config.model_copy(update={"seed": seed}))
        off = {n: lab.p_targets_trs_m[n] - p for n, p in reflectors.points_m.items()}
        # Three define the frame, so it depends on nobody's survey.
        assert not any(off["top_left"])
        assert not any([*off["bottom_left"][1:], off["top_right"][2]])
        deviations.append([off["bottom_left"][0], *off["top_right"][:2], *off["far"], *off["mid"]])
    assert_chi_square(np.array(deviations) / config.tracker.survey_sigma_m)


def test_the_tracker_sees_centres_above_the_marks(spec: LaboratorySpec, config: WorldConfig):
    heights = {
        "sphere_radius_m": 0.01905,
        "nest_offset_m": 0.006,
        "nest_offsets_m": {"top_right": 0.1},
    }
    reflectors = spec.reflectors.model_copy(update=heights)
    bare = build_laboratory(spec, config).p_targets_trs_m
    raised = build_laboratory(
        spec.model_copy(update={"reflectors": reflectors}), config
    ).p_targets_trs_m
    for name, height_m in (("top_left", 0.02505), ("top_right", 0.11905), (LAMP_TARGET, 0.0)):
        np.testing.assert_allclose(raised[name] - bare[name], [0.0, 0.0, height_m], atol=1e-12)


def test_the_rail_runs_a_little_askew(laboratories: list[TrueLaboratory], config: WorldConfig):
    axes = np.array([lab.rail_axis for lab in laboratories])
    scales = np.linalg.norm(axes, axis=1)
    assert_chi_square((scales - 1.0) / config.robot.rail_scale_sigma)
    assert_chi_square(axes[:, 1:] / np.radians(config.robot.rail_axis_sigma_deg))


def test_tracker_stands_in_the_room_upright_and_anywhere(
    laboratories: list[TrueLaboratory], spec: LaboratorySpec
):
    centre = (np.array(spec.reflectors.bottom_left_m) + np.array(spec.reflectors.top_right_m)) / 2
    places = np.array([lab.trk_from_trs.inv().translation for lab in laboratories])
    distances_m = np.linalg.norm(places - centre, axis=1)
    assert distances_m.min() >= 3.0
    assert distances_m.max() <= 6.0
    assert places[:, 2].min() > 1.0
    assert np.ptp(distances_m) > 2.0
    up = np.array([lab.trk_from_trs.inv().rotation.apply([0, 0, 1]) for lab in laboratories])
    assert (up @ [-1.0, 0.0, 0.0]).min() > np.cos(np.radians(6.0))


def test_lens_is_of_the_kind_configured(laboratories: list[TrueLaboratory], spec: LaboratorySpec):
    fov_deg = [np.degrees(lab.camera.horizontal_fov_rad) for lab in laboratories]
    assert 66.0 < min(fov_deg) < max(fov_deg) < 71.0
    k1 = np.array([lab.camera.distortion[0] for lab in laboratories])
    assert_chi_square((k1 + 0.10) / 0.005)
    centres = np.array([[lab.camera.cx_px, lab.camera.cy_px] for lab in laboratories])
    nominal = spec.camera.nominal_model
    assert_chi_square((centres - [nominal.cx_px, nominal.cy_px]) / 0.5)
    assert laboratories[0].camera.shape == (64, 64)


def test_another_lens_leaves_all_else_in_its_place(spec: LaboratorySpec, config: WorldConfig):
    lens = config.lens.model_copy(update={"focal_length_m": 0.0047})
    one = build_laboratory(spec, config)
    other = build_laboratory(spec, config.model_copy(update={"lens": lens}))
    assert one.camera != other.camera
    np.testing.assert_array_equal(one.trk_from_trs.as_matrix(), other.trk_from_trs.as_matrix())
    np.testing.assert_array_equal(
        one.flange_from_cam.as_matrix(), other.flange_from_cam.as_matrix()
    )


def test_random_numbers_depend_on_seed_and_name_alone():
    draw = named_rng(1, "lens").random()
    assert named_rng(1, "lens").random() == draw
    assert named_rng(2, "lens").random() != draw
    assert named_rng(1, "light").random() != draw


def test_serial_number_names_the_laboratory(spec: LaboratorySpec, config: WorldConfig):
    serial = serial_number(spec, config)
    assert serial_number(spec, config) == serial
    assert serial_number(spec, config.model_copy(update={"seed": 99})) != serial
    lamp = spec.lamp.model_copy(update={"p_trs_m": (-2.5, -1.5, 2.6)})
    assert serial_number(spec.model_copy(update={"lamp": lamp}), config) != serial


def test_faults_do_not_make_another_laboratory(spec: LaboratorySpec, config: WorldConfig):
    fault = FaultSpec(device="camera", call="grab", at=1, error="timeout")
    faulty = config.model_copy(update={"faults": (fault,)})
    assert serial_number(spec, faulty) == serial_number(spec, config)


def test_the_size_of_the_lamp_does_not_make_another_laboratory(
    spec: LaboratorySpec, config: WorldConfig
):
    large = config.model_copy(update={"lamp": config.lamp.model_copy(update={"radius_m": 0.1})})
    assert serial_number(spec, large) == serial_number(spec, config)


def test_another_surface_and_renderer_do_not_make_another_laboratory(
    spec: LaboratorySpec, config: WorldConfig
):
    changed = {"renderer": "cycles", "every_n": 2, "photometry": Lambert(), "albedo": 0.2}
    surface = config.surface.model_copy(update=changed)
    changed_config = config.model_copy(update={"surface": surface})
    assert serial_number(spec, changed_config) == serial_number(spec, config)
