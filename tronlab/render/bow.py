"""The bow of a rendered board; apart from the kernels, so that naming one compiles nothing."""

from dataclasses import dataclass

import numpy as np

from tronlab.geometry.poses import FloatArray
from tronlab.render.renderer import RenderError


@dataclass(frozen=True, slots=True)
class Bow:
    """How far a board is from the plane it was designed on, along its z-axis.

    At (x, y) it is ``terms_m @ [1 - a^2, 1 - b^2, a b]`` with ``(a, b) = ((x, y) - centre_m) /
    half_m``: sag along x, sag along y, twist.
    """

    centre_m: tuple[float, float]
    half_m: tuple[float, float]
    terms_m: tuple[float, float, float]

    def __post_init__(self) -> None:
        if not min(self.half_m) > 0:
            raise RenderError(f"board bow: half_m is {self.half_m}, must be positive")

    def below(self, eye_m: FloatArray) -> FloatArray:
        """Expand z of the surface about the place below an eye, shape (3,), frame board.

        Returns:
            Coefficients of 1, x, y, x^2, x y, y^2, with x and y counted from the eye, shape (6,).
        """
        (sag_x, sag_y, twist), (half_x, half_y) = self.terms_m, self.half_m
        x, y = eye_m[0] - self.centre_m[0], eye_m[1] - self.centre_m[1]
        xx, xy, yy = -sag_x / half_x**2, twist / (half_x * half_y), -sag_y / half_y**2
        z = sag_x + sag_y + xx * x * x + xy * x * y + yy * y * y
        return np.array([z, 2.0 * xx * x + xy * y, 2.0 * yy * y + xy * x, xx, xy, yy])


FLAT = Bow(centre_m=(0.0, 0.0), half_m=(1.0, 1.0), terms_m=(0.0, 0.0, 0.0))
