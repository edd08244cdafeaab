from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2

from tronlab.calib.reflectors.frame import NAMES, nominal_centres, point_in_trs, solve_frame
from tronlab.campaign.rig import load_rig
from tronlab.devices.laboratory import ReflectorsSpec
from tronlab.devices.readings import PointReading
from tronlab.errors import CalibrationError, DegenerateGeometryError
from tronlab.geometry.uncertainty import pose_difference
from tronlab.twin.instruments import TrackerOptics
from tronlab.twin.world import World, WorldSetup

FOUR = {"far": (2.0, 3.9, 0.3)}
SIX = {"far": (2.0, 3.9, 0.3), "mid": (1.1, 1.7, 0.2), "low": (2.1, 1.3, -0.1)}
FLAT = {"far": (2.0, 3.9, 0.0)}
HEIGHTS = {"sphere_radius_m": 0.01905, "nest_offset_m": 0.006, "nest_offsets_m": {"top_right": 0.1}}
SIGMA_M = 40e-6
TWIN_YAML = Path(__file__).parents[3] / "campaigns/rigs/twin.yaml"


def design(more: Mapping[str, tuple[float, float, float]] | None = None, **values: Any):
    shape = {"bottom_left_m": (2.1, 0.0, 0.0), "top_right_m": (0.1, 4.1, 0.0)}
    tolerance = {"length_tolerance_m": 0.003}
    return ReflectorsSpec.model_validate({**shape, **tolerance, "more_m": more or {}, **values})


def place_tracker(rng: np.random.Generator) -> RigidTransform:
    """Give ``trs_from_trk``."""
    position = np.array([1.0, 2.0, 5.0]) + rng.uniform(-1.0, 1.0, 3)
    return RigidTransform.from_components(position, Rotation.random(rng=rng))


def measure(
    trs_from_trk: RigidTransform,
    p_trs_m: Mapping[str, np.ndarray],
    rng: np.random.Generator,
    sigma_m: float = 0.0,
) -> dict[str, PointReading]:
    """Measure with the same correlated noise everywhere, that grows from point to point."""
    shape = np.array([[1.0, 0.0, 0.0], [0.5, 2.0, 0.0], [0.0, -0.3, 0.5]]) * sigma_m
    readings = {}
    for i, (name, p) in enumerate(p_trs_m.items()):
        root = (1.0 + 0.3 * i) * shape
        noisy = trs_from_trk.inv().apply(p) + root @ rng.normal(size=3)
        readings[name] = PointReading(name, noisy, root @ root.T, 0.0)
    return readings


def with_points(readings: Mapping[str, PointReading], **p_trk_m: Any) -> dict[str, PointReading]:
    """Give readings, some of them elsewhere."""
    return {
        **readings,
        **{
            name: PointReading(name, np.asarray(p), readings[name].covariance_m2, 0.0)
            for name, p in p_trk_m.items()
        },
    }


def transformed(readings: Mapping[str, PointReading], change) -> dict[str, PointReading]:
    return with_points(readings, **{name: change(r.p_trk_m) for name, r in readings.items()})


def swapped(readings: Mapping[str, PointReading], *names: str) -> dict[str, PointReading]:
    """Give each of the names the place of the next one."""
    others = (*names[1:], names[0])
    places = {a: readings[b].p_trk_m for a, b in zip(names, others, strict=True)}
    return with_points(readings, **places)


def exact(spec: ReflectorsSpec, seed: int = 1) -> tuple[RigidTransform, dict[str, PointReading]]:
    rng = np.random.default_rng(seed)
    truth = place_tracker(rng)
    return truth, measure(truth, nominal_centres(spec), rng, 1e-12)


# --- what is found ---


@pytest.mark.parametrize("more", [{}, FOUR, SIX], ids=["three", "four", "six"])
@pytest.mark.parametrize("heights", [{}, HEIGHTS], ids=["centres", "marks"])
def test_exact_points_give_the_exact_frame(more, heights) -> None:
    spec = design(more, **heights)
    truth, readings = exact(spec)
    frame = solve_frame(readings, spec)
    np.testing.assert_allclose(pose_difference(frame.trs_from_trk, truth), 0.0, atol=1e-9)
    assert frame.statistics["n_reflectors"] == len(readings)
    assert max(map(abs, frame.statistics["length_errors_m"].values())) < 1e-9
    assert np.abs(list(frame.statistics["residuals_m"].values())).max() < 1e-9
    assert frame.statistics["warnings"] == []


