"""The paint's photometric function, from patches of a surface that is known."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from photometry_patches import POWER, make_patches
from records import make_record, make_results

from tronlab.calib.compare import compare_records
from tronlab.calib.inputs import PhotometryInput
from tronlab.calib.photometry.fit import solve_photometry
from tronlab.calib.photometry.patches import RenderedView, patches_of, phase_angles
from tronlab.calib.record import CalibrationRecord
from tronlab.calib.rerun import rerun
from tronlab.campaign.photometry import with_photometry
from tronlab.errors import CalibrationError, DegenerateGeometryError
from tronlab.geometry.camera import CameraModel
from tronlab.render.photometry import Hapke, Lambert, LommelSeeliger, LunarLambert

SIDE_PX = 8


def test_without_noise_every_number_comes_back() -> None:
    found = solve_photometry(make_patches(noise=0.0, slope_per_rad=0.1))
    assert found.weight == pytest.approx(0.3, abs=1e-10)
    assert found.statistics["vignetting_power"] == pytest.approx(POWER, abs=1e-10)
    assert found.statistics["phase_slope_per_rad"] == pytest.approx(0.1, abs=1e-10)
    assert found.statistics["rms_relative"]["lunar_lambert"] < 1e-12


def test_errors_are_as_large_as_the_jackknife_says() -> None:
    found = [solve_photometry(make_patches(seed=seed, noise=0.02)) for seed in range(24)]
    errors = np.array([(one.weight - 0.3) / one.weight_sigma for one in found])
    # Student's t with 11 degrees of freedom: its variance is 11/9; here within three sigma of that.
    assert 0.5 < np.mean(errors**2) < 2.4
    assert abs(errors.mean()) < 3 / np.sqrt(len(errors))


@pytest.mark.parametrize(
    ("surface", "weight"), [(Lambert(), 0.0), (LommelSeeliger(), 1.0)], ids=["0", "1"]
)
def test_at_the_edges_the_share_stays_a_share_and_has_a_sigma(surface: Any, weight: float) -> None:
    found = [solve_photometry(make_patches(surface, seed=seed, noise=0.01)) for seed in range(8)]
    assert all(abs(one.weight - weight) < 4 * one.weight_sigma for one in found)
    assert all(0.0 <= one.weight <= 1.0 and one.weight_sigma > 1e-4 for one in found)
    # Half of the estimates would lie beyond the edge: there the function is the pure one.
    assert any(type(one.photometry) is type(surface) for one in found)


def test_paint_that_darkens_with_the_phase_angle_does_not_pass_for_another_share() -> None:
    found = solve_photometry(make_patches(slope_per_rad=0.3))
    assert abs(found.weight - 0.3) < 3 * found.weight_sigma
    assert found.statistics["phase_slope_per_rad"] == pytest.approx(0.3, abs=0.01)


def test_of_hapke_s_paint_the_best_share_explains_more_than_the_pure_functions() -> None:
    rms = solve_photometry(make_patches(Hapke(single_scattering_albedo=0.9))).statistics[
        "rms_relative"
    ]
    assert rms["lunar_lambert"] < 0.8 * min(rms["lambert"], rms["lommel_seeliger"])


def test_exposure_and_gain_do_not_matter() -> None:
    measured = make_patches(noise=0.0, exposures_s=(0.02, 0.01, 0.03))
    louder = measured.images[1].model_copy(
        update={"exposure_s": 0.02, "gain_db": 20 * np.log10(0.5)}
    )
    images = (measured.images[0], louder, *measured.images[2:])
    found = solve_photometry(measured.model_copy(update={"images": images}))
    assert found.weight == pytest.approx(0.3, abs=1e-9)


def test_what_is_shaded_is_left_out() -> None:
    def shade(columns: dict[str, Any]) -> None:
        columns["grey"][:3] *= 0.1

    clean, shaded = solve_photometry(make_patches()), solve_photometry(make_patches(change=shade))
    assert shaded.statistics["n_outliers"] == 3 * 12
    assert abs(shaded.weight - clean.weight) < shaded.weight_sigma
    assert not shaded.statistics["warnings"]


def flat(columns: dict[str, Any]) -> None:
    """All light and all looks from one side: the two functions differ by a factor only."""
    columns["lommel_seeliger"] = 1.3 * columns["lambert"] * np.linspace(0.999, 1.001, 60)


def wrong_place(columns: dict[str, Any]) -> None:
    rolled = np.roll(np.arange(60), 7)
    columns["lambert"] = columns["lambert"][rolled]
    columns["lommel_seeliger"] = columns["lommel_seeliger"][rolled]


def dark(columns: dict[str, Any]) -> None:
    columns["lambert"] *= 0.0
    columns["lommel_seeliger"] *= 0.0


@pytest.mark.parametrize(
    ("measured", "error", "message"),
    [
        (make_patches(n_images=5), DegenerateGeometryError, r"5 images .* 300 patches; needed"),
        (make_patches(n_patches=10), DegenerateGeometryError, "120 patches; needed"),
        (make_patches(change=flat), DegenerateGeometryError, "more directions: overhead and"),
        (make_patches(change=dark), CalibrationError, "the lamp lights nothing"),
        (make_patches(change=wrong_place), CalibrationError, "do not belong together"),
        (make_patches(noise=0.12), CalibrationError, r"differ by \d+% .* not as recorded"),
    ],
    ids=["images", "patches", "angles", "unlit", "elsewhere", "noise"],
)
def test_what_does_not_tell_is_refused(
    measured: PhotometryInput, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        solve_photometry(measured)


def record_with(measured: PhotometryInput) -> CalibrationRecord:
    camera = CameraModel(64, 48, 48.0, 48.0, 31.5, 23.5)
    return with_photometry(make_record(make_results(camera=camera), valid_days=30.0), measured)


def test_a_record_keeps_it_and_solves_it_again(tmp_path: Path) -> None:
    record = record_with(make_patches())
    record.save(tmp_path / "record.json")
    read = CalibrationRecord.load(tmp_path / "record.json")
    assert read.results.photometry == record.results.photometry
    assert read.photometry == record.photometry
    assert read.inputs.photometry == record.inputs.photometry
    only_photometry = replace(
        read,
        results=replace(
            make_results(camera=read.camera),
            **{
                "frame": None,
                "camera": None,
                "hand_eye": None,
                "lamp": None,
                "photometry": read.results.photometry,
            },
        ),
    )
    again = rerun(only_photometry, {})
    assert not again.differences
    assert again.record.results.photometry == read.results.photometry


def test_a_record_without_it_says_how_to_get_it() -> None:
    record = record_with(make_patches())
    without = replace(record, results=replace(record.results, photometry=None))
    with pytest.raises(CalibrationError, match=r"has no photometry;\n.*photometry --from DATASET"):
        _ = without.photometry


def test_a_damaged_function_is_named(tmp_path: Path) -> None:
    path = tmp_path / "record.json"
    record_with(make_patches()).save(path)
    path.write_text(path.read_text().replace('"kind": "lunar_lambert"', '"kind": "moon"', 1))
    with pytest.raises(CalibrationError, match=r"photometry\.function.*'moon'"):
        CalibrationRecord.load(path, check_signature=False)


def test_paint_does_not_expire() -> None:
    record = record_with(make_patches())
    assert record.expires_utc is not None
    assert record.expires_utc.year == 2026
    created = replace(record, created_utc="2027-01-01T00:00:00Z")
    assert created.expires_utc is not None
    assert created.expires_utc.year == 2027


def test_another_paint_counts_as_a_change_and_the_same_one_does_not() -> None:
    first, second, other = (
        record_with(make_patches(LunarLambert(weight=weight), seed=seed))
        for seed, weight in enumerate((0.3, 0.3, 0.5))
    )
    assert "lamp and photometry agree" in compare_records(first, second).verdict
    assert "photometry changed: the paint" in compare_records(first, other).verdict


def view(rows: int, columns: int) -> RenderedView:
    radiance = np.arange(rows * columns, dtype=np.float32).reshape(rows, columns)
    return RenderedView(
        lambert=radiance,
        lommel_seeliger=2 * radiance,
        phase_rad=np.full((rows, columns), 0.5),
        cos_axis=np.ones((rows, columns)),
    )


def test_patches_lie_wholly_on_the_model_and_are_not_saturated() -> None:
    image = np.full((3 * SIDE_PX + 3, 2 * SIDE_PX), 100, np.uint8)
    mask = np.ones(image.shape, np.bool_)
    mask[0, 0] = False
    image[2 * SIDE_PX, 0] = 255
    seen = view(*image.shape)
    seen.phase_rad[SIDE_PX, -1] = np.nan
    found = patches_of(
        image,
        mask,
        seen,
        full_scale=255,
        patch_px=SIDE_PX,
        shot_id=7,
        exposure_s=0.02,
        gain_db=0.0,
    )
    corners = [(0, SIDE_PX), (SIDE_PX, 0), (2 * SIDE_PX, SIDE_PX)]
    means = [seen.lambert[v : v + SIDE_PX, u : u + SIDE_PX].mean() for v, u in corners]
    assert found.lambert == pytest.approx(means, rel=1e-5)
    assert found.grey == pytest.approx([100.5 / 256] * 3, abs=1e-6)


def test_both_pixel_formats_mean_the_same_light() -> None:
    codes = np.random.default_rng(0).integers(0, 4000, (64, 64)).astype(np.uint16)
    mask = np.ones(codes.shape, np.bool_)
    greys = [
        np.array(
            patches_of(
                image,
                mask,
                view(64, 64),
                full_scale=full_scale,
                patch_px=32,
                shot_id=0,
                exposure_s=0.02,
                gain_db=0.0,
            ).grey
        )
        for image, full_scale in ((codes, 4095), ((codes // 16).astype(np.uint8), 255))
    ]
    assert greys[0] == pytest.approx(greys[1], abs=1e-4)


def test_phase_angles_are_those_at_the_point() -> None:
    p_lamp_m, p_camera_m = np.array([1.0, 0.0, 1.0]), np.array([0.0, 0.0, 5.0])
    points_m = np.array([[0.0, 0.0, 0.0], [np.nan] * 3, [1.0, 0.0, 5.0]])
    angles_deg = np.degrees(phase_angles(points_m, p_lamp_m, p_camera_m))
    assert angles_deg == pytest.approx([45.0, np.nan, 90.0], nan_ok=True)
