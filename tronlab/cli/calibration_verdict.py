"""What a calibration is worth: its numbers with one sigma each, as lines for a terminal."""

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform

    from tronlab.calib.record import CalibrationRecord
    from tronlab.calib.results import (
        CameraResult,
        HandEyeResult,
        LampResult,
        PhotometryResult,
        RobotResult,
    )
    from tronlab.geometry.poses import FloatArray

Row: TypeAlias = tuple[str, str]

_OUTLIERS = ("outlier_stations", "outlier_pairs", "outlier_views", "outliers")
_MOST_LISTED = 12
UNLIKELY = 1e-3
"""Tracker and camera that agree fit worse than they do with this probability."""


def verdict(record: "CalibrationRecord") -> str:
    """Give the results of a record with one sigma each, and what is to be said against them."""
    rows = [*_rows(record), *_left_out(record)]
    width = max((len(name) for name, _ in rows), default=0) + 2
    lines = [f"{name:<{width}}{value}" for name, value in rows]
    notes = [f"note: {text}" for text in getattr(record.inputs.hand_eye, "notes", ())]
    return "\n".join([*lines, *notes, *(f"warning: {text}" for text in _warnings(record))])


def _rows(record: "CalibrationRecord") -> Iterator[Row]:
    results = record.results
    if results.frame is not None:
        yield "frame trs_from_trk", _pose(results.frame.trs_from_trk)
        yield "  one sigma", _sigmas(results.frame.covariance)
        yield from _reflectors(results.frame.statistics)
    if results.camera is not None:
        yield from _camera(results.camera)
    if results.hand_eye is not None:
        yield from _hand_eye(results.hand_eye, setup=getattr(record.inputs.hand_eye, "setup", ""))
    if results.lamp is not None:
        yield from _lamp(results.lamp)
    if results.robot is not None:
        yield from _robot(results.robot)
    if results.photometry is not None:
        yield from _photometry(results.photometry)


def _reflectors(statistics: dict[str, Any]) -> Iterator[Row]:
    errors_m = statistics.get("length_errors_m", {})
    if errors_m:
        pair, error_m = max(errors_m.items(), key=lambda item: abs(item[1]))
        yield "  reflectors", f"lengths differ by {error_m * 1e3:+.3f} mm at most, {pair}"
    if "chi_square" in statistics:
        yield "  fit", _chi_square(statistics, "chi_square", "dof", "p_value")


def _camera(part: "CameraResult") -> Iterator[Row]:
    camera, sigma = part.camera, np.sqrt(np.diag(part.covariance))
    values = (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px)
    fx, fy, cx, cy = (f"{v:.3f} +- {s:.3f}" for v, s in zip(values, sigma, strict=False))
    yield "camera, focal length", f"{fx}, {fy} px"
    yield "  principal point", f"{cx}, {cy} px"
    coefficients = "  ".join(f"{k:.5f}" for k in camera.distortion)
    yield "  distortion", f"{part.model}: {coefficients}"
    bow_mm = " ".join(f"{v * 1e3:+.3f}" for v in part.bow_m)
    yield "  bow of the board", f"{bow_mm} mm along x, along y, twist"
    if "n_views" in part.statistics:
        yield (
            "  views",
            f"{part.statistics['n_views']} with {part.statistics['n_corners']} corners,"
            f" one sigma of a corner {part.statistics['sigma_px']:.3f} px",
        )


def _hand_eye(part: "HandEyeResult", *, setup: str) -> Iterator[Row]:
    statistics = part.statistics
    found = "base_from_cam" if setup == "eye_to_hand" else "tmac_from_cam"
    yield f"hand-eye {found}", _pose(part.tmac_from_cam)
    yield "  one sigma", _sigmas(part.covariance)
    if "least_determined" in statistics:
        yield "  least determined", str(statistics["least_determined"])
    if "rms_px" in statistics:
        yield (
            "  corners",
            f"rms {statistics['rms_px']:.3f} px over {statistics['n_corners']} in"
            f" {statistics['n_stations']} stations",
        )
    if "target_scatter_m" in statistics:
        scatter_mm = statistics["target_scatter_m"] * 1e3
        yield "  pose pairs", f"{statistics['n_pairs']}, the target scatters by {scatter_mm:.3f} mm"
    if "chi_square_poses" in statistics:
        fit = _chi_square(statistics, "chi_square_poses", "dof_poses", "p_value_poses")
        yield "  tracker against camera", fit
    if statistics.get("held_out"):
        yield "  held out", _held_out(statistics["held_out"])


def _held_out(held_out: dict[str, Any]) -> str:
    """Say how well what was left out is predicted, and how well it should be."""
    in_words = {
        "rms_px": lambda v: f"{v:.3f} px",
        "position_rms_m": lambda v: f"{v * 1e3:.3f} mm",
        "angle_rms_rad": lambda v: f"{np.degrees(v):.4f} deg",
        "translation_rms_m": lambda v: f"{v * 1e3:.3f} mm",
        "rotation_rms_rad": lambda v: f"{np.degrees(v):.4f} deg",
    }
    errors: list[str] = []
    for name, say in in_words.items():
        if name in held_out:
            expected = held_out.get(f"expected_{name}")
            tail = "" if expected is None else f" (expected {say(expected)})"
            errors.append(f"{say(held_out[name])}{tail}")
    return f"predicted to {', '.join(errors)} rms"