def test_three_marks_define_the_frame_wherever_they_were_meant_to_be() -> None:
    """With three, errors of the design do not enter: x, y and z are as the paper defines them."""
    spec = design(**HEIGHTS)
    rng = np.random.default_rng(2)
    truth = place_tracker(rng)
    heights = np.array([[0.0, 0.0, spec.centre_heights_m[name]] for name in NAMES])
    marks = np.array([[0.0, 0.0, 0.0], [2.1013, 0.0, 0.0], [0.0991, 4.0988, 0.0]])
    p_trs_m = dict(zip(NAMES, marks + heights, strict=True))
    frame = solve_frame(measure(truth, p_trs_m, rng, 1e-12), spec)
    np.testing.assert_allclose(pose_difference(frame.trs_from_trk, truth), 0.0, atol=1e-9)
    np.testing.assert_allclose(
        frame.statistics["residuals_m"]["top_right"], [-0.0009, -0.0012, 0.0], atol=1e-9
    )


@pytest.mark.parametrize("more", [{}, SIX], ids=["three", "six"])
def test_errors_agree_with_the_predicted_covariance(more) -> None:
    """Over random geometry: reflectors, heights, tracker, noise."""
    rng = np.random.default_rng(3)
    nees, nees_lamp, chi_squares = [], [], []
    p_lamp = np.array([-2.5, -1.5, 2.5])
    for _ in range(120):
        spec = design(
            {name: tuple(p + rng.uniform(-0.3, 0.3, 3)) for name, p in more.items()},
            bottom_left_m=(rng.uniform(1.0, 3.0), 0.0, 0.0),
            top_right_m=(rng.uniform(-1.0, 1.0), rng.uniform(1.0, 5.0), 0.0),
            nest_offsets_m={"top_left": rng.uniform(0.0, 0.2)},
        )
        truth = place_tracker(rng)
        readings = measure(truth, {**nominal_centres(spec), "lamp": p_lamp}, rng, SIGMA_M)
        lamp = readings.pop("lamp")
        frame = solve_frame(readings, spec)
        error = pose_difference(frame.trs_from_trk, truth)
        nees.append(error @ np.linalg.solve(frame.covariance, error))
        p, covariance = point_in_trs(lamp, frame)
        nees_lamp.append((p - p_lamp) @ np.linalg.solve(covariance, p - p_lamp))
        if more:
            chi_squares.append(frame.statistics["chi_square"])
            assert frame.statistics["dof"] == 12
    for values, dof in ((nees, 6), (nees_lamp, 3), (chi_squares, 12)):
        if values:
            low, high = chi2.ppf([0.005, 0.995], dof * len(values))
            assert low < sum(values) < high
    coverage = np.mean(np.array(nees) < chi2.ppf(0.95, 6))
    assert 0.90 <= coverage <= 0.99


def test_more_reflectors_make_the_frame_surer() -> None:
    three, six = design(), design(SIX)
    rng = np.random.default_rng(4)
    readings = measure(place_tracker(rng), nominal_centres(six), rng, SIGMA_M)
    few = solve_frame({name: readings[name] for name in NAMES}, three)
    assert np.trace(solve_frame(readings, six).covariance) < 0.5 * np.trace(few.covariance)


def test_badly_surveyed_marks_widen_the_covariance() -> None:
    """Marks that are off by 0.5 mm contradict a tracker of 40 um: the residuals are believed."""
    spec = design(SIX)
    rng = np.random.default_rng(5)
    moved = {name: p + 5e-4 * rng.normal(size=3) for name, p in nominal_centres(spec).items()}
    readings = measure(place_tracker(rng), moved, rng, SIGMA_M)
    statistics = solve_frame(readings, spec).statistics
    assert statistics["p_value"] < 1e-6
    assert statistics["covariance_scale"] == pytest.approx(statistics["chi_square"] / 12)


def test_labels_that_no_length_tells_apart_are_warned_of() -> None:
    square = {"bottom_left_m": (2.0, 0.0, 0.0), "top_right_m": (0.0, 2.0, 0.0)}
    spec = design({"far": (2.0, 2.0, 0.0)}, **square)
    warnings = solve_frame(exact(spec)[1], spec).statistics["warnings"]
    assert len(warnings) == 3
    assert all("top_left, bottom_left, top_right, far could be" in line for line in warnings)


@pytest.mark.parametrize("more", [{}, SIX], ids=["three", "six"])
def test_the_twins_frame_agrees_with_the_predicted_covariance(more) -> None:
    """With the tracker's stated noise, reflectors off by a millimetre, and those of a survey."""
    rig = load_rig(TWIN_YAML)
    reflectors = rig.config.laboratory.reflectors.model_copy(update={"more_m": more, **HEIGHTS})
    laboratory = rig.config.laboratory.model_copy(update={"reflectors": reflectors})
    nees = []
    for seed in range(40):
        config = rig.config.world.model_copy(update={"seed": seed})
        world = World(WorldSetup(config, laboratory, lambda: pytest.fail("nobody looks")))
        tracker = TrackerOptics(world, np.random.default_rng(seed))
        points = {name: tracker.point(name) for name in reflectors.points_m}
        frame = solve_frame(points, reflectors)
        error = pose_difference(frame.trs_from_trk, world.laboratory.trk_from_trs.inv())
        nees.append(error @ np.linalg.solve(frame.covariance, error))
    low, high = chi2.ppf([0.005, 0.995], 6 * len(nees))
    assert low < sum(nees) < high


