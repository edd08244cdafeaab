"""Least squares for the robot, with weights from the residuals themselves.

The tracker states its covariance; the robot states none that could be trusted. How well it comes to
where its encoders say, in angle and in position, is estimated as two variance components.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.optimize import nnls
from scipy.stats import chi2

from tronlab.calib.robot.model import N_UNKNOWNS, RobotModel, RobotStations, first_model
from tronlab.errors import CalibrationError, DegenerateGeometryError
from tronlab.geometry.poses import FloatArray

_MAX_ROUNDS = 50
_SMALL_STEP = 1e-9
"""Of the unknowns, rad and m."""
_NEAR = 1e-6
"""The same where a better fit follows."""
_SAME_SIGMA = 1e-3
"""Relative change of the robot's sigmas at which they count as found."""
_OUTLIER = float(chi2.isf(1e-4, 6))
"""A station whose residual, squared and in covariances, is larger is left out."""
_MEDIAN_LENGTH = float(np.sqrt(chi2.median(3)))
"""Of vectors whose three components have sigma 1."""
_MOST_OUTLIERS = 0.3
"""Of all stations."""
_LEAST_SIGMA = 1e-9
"""In rad and m: below this a covariance is too near to none to weigh with."""
_SMALLEST_EIGENVALUE = 1e-10
"""Of the normal matrix, scaled to a diagonal of 1."""

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class RobotNoise:
    """How well the flange comes to where the encoders say: one sigma of each component."""

    sigma_rad: float
    sigma_m: float

    def weights(self, model: RobotModel, stations: RobotStations) -> FloatArray:
        """Give the inverse covariance of measured minus predicted poses, shape (n, 6, 6)."""
        turned, shifted = _components(model, stations)
        sigma_rad, sigma_m = max(self.sigma_rad, _LEAST_SIGMA), max(self.sigma_m, _LEAST_SIGMA)
        covariances = stations.covariances + sigma_rad**2 * turned + sigma_m**2 * shifted
        return np.linalg.inv(covariances).astype(np.float64)


@dataclass(frozen=True, slots=True)
class RobotFit:
    """What was found, and from which stations."""

    model: RobotModel
    covariance: FloatArray
    """Of the 15 unknowns; see ``robot_model``."""
    noise: RobotNoise
    is_used: Mask
    """One per station, shape (n,); the others are outliers."""
    residuals: FloatArray
    """Measured minus predicted (rotation vector, translation) in trk of all stations, (n, 6)."""
    held_out: FloatArray
    """The same of the used stations, each predicted without itself."""


def fit_robot(stations: RobotStations) -> RobotFit:
    """Find the model that fits most stations, and leave out those that it does not fit.

    Raises:
        DegenerateGeometryError: The stations do not determine it.
        CalibrationError: Too many stations contradict the others.
    """
    model, noise = _fit_robustly(stations)
    is_used = _is_inlier(model, noise, stations)
    for _ in range(_MAX_ROUNDS):
        _check_agreement(is_used)
        model, noise = _fit(model, noise, stations.where(is_used))
        was_used, is_used = is_used, _is_inlier(model, noise, stations)
        if (is_used == was_used).all():
            break
    used = stations.where(is_used)
    covariance, held_out = _judge(model, noise, used)
    return RobotFit(model, covariance, noise, is_used, model.residuals(stations), held_out)


def _check_agreement(is_used: Mask) -> None:
    outliers, n = np.flatnonzero(~is_used).tolist(), len(is_used)
    if len(outliers) > _MOST_OUTLIERS * n:
        raise CalibrationError(
            f"robot: {len(outliers)} of {n} stations contradict the others"
            f" ({', '.join(map(str, outliers))}); at most {_MOST_OUTLIERS:.0%} may;"
            "\ncheck that the T-MAC sits firmly, and that the robot stood still"
        )


def _fit_robustly(stations: RobotStations) -> tuple[RobotModel, RobotNoise]:
    """Fit with weights that fall off for stations far from the others; scales by medians."""
    model = first_model(stations)
    for _ in range(_MAX_ROUNDS):
        residuals = model.residuals(stations)
        noise = RobotNoise(*_typical_sizes(residuals))
        weights = noise.weights(model, stations)
        chi_squares = np.einsum("ni,nij,nj->n", residuals, weights, residuals)
        weights = weights / (1.0 + chi_squares / 6.0)[:, None, None]
        step = _step(model.jacobian(stations), weights, residuals)
        model = model.moved(step)
        if np.abs(step).max() < _NEAR:
            break
    return model, RobotNoise(*_typical_sizes(model.residuals(stations)))


def _typical_sizes(residuals: FloatArray) -> tuple[float, float]:
    turns, shifts = (np.linalg.norm(part, axis=1) for part in np.split(residuals, 2, axis=1))
    return float(np.median(turns)) / _MEDIAN_LENGTH, float(np.median(shifts)) / _MEDIAN_LENGTH


