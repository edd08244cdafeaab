"""Choice of the distortion model, and whether the board bows.

Two questions decide, and the record keeps the answers. Do more coefficients fit better than chance
has it: the F test of nested models. Do they predict views they were not fitted to: the views are
held out in turn, and only their poses are solved for. The first alone takes for distortion what is
an error of the corners; the second alone overlooks a small distortion that a shifted principal
point imitates, and the camera is then off by more than its covariance says.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f as f_distribution

from tronlab.calib.camera.fit import fit_camera, resect, residuals_px
from tronlab.calib.camera.projection import DISTORTION_MODELS, DistortionModel
from tronlab.calib.camera.state import CameraFit, CameraKind, Corners
from tronlab.errors import CalibrationError
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray

N_FOLDS = 5
"""Parts the views are divided into; each is held out once."""
BOW_LEVEL = 0.05
"""Of the F test, for the bow."""
_GRID = 21
"""A camera is looked at in GRID x GRID places of the image."""
_EXACT_PX2 = 1e-8
"""Variance below which residuals are rounding."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """What must speak for a model against each simpler one."""

    level: float
    """Largest probability of such an improvement by chance (F test)."""
    standard_errors: float
    """How far the held-out error may be above that of the simpler model, in standard errors."""


_EVIDENCE: Mapping[DistortionModel, Evidence] = {
    "radial": Evidence(0.01, 1.0),
    "tangential": Evidence(0.01, 1.0),
    "brown": Evidence(0.01, 1.0),
    "rational": Evidence(1e-3, 0.0),
}
"""A coefficient of Brown's model too many widens the covariance a little, one too few biases the
camera. Those of the rational model nearly cancel each other, so it must earn its place."""


@dataclass(frozen=True, slots=True)
class Trial:
    """How well one kind of camera fits the views, and views held out."""

    kind: CameraKind
    fit: CameraFit
    square_sum_px2: float
    """Of the residuals' coordinates in the views solved with."""
    n_residuals: int
    held_out_px2: FloatArray
    """Mean square of the coordinates in each view while it was held out, shape (n_views,)."""

    @property
    def dof(self) -> int:
        """Get the degrees of freedom of the residuals."""
        return self.n_residuals - len(self.kind.free) - 6 * len(self.held_out_px2)

    @property
    def held_out_rms_px(self) -> float:
        """Get the root mean square over the views."""
        return float(np.sqrt(self.held_out_px2.mean()))

    def p_value(self, simpler: "Trial") -> float:
        """Give how likely chance alone improves the fit of the simpler one as much (F test)."""
        n_more = len(self.kind.free) - len(simpler.kind.free)
        variance = max(self.square_sum_px2 / self.dof, _EXACT_PX2)
        ratio = (simpler.square_sum_px2 - self.square_sum_px2) / n_more / variance
        return float(f_distribution.sf(ratio, n_more, self.dof))

    def excess(self, other: "Trial") -> float:
        """Give by how many standard errors the held-out error is above another's.

        The errors are compared view by view, so that what is common to both cancels.
        """
        difference = self.held_out_px2 - other.held_out_px2
        standard_error = _standard_error(difference)
        return float(difference.mean() / standard_error) if standard_error > 0 else 0.0

    def beats(self, simpler: "Trial") -> bool:
        """Tell whether there is enough evidence for this one against a simpler one."""
        needed = _EVIDENCE[self.kind.model]
        is_significant = self.p_value(simpler) < needed.level
        return is_significant and self.excess(simpler) <= needed.standard_errors

    def row(self, trials: Sequence["Trial"]) -> dict[str, Any]:
        """Give what the record keeps of the trial beside the others, plain values."""
        best = min(trials, key=lambda trial: trial.held_out_rms_px)
        standard_error_px2 = _standard_error(self.held_out_px2)
        return {
            "model": self.kind.model,
            "is_bow_free": self.kind.is_bow_free,
            "n_free": len(self.kind.free),
            "rms_px": float(np.sqrt(self.square_sum_px2 / self.n_residuals)),
            "held_out_rms_px": self.held_out_rms_px,
            "standard_error_px": standard_error_px2 / max(2 * self.held_out_rms_px, 1e-12),
            "standard_errors_above_best": self.excess(best),
            "p_values": {t.kind.model: t.p_value(self) for t in trials if _contains(t, self)},
        }


@dataclass(frozen=True, slots=True)
class Choice:
    """The kind of camera chosen, and how the others did."""

    trial: Trial
    table: list[dict[str, Any]]
    """Of all trials; the last one is the chosen model without bow, if that could be tried."""
    left_out: dict[str, str]
    """Models that cannot be had from these views, and why."""