# --- what is refused ---


@pytest.mark.parametrize("more", [{}, FOUR, SIX, FLAT], ids=["three", "four", "six", "flat"])
@pytest.mark.parametrize("names", [("top_left", "top_right"), ("top_left", "bottom_left")])
def test_swapped_labels_are_named(more, names) -> None:
    spec = design(more)
    readings = swapped(exact(spec)[1], *names)
    with pytest.raises(CalibrationError, match=f"F_TRS: reflectors {', '.join(names)} are swapped"):
        solve_frame(readings, spec)


def test_mislabelled_among_six_are_named() -> None:
    spec = design(SIX)
    readings = swapped(exact(spec)[1], "far", "bottom_left", "mid")
    message = "reflectors bottom_left, far, mid are swapped: the lengths fit other labels"
    with pytest.raises(CalibrationError, match=message):
        solve_frame(readings, spec)


@pytest.mark.parametrize("more", [{}, FOUR, SIX], ids=["three", "four", "six"])
@pytest.mark.parametrize("name", NAMES)
def test_a_reflector_out_of_place_is_named(more, name) -> None:
    spec = design(more)
    truth, readings = exact(spec)
    p_trs = nominal_centres(spec)[name] + [0.012, 0.015, 0.0]
    moved = with_points(readings, **{name: truth.inv().apply(p_trs)})
    distance = r" by 19\.2\d mm" if more else ""
    with pytest.raises(CalibrationError, match=f"reflector {name} is out of place{distance} "):
        solve_frame(moved, spec)


def test_a_reflector_off_the_plane_is_named_though_all_lengths_fit() -> None:
    spec = design({"far": (2.0, 3.9, 0.0), "mid": (1.8, 2.5, 0.0)})
    truth, readings = exact(spec)
    moved = with_points(readings, far=truth.inv().apply([2.0, 3.9, 0.03]))
    with pytest.raises(CalibrationError, match=r"reflector far is out of place by 30\.00 mm"):
        solve_frame(moved, spec)


def test_one_wrong_length_leaves_two_in_doubt() -> None:
    spec = design()
    truth, readings = exact(spec)
    moved = with_points(readings, bottom_left=truth.inv().apply([2.105, 0.0, 0.0]))
    with pytest.raises(CalibrationError, match="top_left or bottom_left is out of place"):
        solve_frame(moved, spec)


@pytest.mark.parametrize("more", [{}, SIX], ids=["three", "six"])
def test_millimetres_are_recognised(more) -> None:
    spec = design(more)
    readings = transformed(exact(spec)[1], lambda p: 1000.0 * p)
    message = "all lengths are 1000 times the nominal ones: they are in millimetres"
    with pytest.raises(CalibrationError, match=message):
        solve_frame(readings, spec)


def test_another_scale_is_recognised() -> None:
    readings = transformed(exact(design())[1], lambda p: p / 0.3048)
    with pytest.raises(CalibrationError, match=r"all lengths are 3\.2808 times .*wrong unit"):
        solve_frame(readings, design())


@pytest.mark.parametrize("more", [{}, SIX], ids=["three", "six"])
def test_one_reflector_in_millimetres_is_named(more) -> None:
    spec = design(more)
    readings = exact(spec)[1]
    mixed = with_points(readings, top_right=1000.0 * readings["top_right"].p_trk_m)
    with pytest.raises(CalibrationError, match=r"reflector top_right is .*millimetres among metre"):
        solve_frame(mixed, spec)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({}, r"behind the model.*left-handed"),
        (FLAT, r"behind the model.*left-handed"),
        (FOUR, r"mirror image of those designed.*left-handed"),
        (SIX, r"mirror image of those designed.*left-handed"),
    ],
    ids=["three", "flat", "four", "six"],
)
def test_a_left_handed_frame_is_recognised(more, message) -> None:
    spec = design(more)
    readings = transformed(exact(spec)[1], lambda p: p * [1.0, -1.0, 1.0])
    with pytest.raises(CalibrationError, match=message):
        solve_frame(readings, spec)