def _lamp(part: "LampResult") -> Iterator[Row]:
    place = " ".join(f"{v:.4f}" for v in part.p_trs_m)
    sigma_mm = " ".join(f"{v * 1e3:.3f}" for v in np.sqrt(np.diag(part.covariance_m2)))
    yield "lamp", f"x y z {place} m"
    yield "  one sigma", f"x y z {sigma_mm} mm"


def _robot(part: "RobotResult") -> Iterator[Row]:
    yield "robot trs_from_rail", _pose(part.trs_from_rail)
    yield "  one sigma", _sigmas(part.covariance[:6, :6])
    statistics = part.statistics
    if "held_out_rms_m" in statistics:
        yield (
            "  places held out",
            f"met to {statistics['held_out_rms_m'] * 1e3:.3f} mm rms,"
            f" {statistics['held_out_max_m'] * 1e3:.3f} mm at most",
        )


def _photometry(part: "PhotometryResult") -> Iterator[Row]:
    numbers = part.photometry.model_dump(exclude={"kind"})
    named = [f"{name} {value:.4f}" for name, value in numbers.items() if value is not None]
    yield "photometry", ", ".join([part.photometry.kind, *named])
    yield "  one sigma", f"{part.weight_sigma:.4f}"
    statistics = part.statistics
    if "rms_relative" not in statistics:
        return
    low, high = statistics["phase_range_deg"]
    yield (
        "  patches",
        f"{statistics['n_patches']} in {statistics['n_images']} images, phase angles of"
        f" {low:.0f} to {high:.0f} deg; {statistics['n_outliers']} left out",
    )
    rms = {family: f"{100 * value:.2f} %" for family, value in statistics["rms_relative"].items()}
    yield (
        "  grey not explained",
        f"{rms['lunar_lambert']} rms; by Lambert {rms['lambert']}, by Lommel-Seeliger"
        f" {rms['lommel_seeliger']}",
    )
    for row, name, what in (
        ("  phase slope", "phase_slope_per_rad", "1/rad, not rendered"),
        ("  vignetting", "vignetting_power", "power of the cosine off the axis"),
    ):
        yield row, f"{statistics[name]:.4f} +- {statistics[name + '_sigma']:.4f} {what}"
    yield "  light from everywhere", f"{100 * statistics['ambient_share']:.1f} % of the grey"


def _pose(pose: "RigidTransform") -> str:
    place = " ".join(f"{value:.5f}" for value in pose.translation)
    turn = " ".join(f"{value:.4f}" for value in np.degrees(pose.rotation.as_rotvec()))
    return f"x y z {place} m,  rotation vector {turn} deg"


def _sigmas(covariance: "FloatArray") -> str:
    sigma = np.sqrt(np.diag(covariance))
    shift_mm = " ".join(f"{value * 1e3:.3f}" for value in sigma[3:])
    turn_mdeg = " ".join(f"{np.degrees(value) * 1e3:.2f}" for value in sigma[:3])
    return f"x y z {shift_mm} mm,  rotation {turn_mdeg} mdeg"


def _chi_square(statistics: dict[str, Any], value: str, dof: str, p_value: str) -> str:
    judged = (
        "DOES NOT FIT the stated accuracy; look for what moved"
        if statistics[p_value] < UNLIKELY
        else "agrees with the stated accuracy"
    )
    return f"chi-square {statistics[value]:.1f}, expected {statistics[dof]:.1f}: {judged}"


def _left_out(record: "CalibrationRecord") -> Iterator[Row]:
    """Say what was measured in vain."""
    for name in ("intrinsics", "hand_eye", "robot"):
        skipped = getattr(getattr(record.inputs, name), "skipped", ())
        if skipped:
            yield f"left out of {name.replace('_', '-')}", f"{len(skipped)}: {skipped[0]}"
    for part in _parts(record):
        for kind in _OUTLIERS:
            outliers = part.statistics.get(kind, ())
            if outliers:
                listed = ", ".join(str(outlier) for outlier in outliers[:_MOST_LISTED])
                more = ", ..." if len(outliers) > _MOST_LISTED else ""
                yield kind.replace("_", " "), f"{len(outliers)}: {listed}{more}"


def _warnings(record: "CalibrationRecord") -> Iterable[str]:
    return [text for part in _parts(record) for text in part.statistics.get("warnings", ())]


def _parts(record: "CalibrationRecord") -> list[Any]:
    results = record.results
    parts = (
        results.frame,
        results.camera,
        results.hand_eye,
        results.lamp,
        results.robot,
        results.photometry,
    )
    return [part for part in parts if part is not None]
