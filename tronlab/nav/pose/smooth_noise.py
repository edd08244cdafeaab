"""Covariance of a pose whose image positions err together, in smooth fields.

Light that falls otherwise than in the database, a lens or a terrain that is not quite as believed
shift whole regions of an image together. Such an error hardly shows in single residuals, but a pose
follows it: it moves all of the image smoothly. What the pose could not follow is left, and tells
how strong the rest was.
"""

import numpy as np

from tronlab.geometry.poses import FloatArray
from tronlab.nav.pose.bound import invert_information
from tronlab.nav.pose.correspondences import Correspondences

DEGREE = 3
"""Of the polynomials: a motion of the camera moves the image by those of degree 2, of the image
coordinates and of inverse depth; one more, for fields that no motion makes."""
MIN_MATCHES = 50
"""Of fewer, nearly all that is left of the residuals is smooth, and stands for itself."""
PRIOR_FIELDS = 3.0
"""What is left of a field that a motion imitates is one number: it counts as one, beside so many of
the mean size of fields that no motion resembles."""
_LEAST_SINE = 1e-3
"""Of the angle between a field and the motions of the camera; a smaller one is rounding."""
_LEAST_EIGENVALUE = 1e-10
"""Of a matrix of correlations, in parts of the largest."""


def unit_covariance(
    matches: Correspondences, residuals: FloatArray, jacobian: FloatArray
) -> FloatArray:
    """Give the covariance of a pose by least squares, for residuals of variance 1.

    For independent noise it is the inverse of ``J^T J``. Here it is larger, motion by motion, by
    how much stronger than all residuals those are that resemble it. Fields are polynomials of
    ``DEGREE``; principal angles (Bjorck, Golub, Math. Comp. 27, 1973) pair six of them with
    motions, each with the one that imitates it best, and of each the part is taken that its motion
    could not follow. Its square is 1 in the mean for independent noise, as are the squares of
    fields that no motion resembles (Seber, Lee, Linear Regression Analysis, 2nd ed., 2003, section
    4.3: the parts of an F statistic). None counts for less than independent noise. Errors that a
    motion imitates wholly, as a terrain model that is shifted, show nowhere.

    Args:
        matches: Those that agree with the pose.
        residuals: At the solution, each times its weight, shape (n, 2), pixels over ``scale``.
        jacobian: Of the projections, shape (n, 2, 6), likewise over ``scale``.

    Returns:
        Shape (6, 6), of (rotation vector, translation) in trs, rad^2 and m^2 over pixels^2.

    Raises:
        NoPoseError: The matches do not determine the pose.
    """
    n = len(matches)
    rows = jacobian.reshape(2 * n, -1)
    independent = invert_information(rows.T @ rows)
    of_rows = _orthonormalising(rows)
    polynomials = _polynomials(matches.uv) / matches.scale[:, None]
    polynomials = polynomials @ _orthonormalising(polynomials)
    n_motions, n_fields = of_rows.shape[1], 2 * polynomials.shape[1]
    if n < MIN_MATCHES or n_motions < rows.shape[1] or n_fields <= n_motions:
        return independent
    motions = rows @ of_rows
    by_axis = motions.reshape(n, 2, -1)
    # Of fields along u, then of those along v.
    overlap = np.hstack([by_axis[:, axis].T @ polynomials for axis in (0, 1)])
    turn, cosines, mixture = np.linalg.svd(overlap)
    amplitudes = mixture @ (polynomials.T @ residuals).T.ravel()
    followed = cosines * (turn.T @ (motions.T @ residuals.ravel()))
    sines = np.sqrt(1.0 - np.minimum(cosines, 1.0) ** 2)
    in_all = float((residuals**2).sum()) / (2 * n - n_motions)
    if not in_all > 0.0:
        return independent
    unlike = max(float((amplitudes[n_motions:] ** 2).mean()) / in_all, 1.0)
    left = (amplitudes[:n_motions] - followed) / np.maximum(sines, _LEAST_SINE)
    alike = (PRIOR_FIELDS * unlike + left**2 / in_all) / (PRIOR_FIELDS + 1.0)
    size = np.maximum(np.where(sines > _LEAST_SINE, alike, unlike), 1.0)
    by_motion = of_rows @ turn
    return (by_motion * size) @ by_motion.T


def _polynomials(uv: FloatArray) -> FloatArray:
    """Give every monomial up to ``DEGREE`` in coordinates from -1 to 1, shape (n, terms)."""
    centred = uv - uv.mean(axis=0)
    x, y = (centred / max(float(np.abs(centred).max()), 1.0)).T
    return np.column_stack([x**i * y**j for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)])


def _orthonormalising(columns: FloatArray) -> FloatArray:
    """Give what to multiply columns with, from the right, for an orthonormal basis of their span.

    By the small matrix of their products: no decomposition of thousands of rows.
    """
    products = columns.T @ columns
    size = np.sqrt(products.diagonal())
    size = np.where(size > 0.0, size, 1.0)
    eigenvalues, vectors = np.linalg.eigh(products / np.outer(size, size))
    is_kept = eigenvalues > _LEAST_EIGENVALUE * eigenvalues[-1]
    return vectors[:, is_kept] / np.sqrt(eigenvalues[is_kept]) / size[:, None]
