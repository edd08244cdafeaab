"""Scenes drawn from a point or along a direction, what is nearer over what is farther."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from numpy.typing import NDArray

from tronlab.geometry.poses import FloatArray, unit
from tronlab.report.plan_solids import Faces


@dataclass(frozen=True, slots=True)
class View:
    """From where a scene is seen."""

    right_trs: FloatArray
    up_trs: FloatArray
    towards_trs: FloatArray
    """Towards whoever looks; the three are perpendicular and of length 1."""
    eye_trs_m: FloatArray | None = None
    """Where whoever looks is; None: infinitely far, so that lengths are true."""

    @classmethod
    def from_eye(
        cls, eye_trs_m: FloatArray, target_trs_m: FloatArray, up_trs: FloatArray
    ) -> "View":
        """Look from a point to another one."""
        towards = unit(eye_trs_m - target_trs_m)
        right = unit(np.cross(up_trs, towards))
        return cls(right, np.cross(towards, right), towards, eye_trs_m)

    def project(self, points_trs_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Give places in the picture, shape (..., 2), and how near they are, shape (...).

        Of a view from far away the places are metres along right and up.
        """
        seen = points_trs_m if self.eye_trs_m is None else points_trs_m - self.eye_trs_m
        places = np.stack([seen @ self.right_trs, seen @ self.up_trs], axis=-1)
        nearness = seen @ self.towards_trs
        if self.eye_trs_m is not None:
            # A perspective keeps what is straight only if all of it is in front of the eye.
            places = places / np.maximum(-nearness, 0.1)[..., None]
            nearness = -np.linalg.norm(seen, axis=-1)
        return places, nearness


def draw_faces(axes: Axes, view: View, faces: Sequence[Faces]) -> None:
    """Draw all faces by the painter's algorithm: the far ones first."""
    polygons: list[FloatArray] = []
    nearness: list[FloatArray] = []
    for batch in faces:
        places, near = view.project(batch.points_trs_m)
        polygons.extend(places)
        nearness.append(near.mean(axis=1))
    colours = np.concatenate([batch.colours for batch in faces])
    widths = np.concatenate([np.full(len(batch.colours), batch.line_width) for batch in faces])
    is_line = np.concatenate(
        [np.full(len(batch.colours), batch.points_trs_m.shape[1] == 2) for batch in faces]
    )
    fills = np.where(is_line[:, None], 0.0, 1.0) * colours
    order = np.argsort(np.concatenate(nearness), kind="stable")
    axes.add_collection(
        PolyCollection(
            [polygons[i] for i in order],
            facecolors=fills[order],
            edgecolors=_edges(colours, is_line)[order],
            linewidths=widths[order],
            closed=False,
            rasterized=True,  # thousands of faces: a drawing of them would only be slow
        )
    )


def _edges(colours: FloatArray, is_line: NDArray[np.bool_]) -> FloatArray:
    """Lines have their own colour, the borders of faces a darker one."""
    darker = colours * [0.8, 0.8, 0.8, 1.0]
    return np.where(is_line[:, None], colours, darker)
