"""The error budget as text: a table for a terminal, what dominates, and what to do about it."""

from collections.abc import Iterator, Mapping
from types import MappingProxyType

import numpy as np

from tronlab.calib.budget import CONTRIBUTIONS, RELIEF_M, Budget
from tronlab.geometry.poses import FloatArray

_N_ROWS = 10
"""A longer list of poses is shown in so many lines."""
_REMEDIES: Mapping[str, str] = MappingProxyType(
    {
        "tracker position": "put the tracker nearer to where the robot works",
        "tracker rotation": "turn the T-MAC's face to the tracker and average longer; a calibration"
        " cannot help",
        "frame": "measure the reflectors several times, put up more of them, and farther apart"
        " (tronlab calibrate frame)",
        "hand-eye": "add stations, with larger turns (tronlab calibrate hand-eye)",
    }
)
_SHORTER_LEVER = "mount the T-MAC nearer to the camera"


def budget_table(budget: Budget) -> str:
    """Give a budget as text; a long list of poses is thinned out."""
    return "\n".join(_lines(budget))


def dominant(parts: FloatArray) -> tuple[str, float]:
    """Give which contribution has the largest share of the variance, and that share.

    Args:
        parts: One sigma of each contribution at each pose, shape (n, 4).
    """
    shares = (parts**2).sum(axis=0) / (parts**2).sum()
    i = int(shares.argmax())
    return CONTRIBUTIONS[i], float(shares[i])


def _lines(budget: Budget) -> Iterator[str]:
    yield f"error budget of {budget.source}; every figure is one sigma of a length"
    yield f"tracker: {budget.tracker}"
    yield f"lever from T-MAC to camera: {budget.lever_m:.3f} m"
    blocks = (
        ("camera centre", "mm", 1e3 * budget.position_m),
        ("camera rotation", "mdeg", np.degrees(1e3) * budget.rotation_rad),
        ("landmarks in the image", "px", budget.image_px),
    )
    rows = _rows(len(budget.range_los_m))
    for what, unit, parts in blocks:
        yield ""
        yield f"{what} [{unit}]"
        yield from _block(budget, parts, unit, rows)
    yield ""
    yield from _lens_and_lamp(budget)
    yield ""
    for what, _, parts in blocks:
        name, share = dominant(parts)
        yield f"{what}: {name} dominates, {share:.0%} of the variance;"
        is_lever = what == "camera centre" and name == "tracker rotation"
        yield f"  to lower it, {_SHORTER_LEVER if is_lever else _REMEDIES[name]}"


def _rows(n: int) -> list[int]:
    return sorted({int(i) for i in np.rint(np.linspace(0, n - 1, min(n, _N_ROWS)))})


def _block(budget: Budget, parts: FloatArray, unit: str, rows: list[int]) -> Iterator[str]:
    total = np.sqrt((parts**2).sum(axis=1))
    is_length = unit == "mm"
    names = "".join(f"{name:>18}" for name in CONTRIBUTIONS)
    yield f"{'range [m]':>10}{names}{'total':>10}" + ("  % of LOS" if is_length else "")
    for i in rows:
        values = "".join(f"{value:>18.3f}" for value in parts[i])
        line = f"{budget.range_los_m[i]:>10.2f}{values}{total[i]:>10.3f}"
        if is_length:
            line += f"{0.1 * total[i] / budget.range_los_m[i]:>10.4f}"
        yield line


def _lens_and_lamp(budget: Budget) -> Iterator[str]:
    yield f"beside the pose, landmarks move by the intrinsics: {_span(budget.intrinsics_px)} px"
    if np.isfinite(budget.shadow_m):
        yield (
            f"and shadows of {RELIEF_M:g} m of relief by the lamp: {budget.shadow_m * 1e3:.3f} mm"
            f" on the model, {_span(budget.shadow_px)} px"
        )


def _span(values: FloatArray) -> str:
    low, high = f"{values.min():.3f}", f"{values.max():.3f}"
    return low if low == high else f"{low} to {high}"