def test_equal_arms_swapped_would_put_the_tracker_behind_the_model() -> None:
    equal = design(bottom_left_m=(2.0, 0.0, 0.0), top_right_m=(0.0, 2.0, 0.0))
    readings = exact(equal)[1]
    solve_frame(readings, equal)
    message = r"behind the model.*bottom_left, top_right are swapped"
    with pytest.raises(CalibrationError, match=message):
        solve_frame(swapped(readings, "bottom_left", "top_right"), equal)


def test_a_swap_that_mirrors_is_named_with_the_other_cause() -> None:
    arms = {"bottom_left_m": (2.0, 0.0, 0.0), "top_right_m": (0.0, 2.0, 0.0)}
    kite = design({"far": (1.5, 1.5, 0.4)}, **arms)
    readings = exact(kite)[1]
    mirrored = transformed(readings, lambda p: p * [-1.0, 1.0, 1.0])
    message = r"mirror image.*reflectors bottom_left, top_right are swapped, or .* left-handed"
    for wrong in (swapped(readings, "bottom_left", "top_right"), mirrored):
        with pytest.raises(CalibrationError, match=message):
            solve_frame(wrong, kite)


def test_nothing_fits_at_all() -> None:
    rng = np.random.default_rng(6)
    points = {name: rng.normal(size=3) for name in NAMES}
    message = "too many lengths .*: top_left, bottom_left and top_right are in doubt"
    with pytest.raises(CalibrationError, match=message):
        solve_frame(measure(place_tracker(rng), points, rng), design())


@pytest.mark.parametrize("more", [{}, FOUR], ids=["three", "four"])
def test_collinear_reflectors_are_refused(more) -> None:
    """Whether they were designed so or only measured so."""
    line = design(more, bottom_left_m=(2.0, 0.0, 0.0), top_right_m=(4.0, 0.01, 0.0))
    readings = exact(line)[1]
    for spec in (line, design(more)):
        with pytest.raises(DegenerateGeometryError, match="bottom_left, top_right are collinear"):
            solve_frame(readings, spec)


def test_one_seat_measured_twice_is_refused() -> None:
    readings = exact(design())[1]
    twice = with_points(readings, top_right=readings["bottom_left"].p_trk_m)
    with pytest.raises(DegenerateGeometryError, match="bottom_left and top_right lie within 1 mm"):
        solve_frame(twice, design())


def test_missing_and_unknown_reflectors_are_named() -> None:
    _, readings = exact(design(FOUR))
    with pytest.raises(CalibrationError, match=r"far is not in the design; its reflectors: top_le"):
        solve_frame(readings, design())
    del readings["bottom_left"], readings["far"]
    with pytest.raises(CalibrationError, match="bottom_left and far was not measured"):
        solve_frame(readings, design(FOUR))


def test_numbers_that_are_none_are_refused() -> None:
    spec = design(FOUR)
    _, readings = exact(spec)
    with pytest.raises(CalibrationError, match=r"far: was measured at .*nan.*: not finite"):
        solve_frame(with_points(readings, far=[np.nan, 0.0, 0.0]), spec)
    p = readings["far"].p_trk_m
    for covariance, message in ((-np.eye(3), "is no covariance"), (0 * np.eye(3), "is singular")):
        with pytest.raises(CalibrationError, match=f"reflector far.*{message}"):
            solve_frame({**readings, "far": PointReading("far", p, covariance, 0.0)}, spec)


@pytest.mark.parametrize(
    ("marks", "message"),
    [
        (
            {"bottom_left_m": (0.0, 4.1, 0.0), "top_right_m": (2.1, 0.1, 0.0)},
            r"bottom_left_m \[0.0, 4.1, 0.0\] must lie on the X-axis.*\n.*swapped",
        ),
        (
            {"top_right_m": (0.1, -4.1, 0.0)},
            r"top_right_m \[0.1, -4.1, 0.0\] in the X-Y plane at y",
        ),
        (
            {"bottom_left_m": (2100.0, 0.0, 0.0), "top_right_m": (100.0, 4100.0, 0.0)},
            "rig file: bottom_left is at .* millimetres",
        ),
    ],
)
def test_marks_that_do_not_define_the_frame_are_refused(
    marks: dict[str, tuple[float, float, float]], message: str
) -> None:
    """Measured where the rig file has them: no length is wrong."""
    spec = design(**marks)
    trs_from_trk = place_tracker(np.random.default_rng(5))
    readings = measure(trs_from_trk, nominal_centres(spec), np.random.default_rng(6))
    with pytest.raises(CalibrationError, match=message):
        solve_frame(readings, spec)


def test_marks_on_one_line_are_called_collinear() -> None:
    spec = design(top_right_m=(1.0, 0.0, 0.0))
    rng = np.random.default_rng(7)
    readings = measure(place_tracker(rng), nominal_centres(spec), rng, SIGMA_M)
    with pytest.raises(DegenerateGeometryError, match="line"):
        solve_frame(readings, spec)