def _is_inlier(model: RobotModel, noise: RobotNoise, stations: RobotStations) -> Mask:
    residuals = model.residuals(stations)
    weights = noise.weights(model, stations)
    return np.einsum("ni,nij,nj->n", residuals, weights, residuals) <= _OUTLIER


def _fit(
    model: RobotModel, noise: RobotNoise, stations: RobotStations
) -> tuple[RobotModel, RobotNoise]:
    """Alternate between the unknowns and the robot's sigmas until both stay."""
    for _ in range(_MAX_ROUNDS):
        weights = noise.weights(model, stations)
        step = _step(model.jacobian(stations), weights, model.residuals(stations))
        model = model.moved(step)
        before, noise = noise, _estimate_noise(model, noise, stations)
        is_same = np.isclose(noise.sigma_rad, before.sigma_rad, rtol=_SAME_SIGMA, atol=1e-9)
        is_same &= np.isclose(noise.sigma_m, before.sigma_m, rtol=_SAME_SIGMA, atol=1e-9)
        if np.abs(step).max() < _SMALL_STEP and is_same:
            break
    return model, noise


def _estimate_noise(model: RobotModel, noise: RobotNoise, stations: RobotStations) -> RobotNoise:
    """Estimate the robot's variances as MINQUE does; repeated, this is restricted likelihood.

    Source: Rao, J. Multivariate Analysis 1 (1971) 257 and 445.
    """
    residuals = model.residuals(stations).ravel()
    by_unknowns = model.jacobian(stations).reshape(-1, N_UNKNOWNS)
    weights = _diagonal(noise.weights(model, stations))
    weighted = weights @ by_unknowns
    normal = by_unknowns.T @ weighted
    projector = weights - weighted @ np.linalg.solve(normal, weighted.T)
    seen = projector @ residuals
    known = projector @ _diagonal(stations.covariances)
    parts = [_diagonal(part) for part in _components(model, stations)]
    projected = [projector @ part for part in parts]
    equations = np.array([[np.sum(a * b.T) for b in projected] for a in projected])
    right = np.array(
        [seen @ part @ seen - np.sum(p * known.T) for part, p in zip(parts, projected, strict=True)]
    )
    scales = 1.0 / np.sqrt(np.diag(equations))  # rad and m differ in size
    scaled, _ = nnls(equations * np.outer(scales, scales), right * scales)
    sigma_rad, sigma_m = np.sqrt(scaled * scales)
    return RobotNoise(float(sigma_rad), float(sigma_m))


def _judge(
    model: RobotModel, noise: RobotNoise, stations: RobotStations
) -> tuple[FloatArray, FloatArray]:
    """Give the covariance of the unknowns, and each station's residual by a fit without it."""
    jacobian = model.jacobian(stations)
    weights = noise.weights(model, stations)
    covariance = np.linalg.inv(_normal(jacobian, weights)).astype(np.float64)
    leverages = jacobian @ covariance @ jacobian.transpose(0, 2, 1) @ weights
    residuals = model.residuals(stations)[:, :, None]
    held_out = np.linalg.solve(np.eye(6) - leverages, residuals).astype(np.float64)
    # The two variances are estimates, each from half the degrees of freedom: the mean of their
    # inverses, which are the weights, is too large by the factor of Student's distribution.
    dof = (residuals.size - N_UNKNOWNS) / 2
    return dof / (dof - 2.0) * covariance, held_out[:, :, 0]


def _components(model: RobotModel, stations: RobotStations) -> tuple[FloatArray, FloatArray]:
    """Give the covariances (n, 6, 6) of the T-MAC if the flange's angles, or place, have sigma 1.

    The noise is the same in all directions, so the frame of the flange does not matter.
    """
    levers = model.levers(stations)
    turns, shifts = levers[:, :, :3], levers[:, :, 3:]
    return turns @ turns.transpose(0, 2, 1), shifts @ shifts.transpose(0, 2, 1)


def _step(jacobian: FloatArray, weights: FloatArray, residuals: FloatArray) -> FloatArray:
    normal = _normal(jacobian, weights)
    scales = 1.0 / np.sqrt(np.diag(normal))
    scaled = normal * np.outer(scales, scales)
    if np.linalg.eigvalsh(scaled)[0] < _SMALLEST_EIGENVALUE:
        raise DegenerateGeometryError(
            "robot: the stations do not determine how robot and rail stand: turns of the arm and"
            " moves of the rail go together; turn the arm about two axes at every part of the rail"
        )
    gradient = np.einsum("nij,nik,nk->j", jacobian, weights, residuals)
    return scales * np.linalg.solve(scaled, scales * gradient)


def _normal(jacobian: FloatArray, weights: FloatArray) -> FloatArray:
    return np.einsum("nij,nik,nkl->jl", jacobian, weights, jacobian)


def _diagonal(blocks: FloatArray) -> FloatArray:
    return np.asarray(block_diag(*blocks), dtype=np.float64)