def choose_kind(
    corners: Corners, start: CameraFit, *, model: DistortionModel | None, sigma_px: float
) -> Choice:
    """Choose what is free in the camera: the simplest that no more general one beats.

    The distortion is chosen with the bow free, which it could otherwise imitate. Then the bow is
    kept if it lowers the held-out error at all, or improves the fit more than chance has it: few
    boards are flat.

    Args:
        corners: Of views that fit.
        start: Where to start.
        model: The distortion model, if it is given and only the bow is to be decided.
        sigma_px: One sigma of a corner's coordinate.

    Raises:
        CalibrationError: No model converges to a camera that sees the whole image.
    """
    models = DISTORTION_MODELS if model is None else (model,)
    left_out: dict[str, str] = {}
    trials = _trials(corners, start, [CameraKind(m, True) for m in models], sigma_px, left_out)
    if not trials:
        raise CalibrationError("\n".join(left_out.values()))
    bowed = next(
        trial
        for i, trial in enumerate(trials)
        if not any(general.beats(trial) for general in trials[i + 1 :])
    )
    unbowed = [CameraKind(bowed.kind.model, False)]
    flat = _trials(corners, bowed.fit, unbowed, sigma_px, left_out)
    chosen = next((trial for trial in flat if not _is_bowed(bowed, trial)), bowed)
    table = [trial.row([*trials, *flat]) for trial in (*trials, *flat)]
    return Choice(chosen, table, left_out)


def _is_bowed(bowed: Trial, flat: Trial) -> bool:
    return bowed.held_out_rms_px < flat.held_out_rms_px or bowed.p_value(flat) < BOW_LEVEL


def _contains(general: Trial, simple: Trial) -> bool:
    return set(general.kind.free.tolist()) > set(simple.kind.free.tolist())


def _trials(
    corners: Corners,
    start: CameraFit,
    kinds: Sequence[CameraKind],
    sigma_px: float,
    left_out: dict[str, str],
) -> list[Trial]:
    """Try cameras from the simplest on, each from where the one before it ended."""
    trials: list[Trial] = []
    for kind in kinds:
        try:
            trials.append(_trial(corners, start, kind, sigma_px))
        except CalibrationError as error:
            left_out[kind.name] = str(error)
        else:
            start = trials[-1].fit
    return trials


def _trial(corners: Corners, start: CameraFit, kind: CameraKind, sigma_px: float) -> Trial:
    fit = fit_camera(corners, start, kind, sigma_px=sigma_px)
    _check_whole_image(fit.camera, kind)
    held_out = np.zeros(len(corners.weights))
    for rest, fold in _folds(len(corners.weights)):
        without = fit_camera(
            corners.of_views(rest), fit.of_views(rest), kind, sigma_px=sigma_px
        ).with_poses(fit.of_views(fold))
        seen = corners.of_views(fold)
        held_out[fold] = _mean_squares_px2(seen, resect(seen, without))
    n_corners = corners.weights.sum(axis=1)
    square_sum = 2 * float(_mean_squares_px2(corners, fit) @ n_corners)
    return Trial(kind, fit, square_sum, 2 * corners.n_used, held_out)


def _check_whole_image(camera: CameraModel, kind: CameraKind) -> None:
    """Coefficients that no corner binds may turn the image back on itself beyond the last one."""
    u, v = (np.linspace(-0.5, n - 0.5, _GRID) for n in (camera.width_px, camera.height_px))
    try:
        camera.rays(np.stack(np.meshgrid(u, v), axis=-1))
    except CalibrationError as error:
        raise CalibrationError(
            f"intrinsics: the distortion found ({kind.name}) folds the image where no corners were"
            " seen; show the board at the edges and in the corners of the image"
        ) from error


def _mean_squares_px2(corners: Corners, fit: CameraFit) -> FloatArray:
    """Give the weighted mean square of a coordinate's residual in each view, shape (n_views,)."""
    squares = (residuals_px(corners, fit) ** 2).mean(axis=2)
    return (corners.weights * squares).sum(axis=1) / corners.weights.sum(axis=1)


def _folds(n_views: int) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Give pairs of the views to solve with and those held out; neighbours in time are parted."""
    i_fold = np.arange(n_views) % min(N_FOLDS, n_views)
    return [(np.flatnonzero(i_fold != i), np.flatnonzero(i_fold == i)) for i in np.unique(i_fold)]


def _standard_error(values: FloatArray) -> float:
    return float(values.std(ddof=1) / np.sqrt(len(values)))
